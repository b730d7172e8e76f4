"""The text that says at all times whether the joints are held."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from so101_motion.common.modes import Mode

from .setup_target import SetupTarget

SETTLED = 0.4
"""How long readings must differ from the text before it changes [s]; chosen. A search for motors
takes the port through other baud rates, and a busy computer loses answers; for that moment the
torque is unknown."""


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
        return TorqueText(text="Torque not known: no arm yet")
    now = target.situation
    if not now.is_connected:
        return TorqueText(text="Torque not known: no connection")
    if now.holds is None:
        return TorqueText(text="Torque not known yet")
    if target.rig is not None and target.rig.arm.state.mode is Mode.GUIDING:
        return TorqueText(text="Guided by hand", is_on=True)
    if now.holds:
        return TorqueText(text="Torque on: the joints are held", is_on=True)
    return TorqueText(text="Torque off: the joints are limp", is_on=False)


class TorqueWatch:
    """Keeps the text stable while readings are missing for a moment.

    Args:
        now: The time [s].
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self.shown = torque(None)
        self._now = now
        self._differs_since: float | None = None  # since when readings differ from the text

    def look(self, target: SetupTarget | None, *, is_blind: bool) -> bool:
        """Read the torque again; return whether the text changed.

        The first known torque is shown at once: one answer is proof, and the next ones may be lost.

        Args:
            target: The arm that is set up.
            is_blind: Whether motors are being searched for, so that readings mean nothing.
        """
        seen = torque(target)
        is_new = target is not None and self.shown == torque(None)
        is_news = is_new or target is None or (self.shown.is_on is None and seen.is_on is not None)
        if seen == self.shown or (is_blind and not is_news):
            self._differs_since = None
            return False
        if self._differs_since is None:
            self._differs_since = self._now()
        if not is_news and self._now() - self._differs_since < SETTLED:
            return False
        self.shown, self._differs_since = seen, None
        return True
