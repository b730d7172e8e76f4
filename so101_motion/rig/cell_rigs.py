"""Open all arms of a cell: each with its rig, and the cell in which they keep apart."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack

from so101_motion.arm.cell import Cell
from so101_motion.common.clock import Clock
from so101_motion.files.cell_file import CellFile
from so101_motion.rig.hardware_rig import open_simulated, open_so101
from so101_motion.rig.rig import Rig


class CellRigs:
    """The arms of a cell, opened. Use it in a ``with`` block or call ``close``.

    Attributes:
        rigs: The rig of each arm by its name, in the order of the file.
        cell: In which they keep apart.
    """

    def __init__(self, file: CellFile, rigs: Mapping[str, Rig], closing: ExitStack) -> None:
        self.rigs, self.cell, self._closing = dict(rigs), Cell(), closing
        for arm in file.arms:
            rig = self.rigs[arm.name]
            rig.arm.scene = file.scene_of(arm)
            self.cell.add(arm.name, rig, arm.T_cell_base)

    def close(self) -> None:
        """Bring all arms to rest and let go of everything. May be called twice."""
        self._closing.close()

    def __enter__(self) -> CellRigs:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_cell(file: CellFile, *, clock: Clock | None = None) -> CellRigs:
    """Open the arms of a cell; opening moves nothing. Those without a port are simulated.

    Args:
        file: As ``files.cell_file.read_cell`` reads it.
        clock: What time it is; the real time by default.

    Raises:
        ConfigError: A setting cannot be used.
        BusError: A port cannot be opened, or a servo does not answer; nothing stays open.
    """
    with ExitStack() as opened:
        rigs: dict[str, Rig] = {}
        for arm in file.arms:
            if arm.port:
                rig: Rig = open_so101(arm.port, arm.calibration_id or None, clock=clock)
            else:
                rig = open_simulated(clock=clock)
            rigs[arm.name] = opened.enter_context(rig)
        made = CellRigs(file, rigs, opened.pop_all())
    return made
