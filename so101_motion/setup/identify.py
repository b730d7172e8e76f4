"""Move an arm's joints to identify how its servos differ from their type, and the load in its hand.

From a pose with the hand up and forward, one joint after the other moves to and fro through a wide
part of its range, slowly and faster, clear of all known obstacles; the shoulder once more with the
wrist folded either way. From the record ``servo_fit.py`` computes the figures.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.arm.arm import Arm
from so101_motion.arm.joint_caps import JERK_TIME
from so101_motion.arm.motion_handle import Motion, Step
from so101_motion.calib.procedure.servo_fit import (
    Identified,
    JointRecord,
    Load,
    Prediction,
    figures,
)
from so101_motion.calib.record import servo_file
from so101_motion.calib.record.servo_file import HandLoad, ServoRecord
from so101_motion.common.child_process import OwnProcess
from so101_motion.common.errors import CalibrationError, MotionError, PlanningError, in_series
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS, JointState
from so101_motion.common.units import to_deg, to_mm, to_rad
from so101_motion.control.request_queue import running_future
from so101_motion.drivers.bus.ticks import Ticks
from so101_motion.drivers.command_record import SentCommand
from so101_motion.planning.goals import JointGoal, PathGoal
from so101_motion.planning.request import Search
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Payload
from so101_motion.rig.hardware_rig import HardwareRig

CHANGED = 0.25
"""Friction or torque must differ from the last time by this share to be reported. Chosen: twice as
much as two identifications of one arm differ."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyReport:
    """The result of an identification."""

    found: ServoRecord  # the new figures
    before: ServoRecord | None  # the figures before; None if there were none
    predictions: Mapping[str, Prediction]  # how well figures predict each joint, by name
    file: Path | None  # the file that it is saved in; None if it is not saved

    def to_json(self) -> dict[str, Any]:
        load = self.found.load
        return {
            "at": self.found.at,
            "volts": round(self.found.volts, 2),
            "file": None if self.file is None else str(self.file),
            "joints": {joint: self._joint(joint) for joint in self.found.servos},
            "load": None
            if load is None
            else {"mass_g": round(1e3 * load.mass, 1), "com_mm": [to_mm(x) for x in load.com]},
            "changes": list(changes(self.before, self.found)),
        }

    def remarks(self) -> list[str]:
        said = [f"supply {self.found.volts:.1f} V; shares are of the servo type's figures"]
        load = self.found.load
        if load is not None:
            x, y, z = (to_mm(each) for each in load.com)
            said.append(
                f"the hand carries {1e3 * load.mass:.0f} g, its centre at"
                f" ({x:.0f}, {y:.0f}, {z:.0f}) mm of the tool; plans count with it until the"
                " program ends; to keep it, configure payload_kg and payload_com_mm"
            )
        return [*said, *changes(self.before, self.found)]

    def _joint(self, joint: str) -> dict[str, Any]:
        each, told = self.found.servos[joint], self.predictions.get(joint)
        return {
            "torque": each.torque,
            "friction": each.friction,
            "dead_time": each.dead_time,
            "play_deg": None if each.play is None else to_deg(each.play),
            "off_as_sold_deg": None if told is None else to_deg(told.as_sold),
            "off_as_known_deg": None if told is None else to_deg(told.as_known),
        }


def changes(before: ServoRecord | None, now: ServoRecord) -> Iterator[str]:
    if before is None:
        return
    for joint, each in now.servos.items():
        last = before.servos.get(joint)
        if last is None:
            continue
        for name, share in (
            ("friction", each.friction / max(last.friction, 1e-6) - 1.0),
            ("torque", each.torque / last.torque - 1.0),
        ):
            if abs(share) >= CHANGED:
                word = "more" if share > 0.0 else "less"
                yield f"{joint} has {abs(share):.0%} {word} {name} than on {before.at[:10]}"


def changes_since(calibration: Path) -> tuple[str, ...]:
    try:
        now = servo_file.read(calibration)
    except CalibrationError as error:
        return (str(error),)
    return () if now is None else tuple(changes(servo_file.before(calibration), now))


def record_of(found: Identified) -> ServoRecord:
    load = found.load
    return ServoRecord(
        at=datetime.now(UTC).isoformat(timespec="seconds"),
        volts=found.volts,
        servos=found.servos,
        load=None if load is None else HandLoad(mass=load.mass, com=load.com),
    )


BASE = to_rad(np.array([0.0, 0.0, -45.0, 0.0, 0.0]))
"""The pose from which each joint is moved [rad]; chosen: hand up and forward, 0.4 m over the table,
and each joint that bears weight passes from nearly none of it to much."""

SWEEPS = {
    "shoulder_pan": (-25.0, 25.0), "shoulder_lift": (-45.0, 35.0), "elbow_flex": (-95.0, 5.0),
    "wrist_flex": (-70.0, 50.0), "wrist_roll": (-60.0, 60.0),
}  # fmt: skip
"""The ends between which each joint moves [deg]. Chosen: the weight of lift, elbow and wrist
changes sides, which shows their play. With the elbow up to -88 only, its play was found up to 11 %
off."""

FOLDS = {"shoulder_lift": (to_rad(-80.0), to_rad(80.0))}
"""Further wrist angles at which a joint moves to and fro once more, slowly [rad]. The hand is then
nearer to the shoulder, or farther, which separates a load's mass from its centre: by the covariance
of the fit, 100 g to 3.5 g instead of 5.5, and along the hand 5 mm instead of 11."""

STROKES = {"wrist_roll": (to_rad(20.0), 5)}
"""How far to both sides, and how often, a joint moves to and fro once more, fast [rad]. Chosen by
trial on 20 emulated arms: one without weight shows its play only where it turns round, and by a few
ticks of its encoder. That of wrist_roll was found up to 14 % off without this, 7 % with it; slow
strokes, or strokes of 6 deg, made its friction worse."""

SPEEDS = (to_rad(15.0), to_rad(45.0))
"""Speeds of a sweep [rad/s]. Chosen: above the slowest speed of a servo's own set-point, 9 deg/s,
and fast enough for dead time and friction to be told apart."""

ACCELERATION = to_rad(150.0)  # acceleration at the ends of a sweep [rad/s^2]; chosen

_WRIST = ARM_JOINTS.index("wrist_flex")
_RAISED = JointGoal(q=BASE)
_SHARES = (1.0, 0.7, 0.4)  # of a sweep, until one is clear
_GAP = 0.05
"""Figures of a joint that did not answer for so long while it moved are wrong [s]: goals may not
have arrived either. Seen on an emulated arm on a busy computer: a fifth of the friction."""

_TRIES = 3
"""How often a joint moves until it has answered all the while; chosen: a computer is busy for
seconds, and all joints take minutes."""

_LOOK = 0.01  # [s] between two looks at the arm, the control loop's period

REPORT_SPEEDS = (*SPEEDS, to_rad(90.0))
"""Speeds of the sweeps that ``report-arm`` records [rad/s]; chosen."""

REPORT_REST = 2.0
"""How long a joint stands at each end then [s]: what it stands off is taken after 1.5 s. Chosen."""

_POSITIONS = 2  # every second period is reported: 50 positions a second

Recorded = dict[str, list[float] | list[list[float]]]
"""Times [s], supply of its servo [V] and angles of all joints [rad], the jaw's aperture last."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """The motion of one joint."""

    joint: str
    ends: tuple[float, float]  # the ends between which it moves [rad]
    folds: tuple[float, ...]  # further wrist angles at which it moves as well [rad]
    duration: float  # how long that takes, roughly [s]

    def __str__(self) -> str:
        folds = in_series(f"{to_deg(fold):.0f}°" for fold in self.folds)
        far = f"{self.joint} from {to_deg(self.ends[0]):.0f}° to {to_deg(self.ends[1]):.0f}°"
        return f"{far}, also with the wrist at {folds}" if folds else far


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentificationOutline:
    """The motions of an identification, for the user to agree to."""

    raising: float  # how long the arm takes to the pose in which the sweeps begin [s]
    sweeps: tuple[Sweep, ...]
    obstacles: tuple[tuple[str, str], ...]
    speed: float  # of the fastest [rad/s]

    @property
    def duration(self) -> float:
        """How long it takes about [s]."""
        return self.raising + sum(sweep.duration for sweep in self.sweeps)

    @property
    def sentence(self) -> str:
        return (
            "The arm is raised; then move, one after the other:"
            f" {'; '.join(map(str, self.sweeps))}. At most"
            f" {to_deg(self.speed):.0f}°/s, about {self.duration:.0f} s."
        )


def count_with(arm: Arm, load: Load) -> None:
    """Let plans count with a load that was weighed in the hand.

    Not if it is too light to be sure of, nor if the arm's scene says how heavy the things are that
    the hand holds.
    """
    is_sure = load.mass > 3.0 * load.mass_deviation
    if is_sure and not any(each.mass > 0.0 for each in arm.scene.attached):
        arm.set_payload(Payload(mass=load.mass, com=load.com))


class Identification:
    """Identifies the servos of an arm, once.

    Args:
        rig: Whose arm moves.
        joints: Which joints move, one after the other.
        speeds: The speeds of each sweep [rad/s], slow first; the arm's own cap holds as well.
        rest: How long the joint stands at each end of a sweep [s].
    """

    def __init__(
        self,
        rig: HardwareRig,
        joints: Sequence[str] = ARM_JOINTS,
        speeds: Sequence[float] = SPEEDS,
        rest: float = 0.0,
    ) -> None:
        self._rig = rig
        self._motion: Motion | None = None
        self._cancelled = threading.Event()
        self._joints, self._speeds, self._rest = joints, speeds, rest
        self._rests_until: tuple[float, Future[None]] | None = None
        self._plan = partial(rig.arm.plan, search=None)
        self._computing = OwnProcess()
        self._tape = _Tape(rig)
        self._records: dict[str, JointRecord] = {}

    def outline(self, search: Search | None = None) -> IdentificationOutline:
        """Plan the motions from where the arm stands now; moves nothing."""
        self._plan = partial(self._rig.arm.plan, search=search)
        raising = self._plan(_RAISED, limits=self._limits(SPEEDS[-1]))
        sweeps, obstacles = [], []
        for joint in self._joints:
            try:
                sweeps.append(self._sweep(joint))
            except PlanningError as error:
                obstacles.append((joint, f"{error}. Give the arm more room"))
        return IdentificationOutline(
            raising=raising.duration,
            sweeps=tuple(sweeps),
            obstacles=tuple(obstacles),
            speed=min(self._speeds[-1], self._rig.arm.speed),
        )

    def cancel(self) -> None:
        """End it; the arm slows to rest and holds. Any thread may call; returns at once."""
        self._cancelled.set()
        if self._motion is not None:
            self._motion.interrupt("stop")
        self._computing.kill()

    def move_and_record(
        self,
        outline: IdentificationOutline,
        on_progress: Callable[[str, float], None] = lambda _joint, _share: None,
    ) -> Mapping[str, JointRecord]:
        """Move each joint as outlined and record it. Blocks; the arm moves, then holds."""
        rig, tape, shown = self._rig, self._tape, ""
        listener = rig.servos.on_command

        def hear(command: SentCommand) -> None:
            tape.hear(command)
            if listener is not None:
                listener(command)

        rig.servos.on_command = hear
        end_looking = rig.executor.listen(tape.look)
        try:
            with rig.clock.attend():
                self._motion = motion = rig.arm.start_series(self._steps(outline))
                if self._cancelled.is_set():
                    motion.interrupt("stop")
                while not motion.future.done():
                    rig.clock.wait(rig.clock.now() + _LOOK, None)
                    self._end_rest()
                    if tape.joint != shown:
                        shown = tape.joint
                        done = [each.joint for each in outline.sweeps].index(shown)
                        on_progress(shown, done / len(outline.sweeps))
                motion.result(timeout=0.0)
        finally:
            rig.servos.on_command = listener
            end_looking()
        self._records = tape.records()
        return self._records

    def recorded(self) -> dict[str, Recorded]:
        """What was sent to all joints, and answered, while each moved, by joint."""
        return {joint: self._tape.recorded(joint) for joint in self._records}

    def report(self, *, hand_is_empty: bool, keeps: bool) -> IdentifyReport:
        """Compute the figures from the records, and save them beside the calibration.

        Plans count with a load that was weighed, from now on. It takes half a minute of a
        processor, in a separate process, because an arm may be moving.
        """
        file = self._rig.settings.file
        before = None if file is None else servo_file.read(file)
        known = {} if before is None else before.servos
        found, told = self._computing.call(
            figures, self._records, hand_is_empty=hand_is_empty, known=known, judges_found=keeps
        )
        now = record_of(found)
        kept = servo_file.save(file, now) if keeps and file is not None else None
        if keeps and found.load is not None:
            count_with(self._rig.arm, found.load)
        return IdentifyReport(found=now, before=before, predictions=told, file=kept)

    def _sweep(self, joint: str) -> Sweep:
        i = ARM_JOINTS.index(joint)
        low, high = (to_rad(each) for each in SWEEPS[joint])
        lower, upper = self._rig.arm.range
        low, high = max(low, float(lower[i]) + 0.02), min(high, float(upper[i]) - 0.02)
        trouble: PlanningError | None = None
        for folds in dict.fromkeys((FOLDS.get(joint, ()), ())):
            for share in _SHARES:
                begin, end = (float(BASE[i]) + share * (x - float(BASE[i])) for x in (low, high))
                sweep = Sweep(joint=joint, ends=(begin, end), folds=folds, duration=0.0)
                q, duration = BASE, 0.0
                try:
                    for q_end, speed in _legs(sweep, self._speeds):
                        plan = self._plan(_to(q_end), limits=self._limits(speed), q_start=q)
                        q, duration = q_end, duration + plan.duration + 0.2 + self._rest
                except PlanningError as error:
                    trouble = trouble or error
                    continue
                return replace(sweep, duration=duration)
        assert trouble is not None
        raise trouble

    def _limits(self, speed: float) -> MotionLimits:
        """Caps with at most ``speed`` [rad/s], within the arm's own."""
        most = ACCELERATION * max(1.0, speed / SPEEDS[-1])
        acceleration = min(most, self._rig.arm.acceleration)
        return MotionLimits.uniform(
            velocity=min(speed, self._rig.arm.speed),
            acceleration=acceleration,
            jerk=acceleration / JERK_TIME,
        )

    def _steps(self, outline: IdentificationOutline) -> Iterator[Step]:
        yield self._plan(_RAISED, limits=self._limits(SPEEDS[-1]))
        for sweep in outline.sweeps:
            for _ in range(_TRIES):
                self._tape.begin(sweep.joint)
                yield self._stand
                for q_end, speed in _legs(sweep, self._speeds):
                    yield self._plan(_to(q_end), limits=self._limits(speed))
                    yield self._stand
                if (gap := self._tape.silence(sweep.joint)) < _GAP:
                    break
            else:
                raise MotionError(
                    f"{sweep.joint} did not answer for {gap:.2f} s while it moved, {_TRIES} times,"
                    " so its figures would be wrong; end what keeps the computer busy, check the"
                    " cable, then try again"
                )

    def _stand(self, motion: Motion) -> None:
        if self._rest:
            over: Future[None] = running_future()
            self._rests_until = (self._rig.clock.now() + self._rest, over)
            motion.wait_for(over)

    def _end_rest(self) -> None:
        if self._rests_until is not None and self._rig.clock.now() >= self._rests_until[0]:
            over, self._rests_until = self._rests_until[1], None
            over.set_result(None)


class _Tape:
    """Records the moving joint's states and the commands to its servo."""

    def __init__(self, rig: HardwareRig) -> None:
        self.joint = ""  # that moves
        self._rig = rig
        self._states: dict[str, list[tuple[JointState, float]]] = {}
        self._sent: list[SentCommand] = []

    def begin(self, joint: str) -> None:
        """Record this joint from now on; what was recorded of it before is forgotten."""
        self.joint = joint
        self._states.pop(joint, None)

    def hear(self, command: SentCommand) -> None:
        self._sent.append(command)

    def look(self, state: JointState) -> None:
        joint = self.joint
        for health in self._rig.servos.health:  # none without a port
            if health.joint == joint:
                self._states.setdefault(joint, []).append((state, health.volts))

    def silence(self, joint: str) -> float:
        """The longest time for which a joint did not answer while it was recorded [s]."""
        longest, answered = 0.0, -math.inf
        for state, _ in tuple(self._states.get(joint, ())):
            if answered == -math.inf or joint not in state.reading.unanswered:
                answered = state.t
            longest = max(longest, state.t - answered)
        return longest

    def records(self) -> dict[str, JointRecord]:
        noted = dict(self._states)  # the I/O thread may just be adding one
        return {joint: self._record(joint, tuple(states)) for joint, states in noted.items()}

    def _record(self, joint: str, states: Sequence[tuple[JointState, float]]) -> JointRecord:
        i, servos = ARM_JOINTS.index(joint), self._rig.servos
        joint_map, model = servos.setups[joint].map, servos.models[joint]
        begin, end = states[0][0].t - 0.5, states[-1][0].t
        sent = [
            (each.t, each.goals[joint_map.servo_id])
            for each in tuple(self._sent)
            if begin <= each.t <= end and joint_map.servo_id in each.goals
        ]
        return JointRecord(
            index=i,
            kind=model.sold_as,
            p_gain=model.p_gain,
            acceleration=model.braking,
            zero_ticks=joint_map.zero_ticks,
            direction=joint_map.direction,
            t=np.array([state.t for state, _ in states]),
            ticks=np.array([float(joint_map.to_ticks(float(s.q[i]))) for s, _ in states]),
            q=np.array([state.q for state, _ in states]),
            qd_ref=np.array([float(state.qd_ref[i]) for state, _ in states]),
            volts=np.array([volts for _, volts in states]),
            t_goals=np.array([t for t, _ in sent]),
            goals=np.array([float(goal) for _, goal in sent]),
        )

    def recorded(self, joint: str) -> Recorded:
        states, rig = self._states[joint], self._rig
        maps = [rig.servos.setups[each].map for each in ARM_JOINTS]
        jaw = 0.0 if rig.gripper is None else float(rig.gripper.aperture)
        begin, end = states[0][0].t, states[-1][0].t
        at = [float(x) for x in states[0][0].q]
        command: list[list[float]] = []
        when: list[float] = []
        for each in self._sent:
            if not (begin <= each.t <= end and each.goals):
                continue
            for i, joint_map in enumerate(maps):
                if joint_map.servo_id in each.goals:
                    at[i] = joint_map.to_rad(Ticks(each.goals[joint_map.servo_id]))
            command.append([*(round(x, 4) for x in at), round(jaw, 3)])
            when.append(round(each.t - begin, 4))
        shown = states[::_POSITIONS]
        return {
            "t_cmd_s": when,
            "command": command,
            "t_s": [round(state.t - begin, 4) for state, _ in shown],
            "position": [[*(round(float(x), 4) for x in s.q), round(jaw, 3)] for s, _ in shown],
            "volts": [round(volts, 1) for _, volts in shown],
        }


def _legs(sweep: Sweep, speeds: Sequence[float]) -> Iterator[tuple[Array, float]]:
    """The motions of a sweep: goal configurations [rad] and speeds [rad/s]."""
    i = ARM_JOINTS.index(sweep.joint)
    for fold in (None, *sweep.folds):
        base = BASE if fold is None else _with(BASE, _WRIST, fold)
        low, high = (_with(base, i, end) for end in sweep.ends)
        yield low, SPEEDS[-1]
        for speed in speeds if fold is None else speeds[:1]:
            yield high, speed
            yield low, speed
    far, times = STROKES.get(sweep.joint, (0.0, 0))
    for _ in range(times):
        for side in (-far, far):
            yield _with(BASE, i, float(np.clip(BASE[i] + side, *sweep.ends))), SPEEDS[-1]
    yield BASE, SPEEDS[-1]


def _with(q: Array, i: int, angle: float) -> Array:
    found = q.copy()
    found[i] = angle
    return found


def _to(q: Array) -> PathGoal:
    return PathGoal(waypoints=q[None], tolerance=0.0)
