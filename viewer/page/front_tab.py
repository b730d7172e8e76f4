"""Which tab is in front, and what the scene shows because of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto

PROGRAM = "Program"
"""The tab that has a plan of its own, besides the Move tab."""


class Drawn(Enum):
    """What the scene shows of the Move tab."""

    PLAN = auto()
    """The plan: its path, and a ghost that goes along it."""
    TARGET = auto()
    """A ghost at the target, to be recorded as a step of a program; no path."""
    NOTHING = auto()
    """No ghost, no path: the program's are shown instead."""


@dataclass(slots=True)
class FrontTab:
    """The tab in front in the window in control, and whether its program has the ghost."""

    name: str = ""
    rehearses: bool = False
    _rehearsed: tuple[object, ...] = field(default=(), repr=False)
    _targets: tuple[object, ...] = field(default=(), repr=False)

    def turn_to(self, name: str) -> None:
        self.name = name

    def note(
        self, rehearsal: object | None, t: float, targets: tuple[object, ...], *, runs: bool
    ) -> bool:
        """Give the ghost to the rehearsal at ``t`` [s] or to the targets, whichever changed last.

        Return whether it changed hands.
        """
        if (rehearsal, t) != self._rehearsed:
            self._rehearsed, self._targets = (rehearsal, t), targets
        are_old = all(one is other for one, other in zip(targets, self._targets, strict=True))
        before, self.rehearses = self.rehearses, runs or (rehearsal is not None and are_old)
        return self.rehearses is not before

    @property
    def is_program(self) -> bool:
        return self.name == PROGRAM

    @property
    def drawn(self) -> Drawn:
        if not self.is_program:
            return Drawn.PLAN
        return Drawn.NOTHING if self.rehearses else Drawn.TARGET
