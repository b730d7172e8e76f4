"""Show at all times whether the joints are held."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from .setup_target import SetupTarget

SETTLED = 0.4
"""For how long what is told must not have been seen before something else is told [s]; chosen. A
look at the motors takes the port through other baud rates, and a busy computer loses answers; for
that moment nothing is known of anybody's torque."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TorqueText:
    """The text and its tone.

    Attributes:
        is_on: Whether any motor drives its joint; None if that is not known.
    """

    text: str
    is_on: bool | None = None


def torque(target: SetupTarget | None) -> TorqueText:
    """The text for the present target."""
    if target is None:
        return TorqueText(text="Torque: not connected yet")
    now = target.calibrator.situation
    if not now.is_connected:
        return TorqueText(text="Torque: not known, there is no connection")
    if now.holds is None:
        return TorqueText(text="Torque: not known yet")
    if now.holds:
        return TorqueText(text="Torque on: the joints are held", is_on=True)
    return TorqueText(text="Torque off: the joints are limp", is_on=False)


class TorqueWatch:
    """Keeps the text stable while readings are missing for a moment.

    Args:
        now: What time it is [s].
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self.shown = torque(None)
        self._now = now
        self._doubted: float | None = None  # since when what is told has not been seen

    def look(self, target: SetupTarget | None, *, is_blind: bool) -> bool:
        """Read the torque again; return whether the text changed.

        What is known is told at once where nothing was, for one answer is proof and the next ones
        may be lost.

        Args:
            target: What is worked on.
            is_blind: Whether the motors are being looked for, so that nothing can be told.
        """
        seen = torque(target)
        is_new = target is not None and self.shown == torque(None)
        is_news = is_new or target is None or (self.shown.is_on is None and seen.is_on is not None)
        if seen == self.shown or (is_blind and not is_news):
            self._doubted = None
            return False
        if self._doubted is None:
            self._doubted = self._now()
        if not is_news and self._now() - self._doubted < SETTLED:
            return False
        self.shown, self._doubted = seen, None
        return True
