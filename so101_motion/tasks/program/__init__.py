"""Programs: named waypoints, visited in order, once, several times, or until stopped.

``program.py`` is the program as a value and its editing, ``loops.py`` has the loops inside it,
``files.py`` saves it, ``rehearsal.py`` plans all of it before anything moves, ``run.py`` runs that.
``cell_program.py`` and ``cell_run.py`` do the same for several arms. Paths recorded by hand guiding
are in ``guided``.
"""

from so101_motion.tasks.program.cell_program import CellProgram, read_cell_program
from so101_motion.tasks.program.cell_run import (
    CellProgramRun,
    CellRehearsal,
    rehearse_cell,
    start_cell_program,
)
from so101_motion.tasks.program.loops import Loop
from so101_motion.tasks.program.program import Program, Waypoint
from so101_motion.tasks.program.rehearsal import Rehearsal, rehearse
from so101_motion.tasks.program.run import (
    ProgramRun,
    Where,
    run_once_planned,
    start_program,
)

__all__ = [
    "CellProgram",
    "CellProgramRun",
    "CellRehearsal",
    "Loop",
    "Program",
    "ProgramRun",
    "Rehearsal",
    "Waypoint",
    "Where",
    "read_cell_program",
    "rehearse",
    "rehearse_cell",
    "run_once_planned",
    "start_cell_program",
    "start_program",
]
