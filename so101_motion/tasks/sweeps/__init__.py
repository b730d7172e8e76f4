"""Sweeps: computations too large for one process, cut into shards that any executor computes.

``engine.py`` runs them, ``folder.py`` keeps them, ``sweep.py`` says what one is. What there is to
compute: ``reach.py`` (where the arm can be, and how well; asked by ``atlas.py``)
and ``plans.py`` (random motions as a data set), ``check.py`` (its
motions against a changed scene).
"""

from so101_motion.tasks.sweeps.atlas import Atlas, Reach
from so101_motion.tasks.sweeps.check import CheckSweep, check_summary
from so101_motion.tasks.sweeps.engine import Progress, SweepResult, default_workers, run_sweep
from so101_motion.tasks.sweeps.plans import Episode, PlansSweep, episodes, plans_summary
from so101_motion.tasks.sweeps.reach import ReachSweep, scene_text

__all__ = [
    "Atlas",
    "CheckSweep",
    "Episode",
    "PlansSweep",
    "Progress",
    "Reach",
    "ReachSweep",
    "SweepResult",
    "check_summary",
    "default_workers",
    "episodes",
    "plans_summary",
    "run_sweep",
    "scene_text",
]
