"""What the fields of one arm change in a program of several arms."""

from __future__ import annotations

from functools import partial

from .cell_program_model import CellProgramModel


class ArmInStep:
    """Changes what an arm does in the selected step."""

    def __init__(self, model: CellProgramModel, name: str) -> None:
        self._change = partial(model.change, name)

    def set_speed(self, share: float) -> None:
        """Set how fast it goes there, as a share of its speed."""
        self._change(speed=share)

    def set_pause(self, seconds: float) -> None:
        """Set the pause there [s]."""
        self._change(pause=seconds)

    def set_aperture(self, aperture: float | None) -> None:
        """Set the jaw's aperture there, 0 to 1; None to leave it."""
        self._change(aperture=aperture)
