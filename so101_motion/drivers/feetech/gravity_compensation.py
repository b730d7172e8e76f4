"""Making joints come to rest where they were sent, in spite of their weight.

A servo's position loop is a spring: ``p_gain / 4`` thousandths of full drive for each tick of
error. With the arm's weight on it a joint stands 2 deg (P gain 32) to 5 deg (P gain 16) short of
its goal, and says it has arrived. ``Trim`` makes the goals that much wrong in advance, in two
parts:

*What the weight explains*, feed-forward: the torque that holds the commanded pose, divided by the
stiffness of the spring. It is there while the arm moves, so the path is followed and not only its
end. It is as good as the model: what the jaw carries, the supply's true voltage and friction are
not in it.

*What is left*, a slow integral: while command and joint stand still, the measured error is added
up. While one of them moves, the integral waits, because the error is then mostly the servo's lag.

What keeps the integral from doing harm: an error too large for the arm's weight is no droop but a
joint that is held fast or still on its way, and is left alone; the integral is bounded by the share
of the motor's drive it can cause. Errors of about a tick are left alone too, and every time a joint
has crossed its goal, larger ones: with play and friction it would hunt from one side of its goal to
the other for ever. The jaw has no trim: its error is the grip.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.units import to_rad
from so101_motion.drivers.bus.ticks import RAD_PER_TICK

Gravity = Callable[[Array], Array]
"""Torque [N m] that holds the arm still at joint angles ``q`` [rad], shapes (6,), jaw included."""

GAIN = 5.0
"""Integral gain [1/s]: an error shrinks to a tenth in half a second. Chosen; the servo's own
response is ten times faster."""

DEAD_BANDS = tuple(ticks * RAD_PER_TICK for ticks in (1.5, 2.5, 2.5, 2.5, 7.0))
"""Errors up to this are left alone [rad], by how often the joint has crossed its goal. Chosen: the
emulated joint jumps by 5 to 7 ticks when it breaks loose, so it gets three more tries to come to
rest within 2.5 ticks, which is inside the settle tolerance, and then has to be content."""

LARGEST_DRIVE = 0.25
"""Share of full drive that the integral may ask for. Chosen: 100 g in the jaws of the stretched arm
take 0.14 at the shoulder, and a supply of 10 V instead of 12 V a fifth of what the weight takes."""

LARGEST_SAG = 0.5
"""Share of full drive beyond which an error cannot be the arm's weight: 100 g in the jaws of the
stretched arm take 0.43 at the shoulder."""

LARGEST_OFFSET = LARGEST_SAG + LARGEST_DRIVE
"""Share of full drive that both parts together may ask for."""

STALL_TORQUE = 2.94
"""Torque at full drive [N m]: 30 kg.cm at 12 V, the datasheet of the STS3215-C018. The 7.4 V type
has two thirds of it; the integral makes up for that."""

_STILL = 0.1
"""How long the command must have stood still [s]: a healthy servo's lag. Chosen."""

_AT_REST = to_rad(4.0)
"""A joint faster than this is on its way [rad/s]; chosen, above the scatter of a resting one."""


def yielding(p_gain: int) -> float:
    """How far a joint gives way under full drive at a P gain, were it a spring to the end [rad]."""
    return 4000.0 / max(p_gain, 1) * RAD_PER_TICK


_JAW = 5


class Trim:
    """What to add to the goals of the six joints; nothing to the jaw's.

    Args:
        gravity: The torque that holds a pose.

    Attributes:
        yielding: How far each joint gives way under full drive [rad].
    """

    def __init__(self, gravity: Gravity) -> None:
        self._gravity = gravity
        self.yielding = [yielding(32)] * 6
        self._explained = [0.0] * 6
        self._rest = [0.0] * 6
        self._goal: list[float] = []
        self._side = [0.0] * 6  # where each joint was when it was last seen off its goal
        self._crossed = [0] * 6  # its goal, how often
        self._since = self._last = 0.0

    def explain(self, q: Sequence[float]) -> list[float]:
        """What the weight at joint angles ``q`` [rad] must add to the six goals [rad]."""
        torque: list[float] = self._gravity(np.array(q)).tolist()
        shares = [min(max(t / STALL_TORQUE, -LARGEST_SAG), LARGEST_SAG) for t in torque[:_JAW]]
        return [share * give for share, give in zip(shares, self.yielding, strict=False)] + [0.0]

    @property
    def rest(self) -> list[float]:
        """What of ``offset`` the weight does not explain [rad]."""
        return list(self._rest)

    @property
    def largest(self) -> list[float]:
        """How much ``offset`` may be at most [rad]."""
        return [LARGEST_OFFSET * give for give in self.yielding[:_JAW]] + [0.0]

    @property
    def offset(self) -> list[float]:
        """What to add to the six commanded positions [rad]."""
        return [
            explained + rest for explained, rest in zip(self._explained, self._rest, strict=True)
        ]

    def command(self, goal: list[float], now: float) -> None:
        """The six joints are sent to ``goal`` [rad] at ``now`` [s]."""
        if goal != self._goal:
            self._take_up(goal, now)

    def start(self, goal: list[float], now: float, sag: Sequence[float | None]) -> None:
        """The six joints stand at ``goal`` [rad] at ``now`` [s] and shall stay there.

        Args:
            goal: Where they are.
            now: When.
            sag: How far from there the goals of their servos are [rad], None for a limp one. What
                is added begins with that, as far as the weight can be the reason. A limp joint
                begins with what its weight explains: the servo then carries it from the first
                moment, and no more than it, so a joint that lies on something stays there.
        """
        self._take_up(goal, now)
        for i, off in enumerate(sag[:_JAW]):
            most = LARGEST_SAG * self.yielding[i]
            explained = self._explained[i]
            self._rest[i] = 0.0 if off is None else min(max(off, -most), most) - explained

    def measure(
        self, q: Sequence[float], qd: Sequence[float], fresh: Collection[int], now: float
    ) -> None:
        """Learn from a measurement.

        Args:
            q: Where the six joints are [rad].
            qd: How fast they are [rad/s].
            fresh: Which of them have been measured now.
            now: When [s].
        """
        dt, self._last = min(now - self._last, 0.05), now
        if not self._goal or now - self._since < _STILL:
            return
        for i in range(_JAW):
            error = self._goal[i] - q[i]
            dead = DEAD_BANDS[min(self._crossed[i], len(DEAD_BANDS) - 1)]
            is_droop = dead < abs(error) < LARGEST_SAG * self.yielding[i]
            if is_droop and abs(qd[i]) < _AT_REST and i in fresh:
                self._learn(i, error, dt)

    def set_gain(self, i: int, p_gain: int) -> None:
        """The P gain of joint ``i`` is ``p_gain``."""
        self.yielding[i] = yielding(p_gain)

    def _learn(self, i: int, error: float, dt: float) -> None:
        if error * self._side[i] < 0.0:
            self._crossed[i] += 1
        self._side[i] = error
        rest, bound = self._rest[i], LARGEST_DRIVE * self.yielding[i]
        # One that began beyond its bound may only come back.
        step = GAIN * dt * error
        self._rest[i] = min(max(rest + step, min(rest, -bound)), max(rest, bound))

    def _take_up(self, goal: list[float], now: float) -> None:
        self._goal, self._since = goal, now
        self._side, self._crossed = [0.0] * 6, [0] * 6
        self._explained = self.explain(goal)
