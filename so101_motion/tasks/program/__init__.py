"""Programs: steps with named waypoints, visited in order, once, several times, or until stopped."""

from so101_motion.tasks.program.loops import Loop
from so101_motion.tasks.program.program import ARM, Program, Waypoint
from so101_motion.tasks.program.rehearsal import Rehearsal, rehearse
from so101_motion.tasks.program.run import ProgramRun, Where, start_program
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
