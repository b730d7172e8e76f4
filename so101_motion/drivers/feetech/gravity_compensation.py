"""Compensate weight and friction, so that joints come to rest where they were sent.

``Trim`` offsets the goals by the distance the servos will give way, in two parts:

*Feed-forward*, from the model: the torque that holds the commanded pose and the friction of the
motion, turned into a distance by ``servo_model.py``; it acts while the arm moves. When a joint
turns round, its friction does not change sides at once but over twice ``ENGAGING`` of travel, so a
trembling command does not shake the goals. At rest it stays on the side it was.

*A slow integral*, for the rest: while command and joint stand still, the measured error is added
up. It first turns friction over to the side where it is needed, quickly, as long as nothing moves.
The rest is load that the model does not know, and is kept for the motions that follow: the part
that a mass in the gripper explains as that mass, because its torque changes with the pose, the
remainder joint by joint. While the command moves it learns slowly, from the error beyond the
uncompensated lag: when that lag was taken for weight, a joint that followed a target at 50 deg/s
went up to 3 deg past the place where it was stopped.

An error too large for the arm's weight is not droop: the joint is held fast or still moving, and
nothing is learnt. The integral is bounded by the torque it can cause. Errors of a tick or two are
ignored, as are, half a second after the command has come to rest, all errors of joints that have
arrived: with play and friction a joint would otherwise hunt from one side of its goal to the other
for ever. The jaw has no trim: its error is the grip.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.units import to_rad
from so101_motion.drivers.bus.ticks import RAD_PER_TICK
from so101_motion.drivers.feetech.servo_model import LARGEST_SAG, ServoModel
from so101_motion.drivers.goal_limiter import limited

Gravity = Callable[[Array], Array]
"""Torque [N m] that holds the arm still at joint angles ``q`` [rad], shapes (6,), jaw included."""

GAIN = 8.0
"""Integral gain [1/s]: an error shrinks to a tenth in 0.3 s. Chosen; the servo's own response, its
delay included, is twice as fast."""

GAIN_MOVING = 2.0
"""Integral gain while the command moves [1/s], for joints that bear weight: an unknown load acts on
them too. The error of the others is lag, which ends when they rest. Chosen: with 4 a shoulder that
follows as hard as it can swings farther past."""

GAIN_KNOWN, REST_KNOWN = 4.0, 0.2
"""The same gain [1/s] for servos whose own figures are known, and the share of it for errors that
no mass in the gripper explains: such a servo seldom has another error. Chosen by trial."""

BEARING = 0.3
"""Joints that bear less weight than this learn less while they move [N m]; chosen."""

MOVING_ERROR = to_rad(4.0)
"""A moving joint with a larger error is blocked by something [rad]; chosen."""

TURNING = to_rad(10.0)
"""How fast friction is turned over to the other side at rest [rad/s]. Chosen: done in 0.2 s under
the arm's weight, and not 4 ticks too far when the joint breaks loose."""

ENGAGING = to_rad(0.3)
"""Half the travel over which friction changes sides when a joint turns round [rad]. Chosen: four
times the tremor of a hand that teleoperates."""

DEAD_BAND = 2.5 * RAD_PER_TICK
"""Errors up to this are ignored [rad]; chosen."""

LATE = 0.45
"""How long after the command has come to rest small errors are still corrected [s]; chosen."""

SETTLE_POSITION = to_rad(0.33)
"""How near to its goal a joint must come to have arrived [rad]: not quite four ticks; a fitted
servo that breaks loose moves by three. Chosen."""

LEFT_ALONE = to_rad(0.5)
"""Errors up to this are ignored for a joint that had arrived after ``LATE`` [rad]. Chosen: its
reading may change by a tick, and moving to and fro is worse than such an error."""

SETTLE_VELOCITY = to_rad(3.0)
"""A joint slower than this is at rest [rad/s]: its encoder was seen to scatter by 3 ticks."""

SETTLE_TIMEOUT = 2.0
"""How long settling may take [s]: ten time constants of the trim's integral."""

LARGEST_DRIVE = 1.7
"""Torque that the integral may cause [N m]. Chosen: 300 g in the jaws of the stretched arm need 1.5
at the shoulder, their friction included."""

INERTIA = (0.012, 0.014, 0.007, 0.002, 0.001)
"""Inertia that the moved links add to each joint [kg m^2]; chosen, averages."""

HEAVIEST = 0.4
"""Largest mass that is learnt, positive or negative [kg]. Chosen; a weaker motor looks like a mass
too."""

CARRIES = 0.3
"""Unknown mass that the gripper may carry [kg]; chosen."""

UNSURE = 0.05
"""Error of the modelled weight of a joint [N m], plus a twentieth of that weight. Chosen: the
change of an unloaded arm's weight over 5 deg."""

WEIGHTLESS = 0.008
"""A smaller load leaves an output where its motor drags it [N m]. Chosen: the emulator's limit is
0.01, less the effect of 0.3 kg with a roll zero that is off by 5 deg."""

_FELT = 0.5
"""Nothing is taken for a mass where a kilogram needs less torque than this [N m]."""

_DOUBT = 2.0
"""Where a kilogram adds this torque [N m], half of an error is taken for carried mass and half for
something else; less where it adds less. Chosen by trial: without that, errors near the upright
looked like 0.2 kg."""

_STILL = 0.06
"""How long the command must have stood still [s]: twice a healthy servo's delay. Chosen."""

_AT_REST = to_rad(4.0)
"""A joint faster than this is moving [rad/s]; chosen, above the scatter of a resting one."""

_UPRIGHT = (0, 4)
"""Pan and roll bear no weight in any pose. For the other joints a modelled weight near zero is not
known that well."""

_JAW = 5


class Trim:
    """Offsets of the six joints' goals against weight and friction; zero for the jaw.

    Without ``per_kg``, the torque that each kilogram in the gripper adds, no such load is learnt.
    ``carried`` is the estimated mass in the gripper [kg], ``lags`` the uncompensated lag of each
    joint now [rad], ``weights`` the torques that hold the joints where they will be when the last
    goal acts [N m], ``ways`` which way and how fully friction is overcome, -1 to 1.
    """

    def __init__(self, gravity: Gravity, per_kg: Gravity | None = None) -> None:
        self._gravity, self._load, self.carried = gravity, per_kg, 0.0
        self.lags = [0.0] * 6
        self._per_kg = [0.0] * 6  # [N m/kg] in the commanded pose
        self.models = [ServoModel() for _ in range(6)]
        self.weights = [0.0] * 6
        self._qd: Sequence[float] = (0.0,) * 6  # commanded [rad/s]
        self.ways = [0.0] * 6  # which way friction is overcome, -1 to 1
        self._torque = [0.0] * 6  # what weight and friction take [N m]
        self._without_speed = [0.0] * 6  # and what that adds to the goal at rest [rad]
        self._known = [0.0] * 6  # as far as it can be the arm's weight
        self._rest = [0.0] * 6
        self._goal: list[float] = []
        self._arrived = [False] * 6
        self._gives_way = [False] * 6
        self._since = self._last = 0.0

    @property
    def full_drive_errors(self) -> list[float]:
        """The position error at which each servo drives fully [rad]."""
        return [model.full_drive_error for model in self.models]

    def explain(
        self,
        q: Sequence[float],
        way: Sequence[float],
        qd: Sequence[float],
        carried: Sequence[float],
    ) -> list[float]:
        """Offsets of the arm joints' goals [rad] at ``q`` [rad] and ``qd`` [rad/s].

        ``way`` is which way and how fully friction is overcome, -1 to 1, ``carried`` the mass in
        the gripper that each joint counts on [kg].
        """
        own, per_kg = self._gravity(np.array(q)).tolist(), self.per_kg(q)
        weights = [w + m * u for w, u, m in zip(own, per_kg, carried, strict=False)]
        return [
            limited(
                model.distance(weight + side * model.friction(weight, side), speed),
                model.largest_sag,
            )
            for model, weight, side, speed in zip(self.models, weights, way, qd, strict=False)
        ]

    def per_kg(self, q: Sequence[float]) -> list[float]:
        """What each kilogram in the gripper adds to the six joints at ``q`` [rad], in [N m/kg]."""
        if self._load is None:
            return self._per_kg
        per_kg: list[float] = self._load(np.array(q)).tolist()
        return per_kg

    def taken_for_mass(self) -> tuple[float, list[float]]:
        """Take as much as possible of what was learnt for a mass in the gripper.

        Returns that mass [kg], and what is left of the arm joints' offsets [rad].
        """
        arms = self._per_kg[:_JAW]
        heaviness = sum(each * each for each in arms)
        if heaviness < _FELT**2:
            return self.carried, self._rest[:_JAW]
        torques = [m.torque(rest) for m, rest in zip(self.models, self._rest, strict=True)]
        more = sum(u * t for u, t in zip(arms, torques, strict=False)) / heaviness
        mass = limited(self.carried + more, HEAVIEST)
        left = [
            (torque - (mass - self.carried) * arm) / model.stiffness
            for torque, arm, model in zip(torques, arms, self.models, strict=False)
        ]
        return mass, left

    @property
    def rest(self) -> list[float]:
        """The part of ``offset`` that neither weight nor friction explain [rad]."""
        return list(self._rest)

    def in_play(self) -> list[int]:
        """The joints that may stand in their play now, with any load the gripper may carry.

        A joint stands still while its motor crosses the play: where a load that pulled it ahead of
        its motor falls away. Without such a load the motor drags the output; under a lasting one
        the output stays ahead of the motor.
        """
        found = []
        for i in range(_JAW):
            own = self.weights[i] - self.carried * self._per_kg[i]
            full = own + CARRIES * self._per_kg[i]
            unsure = 0.0 if i in _UPRIGHT else UNSURE + 0.05 * abs(own)
            low, high = min(own, full) - unsure, max(own, full) + unsure
            is_lifted = -low < WEIGHTLESS and self.ways[i] >= 1.0
            is_lowered = high < WEIGHTLESS and self.ways[i] <= -1.0
            is_kept = max(low, -high) > 0.0 or max(-low, high) < WEIGHTLESS
            if not (is_lifted or is_lowered or is_kept):
                found.append(i)
        return found

    @property
    def largest(self) -> list[float]:
        """Bounds of ``offset`` [rad]."""
        most = LARGEST_SAG + LARGEST_DRIVE
        return [model.error_for(most) for model in self.models[:_JAW]] + [0.0]

    @property
    def offset(self) -> list[float]:
        """The offsets to add to the six commanded positions [rad]."""
        return [known + rest for known, rest in zip(self._known, self._rest, strict=True)]

    def command(
        self,
        goal: list[float],
        now: float,
        qd: Sequence[float] = (0.0,) * 5,
        ahead: float = 0.0,
        ways: Sequence[float | None] = (None,) * 5,
    ) -> None:
        """Take the next command, ``goal`` [rad] and ``qd`` [rad/s], at ``now`` [s].

        A goal acts ``ahead`` [s] after it was sent. ``ways`` says in which direction friction is to
        be overcome, and how fully, -1 to 1; for None it follows from the last motion of the joint.
        """
        if goal == self._goal:
            return
        before = self._goal or goal
        for i in range(_JAW):
            step = goal[i] - before[i]
            foreseen = ways[i]
            if foreseen is None:
                foreseen = limited(self.ways[i] + step / ENGAGING, 1.0)
            self.ways[i] = foreseen
            self._gives_way[i] = self._gives_way[i] and not step
        q = [at + v * ahead for at, v in zip(goal, qd, strict=False)]
        self._take_up(goal, [*q, goal[_JAW]], now)
        self._qd = qd
        for i in range(_JAW):
            self._find(i)

    def give_way(self, i: int) -> None:
        """Stop pushing with joint ``i``, which is blocked, until its command changes."""
        self._gives_way[i], self.ways[i] = True, 0.0
        self._find(i)

    def lag(self, i: int, qd: float, qdd: float) -> float:
        """Lag of joint ``i`` behind its set-point [rad] at ``qd`` [rad/s] and ``qdd`` [rad/s^2]."""
        model, torque = self.models[i], self._torque[i]
        more = model.kind.viscous * qd + (model.kind.armature + INERTIA[i]) * qdd
        return model.distance(torque + more, qd) - self._without_speed[i]

    def start(self, goal: list[float], now: float, sag: Sequence[float | None]) -> None:
        """Start with the six joints at rest at ``goal`` [rad] at ``now`` [s].

        The offset begins with ``sag``, the distance from there to the servo's goal [rad], as far as
        the weight can be the reason. That of a limp joint, None, begins with its weight alone: the
        servo carries it from the first moment, and a joint that lies on something stays there.
        """
        self.carried, self._gives_way, self._qd = 0.0, [False] * 6, (0.0,) * 6
        self._take_up(goal, goal, now)
        for i, off in enumerate(sag[:_JAW]):
            self.ways[i] = self._rest[i] = 0.0
            self._find(i)
            if off is None:
                continue
            model, most = self.models[i], self.models[i].largest_sag
            off = limited(off, most)
            friction = model.friction(self.weights[i], 0.0)
            self.ways[i] = limited(model.torque(off - self._known[i]) / friction, 1.0)
            for _ in range(3):  # friction grows with what is not known of the load
                self._find(i)
                self._rest[i] = off - self._known[i]

    def measure(
        self, q: Sequence[float], qd: Sequence[float], fresh: Collection[int], now: float
    ) -> None:
        """Learn from angles [rad] and velocities [rad/s] of ``fresh`` joints at ``now`` [s]."""
        dt, self._last = min(now - self._last, 0.05), now
        if not self._goal:
            return
        still = now - self._since
        if still < _STILL:
            self._learn_moving(q, fresh, dt)
            return
        steps = [0.0] * 6
        for i in range(_JAW):
            error, dead = self._goal[i] - q[i], DEAD_BAND
            if still >= LATE:
                self._arrived[i] = self._arrived[i] or abs(error) <= SETTLE_POSITION
                dead = LEFT_ALONE if self._arrived[i] else SETTLE_POSITION
            is_droop = dead < abs(error) < self.models[i].largest_sag
            is_droop = is_droop and not self._gives_way[i]
            if is_droop and abs(qd[i]) < _AT_REST and i in fresh:
                steps[i] = self._turn_over(i, error, dt)
        self._learn(steps)

    def _learn_moving(self, q: Sequence[float], fresh: Collection[int], dt: float) -> None:
        steps = [0.0] * 6
        for i in range(_JAW):
            error = self._goal[i] - self.lags[i] - q[i]
            if i in fresh and DEAD_BAND < abs(error) < MOVING_ERROR:
                model = self.models[i]
                demand = model.distance(self._torque[i], self._qd[i]) + self._rest[i] + error
                if demand * error > 0.0 and model.drive(demand) >= model.most_drive:
                    continue  # it can do no more; what was learnt then would throw it past its goal
                bears = min(abs(self.weights[i]) / BEARING, 1.0)
                gain = GAIN_KNOWN if model.is_known else GAIN_MOVING
                steps[i] = bears * gain * dt * error
        if any(steps):
            self._learn(steps, [REST_KNOWN if each.is_known else 1.0 for each in self.models])

    def _turn_over(self, i: int, error: float, dt: float) -> float:
        """Turn the friction of joint ``i`` over; return what to learn once that is done [rad]."""
        model, way = self.models[i], self.ways[i]
        side = 1.0 if error > 0.0 else -1.0
        if way * side >= 1.0:
            return GAIN * dt * error
        load = self.weights[i] + model.torque(self._rest[i])
        turn = model.torque(TURNING * dt) / model.friction(load, side)
        self.ways[i] = limited(way + side * turn, 1.0)
        self._find(i)
        return 0.0

    def _learn(self, steps: list[float], shares: Sequence[float] = (1.0,) * 6) -> None:
        """Increase the offsets by ``steps`` [rad]: as carried mass first, then joint by joint."""
        if not any(steps):
            return
        heaviness = sum(each * each for each in self._per_kg[:_JAW])
        torques = [m.torque(step) for m, step in zip(self.models, steps, strict=True)]
        more = sum(u * t for u, t in zip(self._per_kg, torques, strict=True))
        before = self.carried
        self.carried = limited(before + more / (heaviness + _DOUBT**2), HEAVIEST)
        for i in range(_JAW):
            change = (self.carried - before) * self._per_kg[i]
            self.weights[i] += change
            steps[i] -= change / self.models[i].stiffness
            steps[i] *= shares[i]
        for i in range(_JAW):
            self._add(i, steps[i])
            self._find(i)

    def _add(self, i: int, step: float) -> None:
        rest, bound = self._rest[i], self.models[i].error_for(LARGEST_DRIVE)
        # One that began beyond its bound may only come back.
        self._rest[i] = min(max(rest + step, min(rest, -bound)), max(rest, bound))

    def _take_up(self, goal: list[float], q: Sequence[float], now: float) -> None:
        self._goal, self._since, self._arrived = goal, now, [False] * 6
        self.weights, self._per_kg = self._weights(q)

    def _weights(self, q: Sequence[float]) -> tuple[list[float], list[float]]:
        """Holding torques at ``q`` [rad], and the torque that each kilogram carried adds."""
        own, per_kg = self._gravity(np.array(q)).tolist(), self.per_kg(q)
        return [w + self.carried * u for w, u in zip(own, per_kg, strict=True)], per_kg

    def _find(self, i: int) -> None:
        model, way, torque = self.models[i], self.ways[i], self.weights[i]
        if way:
            load = torque + self._rest[i] * model.stiffness
            torque += way * model.friction(load, way, self._qd[i])
        self._torque[i] = torque
        self._without_speed[i] = model.distance(torque)
        self._known[i] = limited(self._without_speed[i], model.largest_sag)
