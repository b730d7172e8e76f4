"""Jog the arm while somebody holds a button, a key or a gamepad's stick.

The browser repeats what is held (``server/front/jog.js``). Without a repeat for ``DEADMAN`` it has
been let go: the window has lost its focus or its network, or the browser hangs. A thread leads the
arm through the guarded motions of ``Arm.follow`` and ``Arm.jog``; Stop and other motions end it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from so101_motion.arm.motion_handle import Motion
from so101_motion.common.errors import So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_m, to_rad
from so101_motion.control.cartesian_jog import Jog
from so101_motion.control.following import APPROACH, Following
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.protocols import RigLike

DEADMAN = 0.065
"""How long something counts as held without a repeat [s]; chosen: three repeats of the browser."""

PERIOD = 0.02  # time between two updates of the jog [s]; chosen: two control cycles

_AHEAD = 0.15
"""How far the target may be ahead of the joints [s]; chosen: else it would run away from joints
that something holds back."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JogSpeed:
    """A step of the speed: turning a joint or the tool [rad/s], and going along an axis [m/s]."""

    turning: float
    going: float


SPEEDS = {
    "slow": JogSpeed(turning=to_rad(6.0), going=to_m(12.0)),
    "medium": JogSpeed(turning=to_rad(20.0), going=to_m(40.0)),
    "fast": JogSpeed(turning=to_rad(45.0), going=to_m(100.0)),
}
"""Chosen: slow for the last millimetre, fast for long distances."""

JOINTS, BASE, TOOL, ARROWS = "joints", "base", "tool", "arrows"
MODES = (JOINTS, BASE, TOOL, ARROWS)
"""What is moved: each joint, the tool along the axes of the base or of itself, or the arrows of the
target, which the arm follows while they are dragged."""

AXES = 7
"""Numbers that the browser sends: five joints and a spare one, or the tool's three directions and
three turns; then the jaw. Each from -1 to 1."""


class _JointLead:
    """Leads the joints."""

    def __init__(self, motion: Following) -> None:
        self.motion = motion
        self._q: Array | None = None

    def move(self, held: Array | None, speed: JogSpeed, dt: float) -> None:
        if held is None or not held[:5].any():
            if self._q is not None:
                self.motion.hold()
            self._q = None
            return
        qd, q = speed.turning * held[:5], self.motion.now.q
        wanted = (q if self._q is None else self._q) + dt * qd
        ahead = _AHEAD * np.abs(qd)
        self._q = np.where(qd != 0.0, np.clip(wanted, q - ahead, q + ahead), wanted)
        self.motion.aim(self._q, qd)


class _ToolLead:
    """Leads the tool along straight lines."""

    def __init__(self, motion: Jog, *, in_tool: bool) -> None:
        self.motion, self._in_tool = motion, in_tool
        self._moves = False

    def move(self, held: Array | None, speed: JogSpeed, dt: float) -> None:
        moves = held is not None and bool(held[:6].any())
        if moves and held is not None:
            self.motion.twist(
                speed.going * held[:3], speed.turning * held[3:6], in_tool=self._in_tool
            )
        elif self._moves:
            self.motion.twist(np.zeros(3))
        self._moves = moves


class _TargetLead:
    """Leads the joints to a target, as long as it is being dragged."""

    def __init__(self, motion: Following, target: Callable[[], Array | None]) -> None:
        self.motion, self._target = motion, target
        self._found: Array | None = None
        self._is_held = False

    def move(self, held: Array | None, speed: JogSpeed, dt: float) -> None:
        target = self._target()
        if held is None:
            if self._is_held:
                self.motion.hold()
            self._is_held = False
            return
        if not self._is_held:  # a drag begins: do not go to the target from before it
            self._found, self._is_held = target, True
        if target is not None and target is not self._found:
            self._found = None
            self.motion.aim(target)


_Lead = _JointLead | _ToolLead | _TargetLead
"""Leads a motion while something is held; ``move`` gets None when nothing is."""


class Jogging:
    """Moves an arm while a control is held. Off until it is started.

    Args:
        rig: The arm and the jaw.
        target: Where the dragged arrows want the joints, shape (5,), [rad]; None if out of reach.

    Attributes:
        mode: One of ``MODES``; None while it is off.
        speed: One of ``SPEEDS``.
        outcome: Why it ended last, if something ended it.
    """

    def __init__(self, rig: RigLike, target: Callable[[], Array | None]) -> None:
        self._rig, self._clock, self._target = rig, rig.clock, target
        self.mode: str | None = None
        self.speed = "slow"
        self.outcome: So101Error | None = None
        self._held: tuple[Array, float] | None = None
        self._jaw = 0.0
        self._jaw_motion: Motion | None = None
        self._motion: Any = None
        self._ends, self._wake = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def is_ready(self) -> bool:
        return self._motion is not None

    @property
    def held_by(self) -> tuple[str, ...]:
        motion = self._motion
        return () if motion is None else tuple(motion.held_by)

    def start(self, mode: str) -> None:
        self.close()
        self.mode, self.outcome = mode, None
        self._ends = threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(mode, self._ends), name="so101-viewer-jog", daemon=True
        )
        self._thread.start()

    def set_speed(self, speed: str) -> None:
        """Take another step of the speed; a jog of the joints is begun anew with it."""
        self.speed = speed
        if self.mode in (JOINTS, ARROWS):
            self.start(self.mode)

    def close(self) -> None:
        """Switch it off; the arm slows to rest."""
        self._held = None
        self._ends.set()
        self._wake.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            self._clock.join(thread)

    def hold(self, held: Array) -> None:
        """Take note of what is held, shape (``AXES``,), -1 to 1; any thread.

        All zero is a drag that goes on.
        """
        self._held = held, self._clock.now()
        self._wake.set()

    def release(self) -> None:
        """Take note that nothing is held any more; any thread."""
        self._held = None
        self._wake.set()

    def _run(self, mode: str, ends: threading.Event) -> None:
        try:
            lead = self._open(mode)
            self._motion = lead.motion
            with self._clock.attend():
                self._lead(lead, ends)
            lead.motion.close()
        except So101Error as error:
            self.outcome = error
        finally:
            self._turn_jaw(0.0)
            self._motion, self._held = None, None
            self.mode = None

    def _open(self, mode: str) -> _Lead:
        arm = self._rig.arm
        if mode in (BASE, TOOL):
            return _ToolLead(arm.jog(), in_tool=mode == TOOL)
        following = arm.follow(
            limits=_capped(arm.limits, self.speed), approach=_capped(APPROACH, self.speed)
        )
        return _TargetLead(following, self._target) if mode == ARROWS else _JointLead(following)

    def _lead(self, lead: _Lead, ends: threading.Event) -> None:
        before = self._clock.now()
        while not ends.is_set():
            self._clock.wait(self._due(before), self._wake)
            if lead.motion.future.done():
                lead.motion.future.result()
                return
            now = self._clock.now()
            last = self._held
            held = None if last is None or now - last[1] >= DEADMAN else last[0]
            lead.move(held, SPEEDS[self.speed], min(now - before, 2.0 * PERIOD))
            self._turn_jaw(0.0 if held is None else float(np.sign(held[6])))
            before = now

    def _due(self, before: float) -> float:
        """When to look next [s]: after a period, or when what is held runs out."""
        held, due = self._held, before + PERIOD
        ends = due if held is None else held[1] + DEADMAN
        return min(due, ends) if ends > before else due

    def _turn_jaw(self, way: float) -> None:
        if way == self._jaw:
            return
        self._jaw, gripper = way, self._rig.gripper
        if self._jaw_motion is not None:
            self._jaw_motion.interrupt("jog")
            self._jaw_motion = None
        if way != 0.0:
            self._jaw_motion = (
                gripper.move(1.0, wait=False) if way > 0.0 else gripper.grab(wait=False)
            )


def _capped(limits: MotionLimits, speed: str) -> MotionLimits:
    return replace(limits, velocity=np.minimum(limits.velocity, SPEEDS[speed].turning))


def read_held(text: str) -> Array | None:
    """What the browser says is held: a count, then ``AXES`` numbers; None for nothing.

    Anything that is not valid counts as nothing held.
    """
    try:
        held = np.array([float(word) for word in text.split()[1:]])
    except ValueError:
        return None
    if held.shape != (AXES,) or not np.all(np.abs(held) <= 1.0):
        return None
    return held
