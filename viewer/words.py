"""What the page says. Degrees and millimetres are made here, for people."""

from __future__ import annotations

import numpy as np

from so101_motion.errors import Interrupted, So101Error
from so101_motion.modes import Mode
from so101_motion.planning.plan import Plan
from so101_motion.state import ARM_JOINTS, JointState
from so101_motion.units import to_deg, to_mm

from .screen import Sentence, Tone

PRESS_PLAN = Sentence(text="Reachable. Press Plan.")
PLANNING = Sentence(text="Planning …")
PLANNED = Sentence(
    text="Planned. Look at the way, then press Execute: the arm moves.", tone=Tone.GOOD
)
MOVING = Sentence(text="Moving. Space or Stop ends it.")
ALREADY_THERE = Sentence(text="The arm is there already.")
ARM_MOVED = Sentence(text="The arm has moved since. Press Plan again.")
JAW_MOVED = Sentence(text="The gripper has moved since. Press Plan again.")
SPEED_CHANGED = Sentence(text="New speed. Press Plan again.")

_MODES = {
    Mode.LIMP: "Limp",
    Mode.GUIDING: "Guided by hand",
    Mode.HOLDING: "Idle, holding",
    Mode.MOVING: "Moving",
    Mode.STOPPING: "Stopping",
    Mode.CALIBRATING: "Calibrating",
    Mode.FAULT: "Fault",
}


def mode(state: JointState) -> str:
    """What the arm is doing."""
    name = _MODES[state.mode]
    return f"{name}: {state.fault}" if state.fault else name


def blocked(state: JointState) -> Sentence | None:
    """Why the arm cannot be moved at all, or None when it can."""
    reasons = {
        Mode.LIMP: "The arm is limp. It has to hold before it can move.",
        Mode.GUIDING: "The arm is guided by hand. It has to hold before it can move.",
        Mode.FAULT: f"The arm is in a fault: {state.fault}.",
        Mode.CALIBRATING: "The arm is being calibrated.",
    }
    reason = reasons.get(state.mode)
    return None if reason is None else Sentence(text=reason, tone=Tone.BAD)


def arrived(distance: float) -> Sentence:
    """At the target, with the tool ``distance`` [m] away from it."""
    return Sentence(
        text=f"Arrived, {to_mm(distance):.1f} mm off. Drag on for the next target.", tone=Tone.GOOD
    )


def ended(error: BaseException) -> Sentence:
    """Why a plan or a motion came to nothing."""
    if isinstance(error, Interrupted):
        by = "Stopped" if error.by == "stop" else f"Ended early by {error.by}"
        return Sentence(text=f"{by}. The arm holds where it is.")
    if isinstance(error, So101Error):
        text = str(error)
        return Sentence(text=text[:1].upper() + text[1:].rstrip(".") + ".", tone=Tone.BAD)
    return Sentence(text=f"Something broke inside: {error!r}. See the log.", tone=Tone.BAD)


def plan_facts(plan: Plan) -> tuple[tuple[str, str], ...]:
    """The figures of a plan as pairs of name and value."""
    trajectory, report = plan.trajectory, plan.report
    speeds = np.max(np.abs(trajectory.qd), axis=0)
    fastest = int(np.argmax(speeds))
    return (
        ("Duration", f"{trajectory.duration:.2f} s"),
        ("Peak speed", f"{to_deg(float(speeds[fastest])):.0f} °/s, {ARM_JOINTS[fastest]}"),
        ("Samples", f"{len(trajectory)}, one every {1000 * trajectory.dt:.0f} ms"),
        ("Tool travel", f"{to_mm(_length(plan)):.0f} mm"),
        (
            "Clearance",
            f"{to_mm(report.clearance):.0f} mm at the goal, {' to '.join(report.closest)}",
        ),
        ("Planned in", f"{report.stages_ms['total']:.0f} ms"),
    )


def _length(plan: Plan) -> float:
    return float(np.sum(np.linalg.norm(np.diff(plan.tool_path, axis=0), axis=1)))
