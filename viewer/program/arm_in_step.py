"""What the fields of one arm change in the selected step."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from . import program_texts as words

if TYPE_CHECKING:
    from .program_model import ProgramModel


class ArmInStep:
    """Changes what an arm does in the selected step."""

    def __init__(self, model: ProgramModel, name: str) -> None:
        self._model, self._name = model, name
        self._change = partial(model.change, name)

    def rename(self, name: str) -> None:
        """Rename the waypoint."""
        self._change(name=name)

    def set_speed(self, share: float) -> None:
        """Set how fast it goes there, as a share of its speed."""
        self._change(speed=share)

    def set_pause(self, seconds: float) -> None:
        """Set the pause there [s]; the arm then stops there."""
        passed = self._passed
        self._change(pause=seconds, passes=passed and seconds == 0.0)
        if passed and seconds > 0.0:
            self._model.tell(words.PAUSE_STOPS)

    def set_aperture(self, aperture: float | None) -> None:
        """Set the jaw's aperture there, 0 to 1; None to leave it.

        The arm stops at a waypoint where the jaw moves.
        """
        passed = self._passed
        self._change(aperture=aperture, passes=passed and aperture is None)
        if passed and aperture is not None:
            self._model.tell(words.JAW_STOPS)

    def set_passes(self, passes: bool) -> None:
        """Pass the waypoint without a stop, pause and jaw; or stop there."""
        before = self._model.waypoint(self._name)
        if not passes:
            self._change(passes=False)
            return
        self._change(passes=True, pause=0.0, aperture=None)
        index = self._model.chosen
        if before is not None and index is not None:
            stops = self._model.program.stops_at(index)
            self._model.tell(words.passing(before, stops=stops))

    def take_place(self) -> None:
        """Let it go to where it stands now, beside the other arms."""
        self._model.take(self._name, self._model.pages[self._name].q_arm)

    def take_target(self) -> None:
        """Let it go to its target, beside the other arms."""
        self._model.take(self._name, self._model.pages[self._name].target.q)

    def leave_out(self) -> None:
        """Let it stand still."""
        self._model.leave_out(self._name)

    @property
    def _passed(self) -> bool:
        waypoint = self._model.waypoint(self._name)
        return waypoint is not None and waypoint.passes
