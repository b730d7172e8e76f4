"""Sweeps: computations too large for one process, cut into shards that any executor computes."""

from so101_motion.tasks.sweeps.atlas import Atlas, Reach
from so101_motion.tasks.sweeps.engine import Progress, SweepResult, WorkerPool, run_sweep
from so101_motion.tasks.sweeps.place import PlaceSweep, Region
from so101_motion.tasks.sweeps.placement import Base, Placement, find_bases
from so101_motion.tasks.sweeps.placement_files import write_placement
from so101_motion.tasks.sweeps.placement_task import (
    PlacementTask,
    TaskPose,
    read_task,
    task_of,
    task_text,
)
from so101_motion.tasks.sweeps.plans import Episode, PlansSweep, episodes, plans_summary
from so101_motion.tasks.sweeps.reach import ReachSweep, scene_text

__all__ = [
    "Atlas",
    "Base",
    "Episode",
    "PlaceSweep",
    "Placement",
    "PlacementTask",
    "PlansSweep",
    "Progress",
    "Reach",
    "ReachSweep",
    "Region",
    "SweepResult",
    "TaskPose",
    "WorkerPool",
    "episodes",
    "find_bases",
    "plans_summary",
    "read_task",
    "run_sweep",
    "scene_text",
    "task_of",
    "task_text",
    "write_placement",
]
