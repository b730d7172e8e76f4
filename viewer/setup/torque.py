"""The text that says at all times whether the joints are held."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from so101_motion.common.modes import Mode

from .setup_target import SetupTarget

SETTLED = 0.4
"""How long readings must be missing before the text changes [s]; chosen. A search for motors takes
the port through other baud rates, and a busy computer loses answers; for that moment the torque is
unknown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TorqueText:
    """The text and its tone."""

    text: str
    is_on: bool | None = None  # whether any motor drives its joint; None if that is not known


def torque(target: SetupTarget | None) -> TorqueText:
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
    """Keeps the text while readings are missing for a moment."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self.shown = torque(None)
        self._now, self._known_at = now, now()

    def look(self, target: SetupTarget | None, *, is_blind: bool) -> bool:
        """Read the torque again, unless motors are searched for; return whether it changed."""
        seen, before, t = torque(target), self.shown, self._now()
        is_lost = target is not None and seen.is_on is None and before.is_on is not None
        if is_blind or not is_lost:
            self._known_at = t
        if not is_lost or t - self._known_at >= SETTLED:
            self.shown = seen
        return self.shown != before
