"""Sweeps: computations too large for one process, cut into shards that any executor computes.

``sweep.py`` is the interface of a sweep, ``engine.py`` runs one, ``folder.py`` stores it. The
sweeps: ``reach.py`` (where the arm can be, and how well; ``atlas.py`` looks it up), ``plans.py``
(random motions as a data set), ``check.py`` and ``program_check.py`` (motions of such a data set,
or a program, in a changed scene or with another calibration), and ``place.py`` (bases for a task;
``placement.py`` finds the best).
"""

from so101_motion.tasks.sweeps.atlas import Atlas, Reach
from so101_motion.tasks.sweeps.check import CheckSweep, check_summary
from so101_motion.tasks.sweeps.engine import (
    Progress,
    SweepResult,
    WorkerPool,
    default_workers,
    run_sweep,
)
from so101_motion.tasks.sweeps.joint_reading import JointReading, as_lerobot, since
from so101_motion.tasks.sweeps.judged_bases import Base
from so101_motion.tasks.sweeps.mounting import FixedArm, Region
from so101_motion.tasks.sweeps.place import PlaceSweep
from so101_motion.tasks.sweeps.placement import Placement, find_bases
from so101_motion.tasks.sweeps.placement_files import write_placement
from so101_motion.tasks.sweeps.placement_task import (
    PlacementTask,
    TaskPose,
    read_task,
    task_of,
    task_text,
)
from so101_motion.tasks.sweeps.plans import Episode, PlansSweep, episodes, plans_summary
from so101_motion.tasks.sweeps.plans_mcap import write_mcap
from so101_motion.tasks.sweeps.program_check import (
    ProgramCheckSweep,
    program_check_summary,
    program_text,
)
from so101_motion.tasks.sweeps.reach import ReachSweep, scene_text

__all__ = [
    "Atlas",
    "Base",
    "CheckSweep",
    "Episode",
    "FixedArm",
    "JointReading",
    "PlaceSweep",
    "Placement",
    "PlacementTask",
    "PlansSweep",
    "ProgramCheckSweep",
    "Progress",
    "Reach",
    "ReachSweep",
    "Region",
    "SweepResult",
    "TaskPose",
    "WorkerPool",
    "as_lerobot",
    "check_summary",
    "default_workers",
    "episodes",
    "find_bases",
    "plans_summary",
    "program_check_summary",
    "program_text",
    "read_task",
    "run_sweep",
    "scene_text",
    "since",
    "task_of",
    "task_text",
    "write_mcap",
    "write_placement",
]
