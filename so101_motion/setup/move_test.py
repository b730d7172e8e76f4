"""Test an arm by small slow motions of each joint, and measure how well each follows its goals.

One joint after the other moves by ``SWING`` to either side, so it stops three times in its middle
position, coming from both sides, and at both ends; the jaw opens a little and closes again. At each
stop the angle is averaged. Nothing moves before ``outline`` has found a swing within the range and
free of contact for each joint, and the user has agreed. ``move_and_measure`` then runs all of it as
one motion, so that a stop ends it at any time; each leg is planned again from where the arm then
is. The first trouble ends the test, and so does ``cancel``; the arm holds where it is.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, wait
from contextvars import copy_context
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from so101_motion.arm.arm import Arm
from so101_motion.arm.gripper import move_jaw
from so101_motion.arm.motion_handle import Motion, Step
from so101_motion.common.errors import (
    Interrupted,
    NotPossibleNow,
    PlanningError,
    So101Error,
    in_series,
)
from so101_motion.common.geometry import Array
from so101_motion.common.modes import HELD, Mode
from so101_motion.common.operation import LocalOperation, Offer, Picture, Row, Tone, View
from so101_motion.common.state import ANSWERS_AGAIN, ARM_JOINTS, GRIPPER_JOINT, JointState
from so101_motion.common.units import to_deg, to_mm, to_rad
from so101_motion.control.request_queue import own_thread, running_future
from so101_motion.planning.goals import PathGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.protocols import GripperLike, RigLike
from so101_motion.setup.calibration_operation import OPEN_POSE
from so101_motion.setup.setup_steps import TEST

Verdict = Literal["ok", "warn", "fail", "not tested"]

SCHEMA = "so101/move-test/1"


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Above ``warn`` there is a warning, above ``fail`` a failure."""

    warn: float
    fail: float

    def judge(self, value: float | None) -> Verdict:
        if value is None or value <= self.warn:
            return "ok"
        return "warn" if value <= self.fail else "fail"


ERROR = Bounds(warn=to_rad(0.5), fail=to_rad(1.5))
"""At rest [rad]. The driver trims a joint to a quarter of a degree; 1.5 deg are 8 mm at full
stretch. Chosen."""

JAW_ERROR = Bounds(warn=to_rad(2.5), fail=to_rad(6.0))
"""The same for the jaw, whose standing error nobody corrects. Chosen."""

HYSTERESIS = Bounds(warn=to_rad(0.6), fail=to_rad(1.5))
"""Between the two sides [rad]: a trimmed joint may stop at either end of the trim's dead band.
Chosen."""

LAG = Bounds(warn=0.15, fail=0.30)
"""While it moves [s]. Servos were seen up to 0.1 s behind. Chosen."""

SETTLE = Bounds(warn=1.0, fail=2.0)
"""After the end of a motion [s]; the driver gives up after 2 s. Chosen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointAccuracy:
    """How well one joint followed its goals."""

    joint: str
    error: float | None = None  # largest error at rest [rad]; None if it never came to rest
    # how much that differs with the side it came from [rad]; None if not known
    hysteresis: float | None = None
    lag: float | None = None  # how far behind its setpoints it ran [s]; None if those are not known
    # how long it took at most to come to rest [s]; None if setpoints are not known
    settle: float | None = None
    # largest error of the tool through all joints together [m]; None for the jaw
    tool: float | None = None
    trouble: str = ""  # why it could not be tested to the end; empty if it was

    @property
    def verdict(self) -> Verdict:
        if self.error is None:
            return "fail" if self.trouble else "not tested"
        return "fail" if self.trouble else max((v for v, _ in self._findings()), key=_RANK.index)

    @property
    def sentence(self) -> str:
        if self.trouble:
            return self.trouble
        return "; ".join(sentence for verdict, sentence in self._findings() if verdict != "ok")

    def _findings(self) -> list[tuple[Verdict, str]]:
        error = JAW_ERROR if self.joint == GRIPPER_JOINT else ERROR
        return [
            (error.judge(self.error), "it stops short: free the joint, look for weight or a cable"),
            (HYSTERESIS.judge(self.hysteresis), "it sticks or has play: check its horn and screws"),
            (LAG.judge(self.lag), "it lags: check the supply and its voltage"),
            (SETTLE.judge(self.settle), "it settles slowly: something holds it back"),
        ]

    def to_json(self) -> dict[str, Any]:
        return {
            "joint": self.joint,
            "verdict": self.verdict,
            "error_deg": _rounded(self.error, _DEG, 3),
            "hysteresis_deg": _rounded(self.hysteresis, _DEG, 3),
            "lag_ms": _rounded(self.lag, _MS),
            "settle_ms": _rounded(self.settle, _MS),
            "tool_mm": _rounded(self.tool, _MM),
            "sentence": self.sentence,
        }


def reasons(joints: Iterable[JointAccuracy]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for joint in joints:
        if joint.sentence:
            found.setdefault(joint.sentence, []).append(joint.joint)
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveReport:
    """The result of a move test."""

    arm: str
    joints: tuple[JointAccuracy, ...]
    began_at: str  # its begin, as an ISO date and time with its zone
    seconds: float  # how long it took [s]
    ended_by: str = ""  # why it ended early; empty if it did not
    # whether the user saw the arm move as its picture did, which no encoder can tell; None without
    # an answer
    as_shown: bool | None = None

    @property
    def passed(self) -> bool:
        fit = all(joint.verdict in ("ok", "warn") for joint in self.joints)
        return fit and not self.ended_by and self.as_shown is not False

    @property
    def sentence(self) -> str:
        if self.ended_by:
            return f"The test was not finished: {self.ended_by}"
        if self.as_shown is False:
            return (
                "Failed: the arm does not move as in the picture. Two motors may be swapped: set"
                " the motors up again, then calibrate"
            )
        bad = [joint.joint for joint in self.joints if joint.verdict not in ("ok", "warn")]
        if bad:
            return f"Failed: {', '.join(bad)}"
        warned = [joint.joint for joint in self.joints if joint.verdict == "warn"]
        return (
            f"Passed, but look at {', '.join(warned)}"
            if warned
            else "Passed: all joints move as commanded"
        )

    @property
    def verdict(self) -> Literal["ok", "warn", "fail"]:
        if not self.passed:
            return "fail"
        return "warn" if any(joint.verdict == "warn" for joint in self.joints) else "ok"

    @property
    def fix(self) -> str:
        if self.passed:
            return ""
        return "test again" if self.ended_by else "read the note at each joint, then test again"

    @property
    def tool(self) -> float | None:
        """How far the tool was off at most [m]; None if that was not measured."""
        return max((j.tool for j in self.joints if j.tool is not None), default=None)

    def to_json(self) -> dict[str, Any]:
        return {
            "arm": self.arm,
            "began_at": self.began_at,
            "seconds": _rounded(self.seconds, 1.0),
            "passed": self.passed,
            "sentence": self.sentence,
            "as_shown": self.as_shown,
            "tool_mm": _rounded(self.tool, _MM),
            "joints": [joint.to_json() for joint in self.joints],
        }

    def file(self, versions: Mapping[str, str] | None = None) -> bytes:
        content = {"schema": SCHEMA, **(versions or {}), **self.to_json()}
        return json.dumps(content, indent=2).encode() + b"\n"


class Measurements:
    """The measurements of one joint so far."""

    def __init__(self, joint: str) -> None:
        self._joint = joint
        self.tool = self._settle = 0.0
        self._error: float | None = None
        self._behind: list[tuple[float, float]] = []  # (error, speed) while it moved
        self._visits: dict[float, dict[bool, list[float]]] = {}  # place: from below: angles

    def note_motion(self, i: int, states: list[JointState]) -> None:
        moving = [state for state in states if state.arm_moving]
        moving_refs = [state for state in moving if state.qd_ref[i] != 0.0]
        self._behind += [(float(s.q_ref[i] - s.q[i]), float(s.qd_ref[i])) for s in moving_refs]
        if moving_refs:
            self._settle = max(self._settle, moving[-1].t - moving_refs[-1].t)

    def note_stop(self, wanted: float, here: float, *, is_from_below: bool) -> None:
        """Add a stop: the wanted and the measured angle [rad]."""
        self._error = max(self._error or 0.0, abs(here - wanted))
        visits = self._visits.setdefault(round(wanted, 4), {False: [], True: []})
        visits[is_from_below].append(here)

    def note_jaw(self, off: float) -> None:
        """Add how far the jaw was off [rad]."""
        self._error = max(self._error or 0.0, abs(off))

    def accuracy(self) -> JointAccuracy:
        lag, is_jaw = self._lag(), self._joint == GRIPPER_JOINT
        return JointAccuracy(
            joint=self._joint,
            error=self._error,
            hysteresis=self._hysteresis(),
            lag=lag,
            settle=None if lag is None else self._settle,
            tool=None if is_jaw or self._error is None else self.tool,
        )

    def _hysteresis(self) -> float | None:
        """The most that two stops in one place differ with the side they were reached from."""
        apart = [
            abs(float(np.mean(sides[True])) - float(np.mean(sides[False])))
            for sides in self._visits.values()
            if sides[True] and sides[False]
        ]
        return max(apart, default=None)

    def _lag(self) -> float | None:
        """How late the joint is [s], by least squares.

        To first order a joint that is late by ``lag`` is off by ``lag`` times its speed. None where
        the arm does not tell setpoints apart from measurements.
        """
        pairs = np.array(self._behind).reshape(-1, 2)
        error, speed = pairs[:, 0], pairs[:, 1]
        if not np.any(error):
            return None
        return max(float(error @ speed / (speed @ speed)), 0.0)


_RANK: tuple[Verdict, ...] = ("ok", "warn", "fail")


_DEG, _MM, _MS = to_deg(1.0), to_mm(1.0), 1e3  # so many are one radian, metre, second


def _rounded(value: float | None, unit: float, digits: int = 1) -> float | None:
    return None if value is None else round(unit * value, digits) + 0.0


def _shown(value: float | None, unit: float, form: str) -> str:
    return "–" if value is None else form.format(unit * value)


SWING = to_rad(6.0)
"""How far a joint moves to either side [rad]; chosen: 40 mm at the jaws of a stretched arm."""

JAW_SWING = 0.12  # how far the jaw opens, share of its travel; chosen: 13 deg

LIMITS = MotionLimits.uniform(velocity=to_rad(15.0), acceleration=to_rad(60.0), jerk=to_rad(600.0))
"""Caps of the motions; chosen: a hand can get out of the way."""

AVERAGED = 0.3  # how long a standing joint is averaged [s]; chosen: 30 readings

_MARGIN = to_rad(1.0)  # [rad] that a joint keeps from the ends of its range
_SLOW = 0.4  # [s] that a stop takes beyond the measurement: to slow down and to settle
_SHIFTS = (0.0, 1.0, -1.0)  # where the middle of a swing may be, in swings from where it stands
_LOOK = 0.01  # [s] between two looks at the arm, the control loop's period
_MOVED = to_rad(
    0.5
)  # [rad]; an arm that was moved farther since the test was planned needs a new plan

_BY_HAND = (
    "Move it by hand to a pose like the blue ghost's, clear of everything, then press Hold the"
    " joints."
)
_FIXED = "once that is fixed, press Hold the joints, with a hand on the arm"
_GO_ON = "press Hold the joints to go on; until then each servo does what it did"
_CLEAR = (
    "Start only when nothing is in its way and no hand is near it. To change its pose first, guide"
    " it by hand."
)
_SEEN = "Did the arm move as in the picture: the same joints, in the same directions?"
_FIGURES = (
    "Off: how far each joint rests from its target. Sides: how much that depends on where it came"
    " from. Behind: how late it is in motion."
)
MARKS: dict[str, tuple[str, Tone]] = {
    "ok": ("✓", "good"),
    "warn": ("!", "warm"),
    "fail": ("✗", "bad"),
    "not tested": ("–", "dim"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Swing:
    """The test motion of one joint."""

    joint: str
    # where it will stop, one after the other: angles [rad], for the jaw apertures. It begins and
    # ends where it is now
    stops: tuple[float, ...]
    duration: float  # how long that takes, roughly [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outline:
    """The motions of a test, for the user to agree to."""

    swings: tuple[Swing, ...]  # the motions, in order
    obstacles: tuple[tuple[str, str], ...]  # joints that cannot be tested, each with the reason

    @property
    def duration(self) -> float:
        """How long the test takes about [s]."""
        return sum(swing.duration for swing in self.swings)

    @property
    def left_out(self) -> str:
        if not self.obstacles:
            return ""
        joints = in_series(joint for joint, _ in self.obstacles)
        if self.obstacles[0][0] == GRIPPER_JOINT:
            return f"The {joints} is left out: {self.obstacles[0][1]}."
        return (
            f"Too little room to test: {joints}. To test them too, let go, move the arm to a more"
            " open pose, then press Hold."
        )

    @property
    def sentence(self) -> str:
        moved = [swing.joint for swing in self.swings if swing.joint != GRIPPER_JOINT]
        jaw = any(swing.joint == GRIPPER_JOINT for swing in self.swings)
        by = f"one after the other, by {to_deg(SWING):.0f}° back and forth"
        parts = [f"{', '.join(moved)}: {by}"] if moved else []
        parts += ["the jaw opens and closes a little"] if jaw else []
        speed_deg = to_deg(float(LIMITS.velocity[0]))
        return f"{'; '.join(parts)}. At most {speed_deg:.0f}°/s, about {self.duration:.0f} s."


class MoveTest(LocalOperation):
    """Tests an arm by small motions; ``hold`` holds its joints where they stand."""

    def __init__(
        self, rig: RigLike, *, name: str = "arm", hold: Callable[[], object] = lambda: None
    ) -> None:
        super().__init__()
        self._arm, self._gripper, self._clock, self._name = rig.arm, rig.gripper, rig.clock, name
        self._hold = hold
        self._motion: Motion | None = None
        self._cancelled = threading.Event()
        self.report: MoveReport | None = None
        self._outline: Outline | None = None
        self._q_planned: Array | None = None  # where the arm stood then, its jaw last [rad]
        self._run: _Run | None = None
        self._running: Future[MoveReport] | None = None
        self.commands = {
            "hold": self._hold_joints,
            "plan": self._plan,
            "move": self._move,
            "stop": self.cancel,
            "answer": self._answer,
        }

    @property
    def is_running(self) -> bool:
        return self._running is not None and not self._running.done()

    @property
    def asks(self) -> bool:
        report = self.report
        return report is not None and report.as_shown is None and not report.ended_by

    @property
    def view(self) -> View:
        state, report, run = self._arm.state, self.report, self._run
        holds, is_running = state.mode in HELD, self.is_running
        joint = run.joint if run is not None and is_running else ""
        is_loose = state.mode in (Mode.LIMP, Mode.GUIDING)
        show = partial(
            View,
            title=TEST.title,
            picture=Picture(
                q=(*map(float, state.q), state.q_jaw),
                ghost=(*map(float, OPEN_POSE), state.q_jaw) if is_loose else (),
                lit=(joint,) if joint else (),
            ),
        )
        if is_running:
            return show(
                state="moving",
                doing=f"moving {joint}; Space or Stop ends it" if joint else "it begins",
                columns=_COLUMNS,
                rows=() if run is None else run.rows(),
                offers=(Offer(command="stop", title="Stop the test"),),
            )
        hold = () if holds else (Offer(command="hold", title="Hold the joints", key="h"),)
        if report is not None and (holds or not report.ended_by):
            return self._view_of(show, report, hold)
        if not holds:
            yields = "yields to your hand" if state.mode is Mode.GUIDING else "is not held"
            is_fault = state.mode is Mode.FAULT
            return show(
                state="loose",
                text="" if is_fault else f"The arm {yields}. {_BY_HAND}",
                trouble=(state.fault or "the arm has ended its motion by itself") * is_fault,
                fix=(_GO_ON if state.fault == ANSWERS_AGAIN else _FIXED) * is_fault,
                offers=hold,
            )
        is_here = self._is_planned_here(state)
        error = None if self._running is None else self._running.exception()
        show = partial(show, trouble="" if error is None else str(error))
        outline = self._outline
        if outline is None or not is_here:
            is_due = not is_here and state.mode is Mode.HOLDING
            plan = Offer(command="plan", title="Plan the test", due_in=0.0 if is_due else None)
            return show(state="held", text=TEST.instruction, offers=(plan,))
        nowhere = None if outline.swings else "no joint has room to move"
        move = Offer(
            command="move",
            title="Move and measure",
            why_not="a servo has an alarm" if state.reading.alarms else nowhere,
            asks="Is everything out of the way? Press again",
            key="m",
        )
        text = f"This will move: {outline.sentence}"
        note = " ".join(filter(None, (outline.left_out, _CLEAR)))
        return show(state="planned", text=text, note=note, offers=(move,))

    def _view_of(
        self, show: Callable[..., View], report: MoveReport, hold: tuple[Offer, ...]
    ) -> View:
        why = "the arm is not held" if hold else None
        again = Offer(command="plan", title="Test again", why_not=why, key="t")
        answers = (
            Offer(command="answer", title="Yes", arguments={"as_shown": True}, key="y"),
            Offer(command="answer", title="No, it differs", arguments={"as_shown": False}, key="n"),
        )
        text = [report.sentence] * report.passed + [_SEEN] * self.asks
        tool = ""
        if report.tool is not None:
            tool = f"The tool was at most {to_mm(report.tool):.1f} mm off."
        is_measured = any(joint.error is not None for joint in report.joints)
        return show(
            state="tested",
            text=". ".join(text),
            trouble="" if report.passed else report.sentence,
            fix=report.fix,
            columns=_COLUMNS * is_measured,
            rows=_rows(report.joints) if is_measured or reasons(report.joints) else (),
            note=f"{tool} {_FIGURES}".strip() if is_measured else "",
            offers=(*hold, *(answers if self.asks else ()), again),
            is_over=report.passed and not self.asks,
            facts=report.to_json(),
        )

    def close(self) -> None:
        self.cancel()
        if self._running is not None:
            wait((self._running,))

    def forget(self) -> None:
        self.report = self._q_planned = self._running = None

    # The commands

    def _hold_joints(self) -> None:
        self._hold()

    def _plan(self) -> dict[str, Any]:
        state = self._arm.state
        self.report = None
        self._outline, self._q_planned = None, np.append(state.q_ref, state.q_jaw_ref)
        self._outline = outline = self.outline()
        return {"will_move": outline.sentence, "cannot_move": dict(outline.obstacles)}

    def _move(self) -> None:
        outline = self._outline
        if self.is_running or outline is None or not self._is_planned_here(self._arm.state):
            raise NotPossibleNow("move", "plan the test first, while the arm is held")
        self._outline, self._run = None, None
        self._cancelled.clear()
        begun = partial(copy_context().run, self.move_and_measure, outline)  # a stop ends it
        self._running = own_thread(begun)

    def _answer(self, as_shown: bool) -> None:
        if self.report is not None:
            self.report = replace(self.report, as_shown=as_shown)

    def _is_planned_here(self, state: JointState) -> bool:
        q = np.append(state.q_ref, state.q_jaw_ref)
        return self._q_planned is not None and bool(
            np.allclose(q, self._q_planned, rtol=0.0, atol=_MOVED)
        )

    # Planning and moving

    def outline(self) -> Outline:
        """Plan the test from where the arm stands now; moves nothing."""
        swings, obstacles = [], []
        q = self._arm.state.q_ref
        for i, joint in enumerate(ARM_JOINTS):
            try:
                swings.append(self._swing(i, q))
            except PlanningError as error:
                why = str(error).partition("; ")[0]  # how to go on is the same for all joints
                obstacles.append((joint, f"{why}. Move the arm to a more open pose"))
        if self._gripper.is_holding:
            obstacles.append((GRIPPER_JOINT, "it holds something; take it out of the jaws"))
        else:
            here = min(max(self._gripper.aperture, 0.0), 1.0)
            there = here + JAW_SWING if here + JAW_SWING <= 1.0 else here - JAW_SWING
            swings.append(Swing(joint=GRIPPER_JOINT, stops=(here, there, here), duration=2.0))
        return Outline(swings=tuple(swings), obstacles=tuple(obstacles))

    def cancel(self) -> None:
        """End the test; the arm slows to rest and holds. Any thread may call; returns at once."""
        self._cancelled.set()
        if self._motion is not None:
            self._motion.interrupt("stop")

    def move_and_measure(
        self,
        outline: Outline,
        on_progress: Callable[[str, float], None] = lambda _joint, _share: None,
    ) -> MoveReport:
        """Move each joint as outlined and measure it. Blocks; the arm's troubles are not raised."""
        began_at, t_begin = datetime.now(UTC), self._clock.now()
        self._run = run = _Run(self._arm, self._gripper, outline, on_progress)
        with self._clock.attend():
            self._motion = motion = self._arm.start_series(run.steps())
            if self._cancelled.is_set():  # before there was a motion
                motion.interrupt("stop")
            while not motion.future.done():
                self._clock.wait(self._clock.now() + _LOOK, None)
                run.look(self._arm.state)
        ended_by = run.end(motion.future.exception())
        self.report = MoveReport(
            arm=self._name,
            joints=run.results(),
            began_at=began_at.isoformat(timespec="seconds"),
            seconds=self._clock.now() - t_begin,
            ended_by=ended_by,
        )
        return self.report

    def _swing(self, i: int, q: Array) -> Swing:
        lower, upper = self._arm.range
        trouble: PlanningError | None = None
        for shift in _SHIFTS:
            stops = _stops(float(q[i]), float(q[i]) + shift * SWING)
            if not lower[i] + _MARGIN <= min(stops) <= max(stops) <= upper[i] - _MARGIN:
                continue
            try:
                way = self._arm.plan(_through(q, i, stops[1:]), limits=LIMITS)
            except PlanningError as error:
                trouble = trouble or error
                continue
            pauses = (len(stops) - 1) * (AVERAGED + _SLOW)
            return Swing(joint=ARM_JOINTS[i], stops=stops, duration=way.duration + pauses)
        raise trouble or PlanningError(
            f"{ARM_JOINTS[i]} stands at {to_deg(float(q[i])):.0f} deg, too near an end of its range"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Stop:
    """A stop that is being measured."""

    over: Future[None]
    # where the arm should stand, shape (5,), [rad]; None while the jaw is measured
    q_goal: Array | None
    is_from_below: bool = False


class _Run:
    """One run of the test, from the first motion to the last.

    The motion's own thread runs ``steps``; the caller's thread reads the arm meanwhile (``look``)
    and measures. At each stop the motion waits until that is done.
    """

    def __init__(
        self,
        arm: Arm,
        gripper: GripperLike,
        outline: Outline,
        on_progress: Callable[[str, float], None],
    ) -> None:
        self._arm, self._gripper, self._outline, self._report = arm, gripper, outline, on_progress
        self._model = RobotModel.load()
        self.joint = self._joint = ""  # the last that was reported, and the one that moves now
        self._done: tuple[JointAccuracy, ...] = ()
        self._taken: dict[str, Measurements] = {}
        self._trouble: dict[str, str] = dict(outline.obstacles)
        self._stop: _Stop | None = None
        self._states: list[JointState] = []
        self._stood: list[JointState] = []

    # The motion's thread

    def steps(self) -> Iterator[Step]:
        for swing in self._outline.swings:
            self._taken[swing.joint] = Measurements(swing.joint)
            self._joint = swing.joint
            if swing.joint == GRIPPER_JOINT:
                yield partial(self._move_jaw, swing.stops)
                continue
            i = ARM_JOINTS.index(swing.joint)
            for begin, end in pairwise(swing.stops):
                plan = self._arm.plan(_through(self._arm.state.q_ref, i, (end,)), limits=LIMITS)
                yield plan
                yield partial(self._stand, plan.q_goal, end > begin)

    def _stand(self, q_goal: Array | None, is_from_below: bool, motion: Motion) -> None:
        over: Future[None] = running_future()
        self._stop = _Stop(over=over, q_goal=q_goal, is_from_below=is_from_below)
        motion.wait_for(over)

    def _move_jaw(self, stops: tuple[float, ...], motion: Motion) -> None:
        for aperture in stops[1:]:
            move_jaw(self._gripper, aperture, motion)
            self._stand(None, False, motion)

    # The caller's thread

    def look(self, state: JointState) -> None:
        if self._joint != self.joint:
            swings = self._outline.swings
            done = [swing for swing in swings if swing.joint in self._taken][:-1]
            self._done = tuple(self._taken[swing.joint].accuracy() for swing in done)
            self.joint = self._joint
            total = max(self._outline.duration, 1e-9)
            self._report(self.joint, sum(swing.duration for swing in done) / total)
        stop = self._stop
        if stop is None:
            self._states.append(state)
            return
        if not self._stood or state is not self._stood[-1]:
            self._stood.append(state)
        if state.t - self._stood[0].t >= AVERAGED:
            self._measure(stop)
            self._stop, self._states, self._stood = None, [], []
            stop.over.set_result(None)

    def end(self, error: BaseException | None) -> str:
        if error is None:
            return ""
        if isinstance(error, Interrupted):
            return "it was stopped, and the arm holds" if error.by == "stop" else str(error)
        if not isinstance(error, So101Error):
            raise error
        self._trouble[self._joint] = str(error)
        return f"{self._joint} did not follow" if self._joint else str(error)

    def results(self) -> tuple[JointAccuracy, ...]:
        asked = {swing.joint for swing in self._outline.swings} | set(self._trouble)
        return tuple(
            self._result(joint) for joint in (*ARM_JOINTS, GRIPPER_JOINT) if joint in asked
        )

    def _result(self, joint: str) -> JointAccuracy:
        taken = self._taken.get(joint)
        found = JointAccuracy(joint=joint) if taken is None else taken.accuracy()
        return replace(found, trouble=self._trouble.get(joint, ""))

    def rows(self) -> tuple[Row, ...]:
        left = [swing.joint for swing in self._outline.swings][len(self._done) :]
        marks: dict[bool, tuple[str, Tone]] = {True: ("●", "busy"), False: ("○", "dim")}
        to_come = ((joint, *marks[joint == self.joint]) for joint in left)
        return _rows(self._done) + tuple(Row(label=j, mark=m, tone=t) for j, m, t in to_come)

    def _measure(self, stop: _Stop) -> None:
        taken = self._taken[self._joint]
        if stop.q_goal is None:
            off = [state.q_jaw - state.q_jaw_ref for state in self._stood]
            taken.note_jaw(float(np.mean(off)))
            return
        q = np.mean([state.q for state in self._stood], axis=0)
        p_wanted = self._model.frame(stop.q_goal).p
        taken.tool = max(taken.tool, float(np.linalg.norm(self._model.frame(q).p - p_wanted)))
        i = ARM_JOINTS.index(self._joint)
        taken.note_motion(i, self._states)
        taken.note_stop(float(stop.q_goal[i]), float(q[i]), is_from_below=stop.is_from_below)


_COLUMNS = ("off", "sides", "behind")


def _rows(joints: tuple[JointAccuracy, ...]) -> tuple[Row, ...]:
    """The figures; what is wrong with several joints is said once, under the last of them."""
    rows, wrong = [], reasons(joints)
    for joint in joints:
        alike = wrong.get(joint.sentence, [""])
        names = f"{', '.join(alike)}: " if len(alike) > 1 else ""
        mark, tone = MARKS[joint.verdict]
        angles = (_shown(each, _DEG, "{:.1f}°") for each in (joint.error, joint.hysteresis))
        cells = (*angles, _shown(joint.lag, _MS, "{:.0f} ms"))
        text = f"{names}{joint.sentence}" if alike[-1] == joint.joint else ""
        rows.append(Row(label=joint.joint, cells=cells, text=text, mark=mark, tone=tone))
    return tuple(rows)


def _stops(here: float, middle: float) -> tuple[float, ...]:
    swing = (middle, middle + SWING, middle, middle - SWING, middle)
    return swing if middle == here else (here, *swing, here)


def _through(q: Array, i: int, stops: tuple[float, ...]) -> PathGoal:
    """Configurations in which only joint ``i`` moves along ``stops``."""
    waypoints = np.tile(q, (len(stops), 1))
    waypoints[:, i] = stops
    return PathGoal(waypoints=waypoints, tolerance=0.0)
