"""Everything that the Program tab shows at one instant, as values."""

from __future__ import annotations

from dataclasses import dataclass

from so101_motion.tasks.program import Program, ProgramRun

from ..page.screen_state import Sentence
from .rehearsal_time import RehearsalTime


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProgramScreen:
    """Everything that the tab shows at one instant.

    Attributes:
        program: What is edited, or run.
        chosen: Index of the waypoint that is edited; None without one.
        name: What the program is called, when it is saved or was loaded.
        sentence: What to know or to do now.
        timeline: The plan over time, as long as it is valid; else None.
        clearances: How near each step of that plan comes to anything [m], by index.
        run: What is being run; else None.
        guided: Whether the arm yields to a hand.
        can_edit: Whether waypoints may be changed.
        can_plan: Whether Plan may be pressed.
        can_run: Whether Run may be pressed.
        can_guide: Whether the arm may be guided now.
        first: Index of the first waypoint that is planned or run.
        t: How far into the rehearsal the ghost stands [s].
    """

    program: Program
    chosen: int | None
    name: str
    sentence: Sentence
    timeline: RehearsalTime | None
    clearances: dict[int, float]
    run: ProgramRun | None
    guided: bool
    can_edit: bool
    can_plan: bool
    can_run: bool
    can_guide: bool
    first: int
    t: float
