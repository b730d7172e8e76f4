"""The calibration as an operation: what a person sees and may do in each state, and the answers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from so101_motion.calib.procedure import summary
from so101_motion.calib.procedure.steps import State
from so101_motion.calib.procedure.summary import HOMING_POSE, PoseEstimate, estimate_pose
from so101_motion.calib.procedure.travel import ROLL, Verdict
from so101_motion.calib.procedure.view import JointView
from so101_motion.calib.record import zero_report
from so101_motion.calib.record.record import JOINTS, Calibration
from so101_motion.calib.record.store import Stored
from so101_motion.common.errors import CalibrationError, So101Error, in_series
from so101_motion.common.named_poses import POSES
from so101_motion.common.operation import LocalOperation, Offer, Picture, Row, View
from so101_motion.common.units import to_deg
from so101_motion.setup.calibrator import Calibrator, Situation, StepResult
from so101_motion.setup.setup_steps import FULL, SetupState, listed

STILL = 1.5  # the pose is taken after the arm was held still for this long [s]. Chosen

ALONE = 3.0
"""How long the arm must be held still for its pose to be taken without a button [s]; chosen: longer
than a hand rests in between."""

MOVED = 114
"""How far a joint must have been moved before [tick], 10 deg; else an arm that just lies there
would count as held. Chosen."""

NOTHING_NEW = 3.0
"""A recording ends by itself when all joints are done and have had no new travel for this long [s].
Chosen."""

GOOD_ENOUGH = 10.0
"""The same without a person, when all joints can be saved but some did not quite reach their stops
[s]. Chosen."""

OPEN_POSE = next(pose.q for pose in POSES if pose.name == "ready")
"""Where every joint has room for its test motion, shape (5,), [rad]."""

_LET_GO = (
    "The joints are about to go limp: hold the arm with one hand, it sinks at once. Nothing is"
    " written to the motors yet."
)
_LIMP = (
    "The joints are limp: put one hand on the arm before you go on. Nothing is written to the"
    " motors yet."
)
_POSE = (
    "Hold every joint about in the middle of its travel: the upper arm upright, forearm and gripper"
    " level and straight ahead, the jaw half open. Then turn the gripper about its long axis until"
    " it opens straight upwards, and look closely: this alone sets the zero of wrist_roll."
)
_SAVE = (
    "Look at what was recorded. Then move the arm to a pose that is clear of everything, and save:"
    " its joints are held there."
)
_NOT_SAVED = (
    "It is not saved yet; what was recorded is kept. Do what is said, then try again. The joints"
    " will be held."
)


class CalibrationOperation(LocalOperation):
    """Calibrates an arm.

    Args:
        calibrator: Carries out the steps; closed with the operation.
        by_itself: Whether a recording begins after the pose and ends by itself, because the
            person's hands hold the arm.
        is_attended: Whether there is a person; without one every step is due at once.
    """

    refuses = False

    def __init__(
        self,
        calibrator: Calibrator,
        *,
        by_itself: bool = False,
        is_attended: bool = True,
    ) -> None:
        super().__init__()
        self.calibrator = calibrator
        self._by_itself, self._is_attended = by_itself or not is_attended, is_attended
        self.ended: StepResult | None = None  # the last save or restore; None before
        self.last_save_error = ""  # empty if the last save did not fail
        self._before: Calibration = {}
        self._saved: tuple[Row, ...] = ()
        self._is_undone = False
        self._waits: tuple[float, float] | None = None  # since when for the pose, and how long
        self._ticks: Mapping[str, int | None] | None = None  # from where a joint must be moved
        self.commands = {
            "start": self._start,
            "take_pose": self._take_pose,
            "take_pose_when_still": self._take_pose_when_still,
            "set_homing": self._set_homing,
            "start_range_recording": self._start_recording,
            "stop_range_recording": self._stop_recording,
            "save_calibration": self._save,
            "restart": self._restart,
            "abort": self._abort,
            "reset": self._reset,
            "restore_calibration": self._restore,
            "get_current_positions": self._get_positions,
            "setup_steps": self._list_steps,
        }

    def close(self) -> None:
        self.calibrator.close()

    # The view

    @property
    def view(self) -> View:
        now = self.calibrator.situation
        state, joints = now.view.state, now.joints
        seen = estimate_pose(state, joints, now.angles)
        title, text = self._words(now)
        rows = self._rows(now, seen)
        return View(
            state=state.value,
            title=title,
            text=text,
            columns=summary.COLUMNS if rows and len(rows[0].cells) > 1 else (),
            rows=rows,
            trouble=now.view.error or "",
            note=self._note(now),
            doing=self._doing(now),
            offers=(*self._offers(now), *(() if state is State.IDLE else (_UNDO,))),
            said=self.said,
            picture=_picture(now, seen, rows),
            is_over=state is State.IDLE and self.ended is not None,
            is_connected=now.is_connected,
            facts=msgspec.to_builtins(now, enc_hook=str),  # a Doubt
        )

    def _words(self, now: Situation) -> tuple[str, str]:
        match now.view.state:
            case State.IDLE if self.ended is not None and self.ended.stored is not None:
                is_back = "The previous calibration is restored" if self._is_undone else "Saved"
                return "Saved", f"{is_back}: {self.ended.stored.path}"
            case State.IDLE:
                return "Homing pose", _LIMP if now.holds is False else _LET_GO
            case State.STARTED:
                return "Homing pose", _POSE
            case State.HOMED:
                return "Homing pose", "The pose is taken."
            case State.RECORDING:
                return "Travel", _recording(now.joints)
            case State.COMPLETED if now.view.error is not None:
                return "Save", _NOT_SAVED
            case State.COMPLETED:
                return "Save", _SAVE
            case State.ERROR:
                return "Homing pose", "It has stopped. Do what is said, then start again."

    def _rows(self, now: Situation, seen: PoseEstimate) -> tuple[Row, ...]:
        match now.view.state:
            case State.COMPLETED:  # what is wrong takes the table's place
                is_well = now.view.error is None
                return summary.lines(now.joints, self._before) if is_well else ()
            case State.IDLE if self._saved:
                return self._saved
            case State.STARTED:
                hints = summary.hints(now.joints, seen)
                return hints if any(hint.tone != "dim" for hint in hints) else ()
            case State.RECORDING:
                return summary.travels(now.joints, rests=now.view.grown_for > NOTHING_NEW)
            case _:
                silent = [joint for joint, view in now.joints.items() if view.ticks is None]
                return tuple(Row(label=j, cells=("does not answer",), tone="bad") for j in silent)

    def _note(self, now: Situation) -> str:
        state, ended = now.view.state, self.ended
        notes = [] if now.view.note is None else [now.view.note]
        if state is State.RECORDING and (blocked := summary.acceptable(now.joints)):
            names = in_series(blocked)
            notes.append(f"Is this as far as {names} can go on your arm? Then accept that.")
        if state is State.COMPLETED:
            notes.append(f"It will be stored in the motors and in {now.calibration_file}.")
        if state is State.IDLE and ended is not None and ended.stored is not None:
            notes += [*ended.stored.notes, ended.trouble or ""]
            notes += _meanings(ended.stored, is_first=not self._before)
        return " ".join(filter(None, notes))

    def _doing(self, now: Situation) -> str:
        if self._waits is None or now.view.state is not State.STARTED:
            return ""
        if not self._is_moved(now):
            return "bring the arm into the pose, then hold still"
        left = self._pose_due(now)
        _, needed = self._waits
        return "hold still: it moves" if left >= needed - 0.05 else f"hold still: {left:.1f} s more"

    def _is_moved(self, now: Situation) -> bool:
        """Whether a joint was moved since the pose is waited for; ticks wrap at 4096."""
        if self._ticks is not None:
            turned = [
                (view.ticks - before + 2048) % 4096 - 2048
                for joint, view in now.joints.items()
                if view.ticks is not None and (before := self._ticks.get(joint)) is not None
            ]
            if not any(abs(each) > MOVED for each in turned):
                return False
            self._ticks = None
        return True

    def _pose_due(self, now: Situation) -> float:
        assert self._waits is not None
        since, needed = self._waits
        return max(needed - min(now.view.held_for, now.view.t - since), 0.0)

    def _offers(self, now: Situation) -> tuple[Offer, ...]:
        at_once = None if self._is_attended else 0.0
        match now.view.state:
            case State.IDLE if self.ended is not None:
                undo = Offer(
                    command="restore_calibration", title="Undo: restore the previous calibration"
                )
                sure = "Press again: the joints go limp"
                again = Offer(command="start", title="Calibrate again", asks=sure)
                return (again,) if self._is_undone or not self._before else (again, undo)
            case State.IDLE:
                start = "Start the calibration" if now.holds is False else "Let go of the joints"
                return (Offer(command="start", title=start, due_in=at_once),)
            case State.STARTED:
                alone = "Take it when I hold still"
                held = Offer(command="take_pose", title="I hold it there", due_in=at_once)
                if self._waits is not None:
                    due = self._pose_due(now) if self._is_moved(now) else None
                    held = Offer(command="set_homing", title="Take the pose now", due_in=due)
                return (held, Offer(command="take_pose_when_still", title=alone, key="h"))
            case State.HOMED:
                due = 0.0 if self._by_itself else None
                return (Offer(command="start_range_recording", title="Record", due_in=due), _AGAIN)
            case State.RECORDING:
                return (*self._finishing(now), _AGAIN)
            case State.COMPLETED:
                title = "Save" if now.view.error is None else "Try to save again"
                return (Offer(command="save_calibration", title=title, due_in=at_once), _AGAIN)
            case State.ERROR:
                return (Offer(command="start", title="Start again"),)  # ``_UNDO`` is a reset

    def _finishing(self, now: Situation) -> tuple[Offer, ...]:
        joints, finish = now.joints, "Finish the recording"
        left = summary.left(joints)
        why = "move every joint to both its stops first" if left else None
        is_through = all(  # more movement would record nothing new
            view.verdict is Verdict.COMPLETE or (view.joint == ROLL and view.is_done)
            for view in joints.values()
        )
        needed = NOTHING_NEW if is_through else None if self._is_attended else GOOD_ENOUGH
        due = None
        if self._by_itself and needed is not None and not left:
            due = needed - now.view.grown_for
            due = max(due, 0.0) if due < NOTHING_NEW else None
        stop = Offer(command="stop_range_recording", title=finish, why_not=why, due_in=due)
        blocked = summary.acceptable(joints)
        if not left or not blocked:
            return (stop,)
        title, blocked_by = f"{finish}, accept {' and '.join(blocked)}", {"accept": [*blocked]}
        return (stop, Offer(command=stop.command, title=title, arguments=blocked_by, key="a"))

    # The commands

    def _start(self) -> dict[str, Any]:
        now = self.calibrator.situation
        if now.view.state is State.IDLE:
            self._before = summary.in_force(now.joints)
        self.calibrator.start()
        self.ended, self._saved, self._is_undone, self._waits = None, (), False, None
        if (note := self.calibrator.situation.view.note) is not None:
            self.say(note, "warm")
        self.say("the joints are limp", step="limp")
        return self._next()

    def _take_pose(self) -> None:
        self._waits, self._ticks = (self._in(State.STARTED).view.t, STILL), None

    def _take_pose_when_still(self) -> None:
        now = self._in(State.STARTED)
        self._waits = now.view.t, ALONE
        self._ticks = {joint: view.ticks for joint, view in now.joints.items()}

    def _in(self, state: State) -> Situation:
        now = self.calibrator.situation
        if now.view.state is not state:
            raise CalibrationError(None, "the pose cannot be taken now", "start first")
        return now

    def _set_homing(self) -> dict[str, Any]:
        self._waits = None
        self.calibrator.set_homing()
        self.say("the homing pose is taken", "good", step="homed")
        joints = self.calibrator.situation.view.joints
        offsets = {str(joint.servo_id): joint.homing_offset for joint in joints.values()}
        return {**self._next(), "homing_offsets": offsets}

    def _start_recording(self) -> dict[str, Any]:
        self.calibrator.start_recording()
        return self._next()

    def _stop_recording(self, accept: tuple[str, ...] = ()) -> dict[str, Any]:
        view = self.calibrator.stop_recording(accept)
        return {
            **self._next(),
            "recording_duration": round(view.recording_time, 3),
            "samples_collected": view.samples,
            "ranges": ranges(view.joints),
        }

    def _save(self) -> dict[str, Any]:
        lines = summary.lines(self.calibrator.situation.joints, self._before)
        try:
            stored = self.calibrator.save()
        except So101Error as error:
            self.last_save_error = str(error)
            raise
        done = self.calibrator.ended
        self.last_save_error, self.ended, self._saved = "", done, lines
        saved = f"The calibration is saved in {stored.path} and stored in the servos."
        message = " ".join((saved, *(f"{note}." for note in stored.notes)))
        return {
            **self._over(done, message),
            "calibration_file": str(stored.path),
            "joints_calibrated": len(self.calibrator.situation.joints),
        }

    def _restart(self) -> dict[str, Any]:
        self.calibrator.abort()
        return self._start()

    def _abort(self) -> dict[str, Any]:
        self.calibrator.abort()
        done = self.calibrator.ended
        self.say(f"cancelled: {done.put_back}", "warm")
        return self._over(done, "The calibration was aborted; everything is as it was before.")

    def _reset(self) -> dict[str, Any]:
        self.calibrator.reset()
        return self._over(
            self.calibrator.ended, "Ready to start anew; everything is as it was before."
        )

    def _restore(self, number: int | None = None) -> dict[str, Any]:
        done = self.calibrator.restore(number)
        self.ended, self._is_undone = done, True
        assert done.stored is not None
        message = f"{done.stored.path} and the servos have the earlier calibration again."
        return {**self._over(done, message), "calibration_file": str(done.stored.path)}

    def _get_positions(self) -> dict[str, Any]:
        now = self.calibrator.situation
        found = {joint: view for joint, view in now.joints.items() if view.ticks is not None}
        if not found:
            raise CalibrationError(
                None,
                "no servo answers" if now.is_connected else "the port is not connected",
                "check the arm's power supply and its cables",
            )
        positions = {
            joint: {
                "servo_id": view.servo_id,
                "raw_position": view.ticks,
                "radians": now.angles[joint],
                "degrees": to_deg(now.angles[joint]),
            }
            for joint, view in found.items()
        }
        return {"positions": positions, "silent": [j for j in now.joints if j not in found]}

    def _list_steps(self, workflow: str = FULL.name) -> dict[str, Any]:
        return listed(workflow, SetupState.of(self.calibrator))

    def _next(self) -> dict[str, Any]:
        view = self.calibrator.situation.view
        message = view.instruction if view.note is None else f"{view.note} {view.instruction}"
        return {"state": view.state.value, "message": message}

    def _over(self, ended: StepResult, message: str) -> dict[str, Any]:
        state = self.calibrator.situation.view.state
        joints = "The joints are held." if ended.holds else "The joints are limp."
        return {
            "state": state.value,
            "message": f"{message} {joints if ended.trouble is None else f'But {ended.trouble}'}",
            "torque_enabled": ended.holds,
        }


_UNDO = Offer(command="abort", title="undo everything and stop", cancels=True)
_AGAIN = Offer(
    command="restart", title="Take the pose again", asks="Press again to start anew", key="r"
)


def ranges(joints: Mapping[str, JointView]) -> dict[str, Any]:
    """The recorded travels [tick]."""
    return {
        joint: {"min": view.recorded_min, "max": view.recorded_max, "range": view.travel}
        for joint, view in joints.items()
        if view.recorded_min is not None
    }


def _recording(joints: Mapping[str, JointView]) -> str:
    missing, short = summary.left(joints), summary.short(joints)
    if missing:
        return (
            "Move every joint slowly through its whole travel, to both stops, in any order. Its bar"
            " shows how many degrees are recorded, and turns green when that is enough."
            f" Still to do: {', '.join(missing)}."
        )
    if short:
        them, go = ("it", "it goes") if len(short) == 1 else ("them", "they go")
        return (
            f"Not quite at both stops yet: {', '.join(short)}. Move {them} further; if {go} no"
            " further, put the arm down, then finish."
        )
    return "All joints have been at their stops. Put the arm down, then finish."


def _picture(now: Situation, seen: PoseEstimate, rows: tuple[Row, ...]) -> Picture:
    state = now.view.state
    ghost: tuple[float, ...] = ()
    lit: tuple[str, ...] = ()
    notes = []
    if state is State.STARTED:
        notes.append("The blue ghost shows the pose.")
        ghost = tuple(HOMING_POSE[joint] for joint in JOINTS)
        lit = tuple(row.label for row in rows if row.tone == "warm")
    elif state is State.COMPLETED:
        notes.append("The arm need not match the blue ghost, which has room for the test to come.")
        ghost = (*map(float, OPEN_POSE), seen.q_jaw)
    elif state is State.RECORDING:
        lit = summary.left(now.joints)
    if state in (State.STARTED, State.RECORDING):
        notes.append(summary.picture_note(seen, now.joints))
    q = tuple(float(seen.angles[joint]) for joint in JOINTS)
    return Picture(q=q, ghost=ghost, lit=lit, note=" ".join(filter(None, notes)))


def _meanings(stored: Stored, *, is_first: bool) -> tuple[str, ...]:
    """Explain the zeros, guesses first; the last sentence is about all joints together.

    That one compares with other software, so it is left out for a first calibration.
    """
    if not stored.zeros:
        return ()
    explained = zero_report.explain_stored(stored)
    guessed = [meaning.sentence for meaning in explained[:-1] if meaning.by == "middle"]
    return (*guessed,) if is_first else (*guessed, explained[-1].sentence)
