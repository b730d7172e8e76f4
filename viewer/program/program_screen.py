"""Everything that the Program tab shows at one instant, as values."""

from __future__ import annotations

from dataclasses import dataclass

from so101_motion.common.geometry import Array
from so101_motion.tasks.program import Program, ProgramRun, Rehearsal

from ..page.screen_state import Sentence


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProgramScreen:
    """Everything that the tab shows at one instant.

    Attributes:
        program: What is edited, or run.
        chosen: Index of the waypoint that is edited; None without one.
        name: What the program is called, when it is saved or was loaded.
        saved: The user's programs, by name.
        sentence: What to know or to do now.
        rehearsal: The plan of all of it, as long as it holds; else None.
        run: What is being run; else None.
        guided: Whether the arm yields to a hand.
        can_edit: Whether waypoints may be changed.
        can_plan: Whether Plan may be pressed.
        can_run: Whether Run may be pressed.
        can_guide: Whether the arm may be guided now.
        can_undo: Whether there is an edit to undo.
        can_redo: Whether one was undone.
        first: Index of the first waypoint that is planned or run.
        t: How far into the rehearsal the ghost stands [s].
        q_ghost: Where it stands, shape (5,), [rad]; None without a rehearsal.
    """

    program: Program
    chosen: int | None
    name: str
    saved: tuple[str, ...]
    sentence: Sentence
    rehearsal: Rehearsal | None
    run: ProgramRun | None
    guided: bool
    can_edit: bool
    can_plan: bool
    can_run: bool
    can_guide: bool
    can_undo: bool
    can_redo: bool
    first: int
    t: float
    q_ghost: Array | None


def ghost_at(rehearsal: Rehearsal, t: float) -> Array:
    """Where the arm is ``t`` [s] into a rehearsal, pauses left out; shape (5,), [rad]."""
    for plan in rehearsal.plans:
        if t <= plan.duration:
            return plan.trajectory.sample(max(t, 0.0)).q
        t -= plan.duration
    return rehearsal.program.waypoints[-1].q
