"""Whether the joints are held, in words: what anybody near the arm has to know at any moment."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from .bench import Bench

SETTLED = 0.4
"""How long something else must hold to be told [s]; chosen. A look at the motors takes the port
through other baud rates, and for that moment nothing is known of anybody's torque."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Torque:
    """How it is.

    Attributes:
        text: In words.
        is_on: Whether any motor drives its joint; None if that is not known.
    """

    text: str
    is_on: bool | None = None


def torque(bench: Bench | None) -> Torque:
    """How it is with what is worked on."""
    if bench is None:
        return Torque(text="Torque: not connected yet")
    now = bench.calibrator.situation
    if not now.is_connected:
        return Torque(text="Torque: not known, there is no connection")
    if now.holds is None:
        return Torque(text="Torque: no motor answers")
    if now.holds:
        return Torque(text="Torque on: the joints are held", is_on=True)
    return Torque(text="Torque off: the joints are limp", is_on=False)


class TorqueWatch:
    """How it has been for a while.

    Args:
        now: What time it is [s].

    Attributes:
        told: What to tell.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self.told = torque(None)
        self._now = now
        self._other: tuple[Torque, float] | None = None

    def look(self, bench: Bench | None, *, is_blind: bool) -> bool:
        """Look again; whether there is something else to tell.

        Args:
            bench: What is worked on.
            is_blind: Whether the motors are being looked for, so that nothing can be told.
        """
        seen = torque(bench)
        is_new = bench is not None and self.told == torque(None)
        if (is_blind and not is_new) or seen == self.told:
            self._other = None
            return False
        if self._other is None or self._other[0] != seen:
            self._other = (seen, self._now())
        if bench is not None and not is_new and self._now() - self._other[1] < SETTLED:
            return False
        self.told, self._other = seen, None
        return True
