"""Move an arm through standard motions and record them, to be held against an emulated arm.

From the pose of an identification one joint after the other goes to the ends of its sweep, at
``SPEEDS``, slow first, and rests at each. What was sent to the servos and what they answered is
recorded as ``benchmarks/emulated_arm.py`` explains it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from functools import partial

from so101_motion.arm.joint_caps import JERK_TIME
from so101_motion.arm.motion_handle import Motion, Step
from so101_motion.common.state import ARM_JOINTS, JointState
from so101_motion.common.units import to_deg, to_rad
from so101_motion.control.request_queue import running_future
from so101_motion.drivers.bus.ticks import Ticks
from so101_motion.drivers.command_record import SentCommand
from so101_motion.drivers.feetech.servo_settings import read_registers
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.setup.identify import BASE, Identification, IdentificationOutline

SPEEDS = tuple(to_rad(each) for each in (15.0, 45.0, 90.0))
"""Speeds of the motions [rad/s]; chosen, slow first. The arm's own cap holds as well."""

ACCELERATION = to_rad(300.0)
"""Acceleration of the fastest; the others have less, in proportion [rad/s^2]; chosen."""

REST = 2.0  # how long a joint stands at each end [s]: what it stands off is taken after 1.5. Chosen

_LOOK = 0.01
_POSITIONS = 2  # every second period: 50 positions a second

Recorded = dict[str, list[float] | list[list[float]]]


class StandardMotions:
    """The standard motions of one arm, once."""

    def __init__(self, rig: HardwareRig) -> None:
        self._rig = rig
        self._stopped = threading.Event()
        self._rest: tuple[float, Future[None]] | None = None
        self._joint = ""
        self._goals: list[tuple[str, SentCommand]] = []
        self._states: list[tuple[str, JointState]] = []
        self._motion: Motion | None = None

    def outline(self) -> IdentificationOutline:
        """The sweep of each joint within its range and clear of contact; moves nothing."""
        return Identification(self._rig).outline()

    def sentence(self, outline: IdentificationOutline) -> str:
        ways = "; ".join(
            f"{each.joint} from {to_deg(each.ends[0]):.0f}° to {to_deg(each.ends[1]):.0f}°"
            for each in outline.sweeps
        )
        fastest = to_deg(min(SPEEDS[-1], self._rig.arm.speed))
        return (
            f"The arm is raised; then move, one after the other: {ways}. At most {fastest:.0f}°/s."
        )

    def cancel(self) -> None:
        """End it; the arm slows to rest and holds. Any thread may call."""
        self._stopped.set()
        if self._motion is not None:
            self._motion.interrupt("stop")

    def move_and_record(
        self, outline: IdentificationOutline, on_progress: Callable[[str], None] = lambda _: None
    ) -> dict[str, Recorded]:
        """Move as outlined and record each joint's motion. Blocks; the arm moves, then holds."""
        rig, shown = self._rig, ""
        listener, rig.servos.on_command = rig.servos.on_command, self._hear
        end_looking = rig.executor.listen(self._look)
        try:
            with rig.clock.attend():
                self._motion = motion = rig.arm.start_series(self._steps(outline))
                if self._stopped.is_set():
                    motion.interrupt("stop")
                while not motion.future.done():
                    rig.clock.wait(rig.clock.now() + _LOOK, threading.Event())
                    if self._rest is not None and rig.clock.now() >= self._rest[0]:
                        over, self._rest = self._rest[1], None
                        over.set_result(None)
                    if self._joint != shown:
                        shown = self._joint
                        on_progress(shown)
                motion.result(timeout=0.0)
        finally:
            rig.servos.on_command = listener
            end_looking()
        return {each.joint: self._recorded(each.joint) for each in outline.sweeps}

    def registers(self) -> dict[str, dict[str, int]]:
        lease = self._rig.lend_bus("reading the servos' registers")
        try:
            return {
                joint: lease.call(partial(read_registers, servo_id=setup.map.servo_id))
                for joint, setup in self._rig.servos.setups.items()
            }
        finally:
            lease.give_back(hold=True)

    def _steps(self, outline: IdentificationOutline) -> Iterator[Step]:
        plan, speeds = self._rig.arm.plan, [min(v, self._rig.arm.speed) for v in SPEEDS]
        yield plan(JointGoal(q=BASE), limits=self._limits(speeds[1]))
        for sweep in outline.sweeps:
            low, high = BASE.copy(), BASE.copy()
            low[ARM_JOINTS.index(sweep.joint)], high[ARM_JOINTS.index(sweep.joint)] = sweep.ends
            yield self._stand
            self._joint = sweep.joint
            yield self._stand
            for speed in speeds:
                for q in (low, high):
                    yield plan(JointGoal(q=q), limits=self._limits(speed))
                    yield self._stand
            yield plan(JointGoal(q=BASE), limits=self._limits(speeds[1]))
            yield self._stand
        self._joint = ""

    def _limits(self, speed: float) -> MotionLimits:
        acceleration = min(ACCELERATION * speed / SPEEDS[-1], self._rig.arm.acceleration)
        return MotionLimits.uniform(
            velocity=speed, acceleration=acceleration, jerk=acceleration / JERK_TIME
        )

    def _stand(self, motion: Motion) -> None:
        over: Future[None] = running_future()
        self._rest = (self._rig.clock.now() + REST, over)
        motion.wait_for(over)

    def _hear(self, command: SentCommand) -> None:
        self._goals.append((self._joint, command))

    def _look(self, state: JointState) -> None:
        self._states.append((self._joint, state))

    def _recorded(self, joint: str) -> Recorded:
        maps = [self._rig.servos.setups[each].map for each in ARM_JOINTS]
        goals = [(e.t, e.goals) for name, e in self._goals if name == joint and e.goals]
        states = [state for name, state in self._states if name == joint][::_POSITIONS]
        jaw = 0.0 if self._rig.gripper is None else float(self._rig.gripper.aperture)
        begin, at = states[0].t, [float(x) for x in states[0].q]
        command: list[list[float]] = []
        when: list[float] = []
        for t, sent in goals:
            for i, each in enumerate(maps):
                if each.servo_id in sent:
                    at[i] = each.to_rad(Ticks(sent[each.servo_id]))
            command.append([*(round(x, 4) for x in at), round(jaw, 3)])
            when.append(round(t - begin, 4))
        return {
            "t_cmd_s": when,
            "command": command,
            "t_s": [round(state.t - begin, 4) for state in states],
            "position": [[*(round(float(x), 4) for x in s.q), round(jaw, 3)] for s in states],
        }
