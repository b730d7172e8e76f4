"""Which tab is in front: what the scene shows belongs to that one alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto

PROGRAM = "Program"
"""The name of the tab whose plan is not the Move tab's."""


class Drawn(Enum):
    """What the scene shows of what the Move tab has."""

    PLAN = auto()
    """The plan: its path, and a ghost that goes along it."""
    TARGET = auto()
    """A ghost at the target, which may be recorded; no path."""
    NOTHING = auto()
    """No ghost, no path: those of a program are there."""


@dataclass(slots=True)
class FrontTab:
    """The tab in front in the window in control. For the page's thread.

    Attributes:
        name: What stands on it.
        rehearses: Whether the Program tab has the ghost.
    """

    name: str = ""
    rehearses: bool = False
    _rehearsed: tuple[object, ...] = field(default=(), repr=False)
    _targets: tuple[object, ...] = field(default=(), repr=False)

    def turn_to(self, name: str) -> None:
        """Note which tab is in front now."""
        self.name = name

    def note(
        self, rehearsal: object | None, t: float, targets: tuple[object, ...], *, runs: bool
    ) -> bool:
        """Let rehearsal or targets have the ghost, whichever is newer.

        Args:
            rehearsal: Of the Program tab; None without one.
            t: How far into it its ghost stands [s].
            targets: Those of the Move tab.
            runs: Whether the program is run.

        Returns:
            Whether another one has it now.
        """
        if (rehearsal, t) != self._rehearsed:
            self._rehearsed, self._targets = (rehearsal, t), targets
        are_old = all(one is other for one, other in zip(targets, self._targets, strict=True))
        before, self.rehearses = self.rehearses, runs or (rehearsal is not None and are_old)
        return self.rehearses is not before

    @property
    def is_program(self) -> bool:
        """Whether it is the one of programs."""
        return self.name == PROGRAM

    @property
    def drawn(self) -> Drawn:
        """What the scene shows of what the Move tab has."""
        if not self.is_program:
            return Drawn.PLAN
        return Drawn.NOTHING if self.rehearses else Drawn.TARGET
