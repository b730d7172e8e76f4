"""Programs: steps with named waypoints, visited in order, once, several times, or until stopped.

``program.py`` is the program as a value and its editing, ``loops.py`` has the loops inside it,
``files.py`` saves it, ``rehearsal.py`` plans all of it before anything moves, ``run.py`` runs that
on several arms (``Cell``) or on one (``solo.py``). Paths recorded by hand guiding are in
``guided``.
"""

from so101_motion.tasks.program.loops import Loop
from so101_motion.tasks.program.program import ARM, Program, Waypoint
from so101_motion.tasks.program.rehearsal import Rehearsal, rehearse
from so101_motion.tasks.program.run import (
    ProgramRun,
    Where,
    start_program,
)
from so101_motion.tasks.program.solo import Arms, Solo

__all__ = [
    "ARM",
    "Arms",
    "Loop",
    "Program",
    "ProgramRun",
    "Rehearsal",
    "Solo",
    "Waypoint",
    "Where",
    "rehearse",
    "start_program",
]
