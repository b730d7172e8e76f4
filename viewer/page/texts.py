"""Sentences and figures that several tabs show, in degrees and millimetres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from so101_motion.arm.gripper import JAW_CLOSED, JAW_OPEN
from so101_motion.common.errors import ConfigError, Interrupted, So101Error, quoted
from so101_motion.common.geometry import Array
from so101_motion.common.modes import HELD, Mode
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT, JointState
from so101_motion.common.units import to_deg, to_mm
from so101_motion.planning.collision.apart import Meeting
from so101_motion.planning.plan_summary import tool_length
from so101_motion.planning.timing.limits import MotionLimits

from .plan_view import PlanView
from .screen_state import Sentence, Tone
from .tracking import Tracking

PRESS_PLAN = Sentence("Reachable. Press Plan.")
IN_CONTACT = Sentence(
    "The arm touches itself or something where it stands. Press Plan; if that is refused, press"
    " Back out slowly, or guide it by hand.",
    Tone.WARM,
)
PLANNING = Sentence("Planning …")
PLANNED = Sentence("Planned. Check the path, then press Execute to move the arm.", Tone.GOOD)
MOVING = Sentence("Moving. Press Space or Stop to stop.")
ALREADY_THERE = Sentence("Already there. Set another target.")
STOPPED_THERE = Sentence("Stopped at the target. Set another one.")
ARM_MOVED = Sentence("The arm has moved. Press Plan again.")
JAW_MOVED = Sentence("The gripper has moved. Press Plan again.")
CAPS_CHANGED = Sentence("The speed limits have changed. Press Plan again.")
IN_USE = Sentence("Something moves, or jogging is on. To plan, end it or press STOP.")
HOLDS_AGAIN = Sentence("The arm holds again. Set a target, then press Plan.")
ALL_PLANNED = Sentence("Planned. Check the paths, then press Execute to move all arms.", Tone.GOOD)
ALL_STOPPED = Sentence("Stopped. All arms hold where they are. Press Plan to go on.")
SURROUNDINGS_CHANGED = Sentence("The surroundings have changed. Press Plan again.")

SINKS = "It will sink. Let go?"
HELD_ALREADY = "The joints are held already."
LIMP_ALREADY = "The joints are limp already."
HOLD_FIRST = "To guide them, press Hold first."
_MOVES = "Something moves: press STOP first."
_IN_USE = {Mode.CALIBRATING: "The servos are in use for a calibration or a motor setup."}

DISCONNECTED = Sentence("The arm is disconnected, so nothing can move.", Tone.BAD)
BACK = Sentence("The arm is back. Press Hold to go on.", Tone.WARM)

CANNOT_HOLD = dict.fromkeys(HELD, HELD_ALREADY) | _IN_USE
"""Why joints cannot be held, by mode; in the other modes they can."""

CANNOT_GUIDE = {
    Mode.GUIDING: "Guide by hand is on already.",
    Mode.MOVING: _MOVES,
    Mode.STOPPING: _MOVES,
    Mode.FAULT: "The arm is in a fault: press Hold first.",
    **_IN_USE,
}
"""Why an arm cannot be guided by hand."""

CANNOT_LET_GO = {Mode.LIMP: LIMP_ALREADY, **_IN_USE}  # why joints cannot be let go of

_JOINTS = (*ARM_JOINTS, GRIPPER_JOINT)
_HOLD = (*HELD, Mode.GUIDING)  # the modes in which servos carry the arm, unless they let go

_MODES = {
    Mode.LIMP: "Limp",
    Mode.GUIDING: "Guided by hand",
    Mode.HOLDING: "Idle, holding",
    Mode.MOVING: "Moving",
    Mode.STOPPING: "Stopping",
    Mode.CALIBRATING: "Calibrating",
    Mode.FAULT: "Fault",
}


def capital(text: str) -> str:
    """With a capital letter and a full stop; nothing for nothing."""
    text = text.strip()
    if not text:
        return ""
    is_name = "_" in text.split(maxsplit=1)[0]  # a joint's, which is spelled as it is everywhere
    first = text[0] if is_name else text[0].upper()
    return first + text[1:] + ("" if text[-1] in ".?!…" else ".")


def mode(state: JointState, *, lost: bool = False, is_stopped: bool = False) -> str:
    """The mode of the arm in a word or two; another sentence gives the reason of a fault."""
    if lost:
        return "Arm disconnected"
    if state.arm_moving and state.mode in HELD:
        return _MODES[state.mode]  # the arm may move though the jaw's servo has let go
    holds = state.mode in _HOLD or (state.mode is Mode.LIMP and not state.is_limp)
    gone = state.reading.let_go_of(_JOINTS) if holds else None
    if gone is None and state.torque:
        return "Held in part" if "limp" in state.torque else "Held, as found"
    if gone is None and is_stopped and state.mode is Mode.HOLDING:
        return "Stopped, holding"
    return _MODES[state.mode] if gone is None else f"{gone} has let go"


def blocked(state: JointState) -> Sentence | None:
    reasons = {
        # what an arm that is held in part does stands in the bar
        Mode.LIMP: f"{'' if state.torque else 'The arm is limp. '}Press Hold before you move it.",
        Mode.GUIDING: "Guide by hand is on. Press Hold before you plan a motion.",
        Mode.FAULT: "The arm is in a fault, so nothing can move.",
        Mode.CALIBRATING: "The arm is being calibrated.",
    }
    reason, gone = reasons.get(state.mode), state.reading.let_go_of(ARM_JOINTS)
    if reason is None and gone is not None:
        reason = f"{gone} has let go: support the arm. Nothing moves before its servo holds again."
    alarms = state.reading.alarms
    alarmed = next((joint for joint in ARM_JOINTS if joint in alarms), None)
    if reason is None and alarmed is not None:  # any motion would end at once
        every = "Every joint has an alarm. " if len(alarms) == len(_JOINTS) else ""
        reason = f"{every}{alarmed}: {alarms[alarmed]}."
    is_wrong = state.mode not in (Mode.LIMP, Mode.GUIDING)  # a start and guiding are usual
    return None if reason is None else Sentence(reason, Tone.BAD if is_wrong else Tone.WARM)


def named(arm: str, sentence: Sentence) -> Sentence:
    return replace(sentence, text=f"{arm}: {sentence.text}") if arm else sentence


def deleted(name: str) -> Sentence:
    return Sentence(f"Deleted {name}.")


def arrived(distance: float) -> Sentence:
    """At the target, with the tool ``distance`` [m] away from it."""
    return Sentence(
        f"Arrived, {to_mm(distance):.1f} mm off. Drag to set the next target.", Tone.GOOD
    )


def ended(error: BaseException) -> Sentence:
    if isinstance(error, Interrupted):
        if error.by == "stop":
            return Sentence("Stopped. The arm holds where it is. Press Plan to go on.")
        return Sentence(f"Ended early by {error.by}. The arm holds where it is.")
    if isinstance(error, So101Error):
        text = _refused(error) if isinstance(error, ConfigError) else str(error)
        return Sentence(capital(text), Tone.BAD)
    return Sentence(f"Internal error: {quoted(error)}. See the log.", Tone.BAD)


def _refused(error: ConfigError) -> str:
    """What is wrong with a value that was just entered; its key is left out."""
    if error.value in (None, ""):
        return error.reason
    return f"{quoted(error.value)} {error.reason}" if isinstance(error.value, str) else str(error)


NO_FACTS = tuple(
    (name, "–")
    for name in (
        "Duration", "Peak speed", "Peak accel.", "Tool travel", "Clearance", "Planned in"
    )
)  # fmt: skip
"""The figures while there is no plan."""


def plan_facts(view: PlanView) -> tuple[tuple[str, str], ...]:
    plan = view.plan
    trajectory = plan.trajectory
    return (
        ("Duration", f"{trajectory.duration:.2f} s"),
        ("Peak speed", _peak(trajectory.qd, "°/s")),
        ("Peak accel.", _peak(trajectory.qdd, "°/s²")),
        ("Tool travel", f"{to_mm(tool_length(plan)):.0f} mm"),
        ("Clearance", clearance(view)),
        ("Planned in", f"{plan.report.stages_ms['total']:.0f} ms"),
    )


def which(name: str, *, is_current: bool) -> str:
    return name if is_current else f"{name}, no longer current"


def plotted(view: PlanView, *, is_current: bool) -> str:
    trajectory = view.plan.trajectory
    return (
        f"{which(view.name, is_current=is_current)}, {trajectory.duration:.2f} s;"
        f" peak {_peak(trajectory.qd, '°/s')} and {_peak(trajectory.qdd, '°/s²')}."
    )


def common_plotted(name: str, duration: float, *, is_current: bool) -> str:
    which_plan = which(name, is_current=is_current)
    return f"{which_plan}, {duration:.2f} s; clearance between the arms over time."


def between(first: str, second: str, least: Meeting) -> tuple[str, str]:
    bodies = f"{least.first} to {least.second}"
    return f"{first} to {second}", f"{to_mm(least.distance):.0f} mm, {bodies}, at {least.t:.1f} s"


def caps(limits: MotionLimits) -> str:
    speed, push = float(np.max(limits.velocity)), float(np.max(limits.acceleration))
    return f"{to_deg(speed):.0f} °/s, {to_deg(push):.0f} °/s²"


JAW_LENGTH = 0.082  # from the jaw's axis to its tip [m], in the robot description


def aperture(q_jaw: float) -> float:
    """How far the jaw is open, 0 to 1."""
    return min(max((q_jaw - JAW_CLOSED) / (JAW_OPEN - JAW_CLOSED), 0.0), 1.0)


def opening(q_jaw: float) -> str:
    return f"{100.0 * aperture(q_jaw):.0f} % open"


def grip(state: JointState, *, holds: bool) -> str:
    q_jaw = state.q_jaw
    if GRIPPER_JOINT in state.reading.silent:
        return "Its servo does not answer."
    if holds:
        return f"Holding something: the tips are {to_mm(tip_distance(q_jaw)):.0f} mm apart."
    return f"Holding nothing, {opening(q_jaw)}."


def tip_distance(q_jaw: float) -> float:
    """How far the tips of the jaws are apart [m]."""
    return 2.0 * JAW_LENGTH * float(np.sin(0.5 * max(q_jaw - JAW_CLOSED, 0.0)))


def clearance(view: PlanView) -> str:
    closest, end = view.closest, view.plan.trajectory.duration
    when = "at the goal" if view.t_closest >= end else f"at {view.t_closest:.1f} s"
    return f"{to_mm(closest.distance):.0f} mm, {closest.first} to {closest.second}, {when}"


def followed(tracking: Tracking) -> str:
    worst, rms = to_deg(tracking.worst), to_deg(tracking.rms)
    i = int(np.argmax(worst))
    late = "" if tracking.lag is None else f", {1000.0 * tracking.lag:.0f} ms behind the plan"
    mean = float(np.sqrt(np.mean(rms**2)))
    return f"RMS {mean:.2f}°, largest {worst[i]:.2f}° ({ARM_JOINTS[i]}){late}"


def _peak(values: Array, unit: str) -> str:
    peaks = np.max(np.abs(values), axis=0)
    i = int(np.argmax(peaks))
    return f"{to_deg(float(peaks[i])):.0f} {unit} ({ARM_JOINTS[i]})"
