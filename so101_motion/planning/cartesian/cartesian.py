"""Turn a tool path into smooth joint curves.

How it works. A line prescribes every point of the tool's path; five joints leave the pitch free,
for some goals the roll, and the side to which the elbow bends. These are chosen for the whole line
at once:

1. *List* configurations in columns, one column about each centimetre
   (``configuration_columns.py``).
2. *Search* them for the best sequence from the start to the end (``ladder_graph.py``).
3. *Check* the sequence for contact. Configurations in contact are forbidden, and the search is
   repeated; if that does not soon help, all configurations that might still be used are checked.
4. *Fit a smooth curve* through it along which the tool keeps to its path (``curve_fit.py``).

If a search finds nothing, a finer one follows (``path_search.py`` is one search). If the finest
finds nothing either, the error says how far the path can be followed, to the millimetre, and what
stops the arm there (``failure_report.py``).

``exact_retiming.py`` then times the curves.
"""

from __future__ import annotations

import math
from functools import lru_cache

from so101_motion.common.geometry import Array
from so101_motion.planning.cartesian.configuration_columns import Resolution
from so101_motion.planning.cartesian.failure_report import refusal
from so101_motion.planning.cartesian.path_search import PathSearch, PathTask, ToolMotion, Tools
from so101_motion.planning.cartesian.tool_path import ToolPath, path_through, straight_path
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.goals import GoalMetric, LineGoal, PoseGoal, ToolGoal
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.ik_task import check_goal

LOOKS = (
    Resolution(spacing=0.0125, pitch_step=math.radians(5.0), offsets=9, rolls=1),
    Resolution(spacing=0.005, pitch_step=math.radians(2.0), offsets=9, rolls=9),
    Resolution(spacing=0.0025, pitch_step=math.radians(1.0), offsets=13, rolls=13),
)
"""The resolutions of the searches, one after the other. Chosen: benchmarks/bench_line.py."""

STILL = 1e-6  # a tool that turns by less than this does not turn [rad]. Chosen


class CartesianPlanner:
    """Finds joint motions for lines and paths of the tool. Belongs to one thread."""

    def __init__(self, ik: IkSolver) -> None:
        self._ik = ik
        self._chain = lru_cache(maxsize=8)(lambda frame: ArmChain(ik.model, frame))

    @property
    def tool(self) -> ArmChain:
        """Kinematics of the tool point."""
        return self._chain("tool")

    def find(
        self, goal: ToolGoal, q_start: Array, collision: CollisionModel, q_jaw: float
    ) -> ToolMotion:
        """Find joint curves along which the tool follows the goal's path, free of contact.

        The path starts at ``q_start``, a free configuration (5,) [rad] inside the limits.

        Raises:
            Unreachable: The path cannot be followed to its end; says for how many millimetres it
                can, and what stops the arm there.
            InCollision: It can be followed, but not free of contact.
            ConfigError: The goal holds numbers that are not valid.
        """
        found = self._look(goal, q_start, collision, q_jaw)
        if isinstance(found, ToolMotion):
            return found
        raise refusal(self._ik, found)

    def find_if_any(
        self, goal: ToolGoal, q_start: Array, collision: CollisionModel, q_jaw: float
    ) -> ToolMotion | None:
        """Like :meth:`find`, but None if the path cannot be followed; saves finding out why."""
        found = self._look(goal, q_start, collision, q_jaw)
        return found if isinstance(found, ToolMotion) else None

    def _look(
        self, goal: ToolGoal, q_start: Array, collision: CollisionModel, q_jaw: float
    ) -> ToolMotion | PathSearch:
        """The motion; or the finest search, if none found one."""
        tools = self._tools(goal.frame)
        tool_path = self._tool_path(goal, q_start)
        if tool_path.spin and (goal.metric is GoalMetric.POSITION_ONLY or tool_path.turn < STILL):
            return ToolMotion(q_start=q_start, curves=(), off=0.0, turned=0.0)
        task = PathTask(
            goal=goal, tool_path=tool_path, q_start=q_start, collision=collision, q_jaw=q_jaw
        )
        for resolution in LOOKS:
            search = PathSearch(tools, task, resolution)
            found = search.run()
            if found is not None:
                return found
        return search

    def _tools(self, frame: str) -> Tools:
        return Tools(
            ik=self._ik,
            structure=self._ik.structure,
            chain=self._chain(frame),
            tool_chain=self.tool,
        )

    def _tool_path(self, goal: ToolGoal, q_start: Array) -> ToolPath:
        """The path of a goal that has been checked."""
        if isinstance(goal, LineGoal):
            poses = [goal.T_base_tool]
        else:
            poses = [segment.T_base_tool for segment in goal.segments]
        for T_base_tool in poses:
            pose = PoseGoal(T_base_tool=T_base_tool, metric=goal.metric, frame=goal.frame)
            check_goal(self._ik.model, pose)
        T_start = self._ik.model.frame(q_start, goal.frame)
        if isinstance(goal, LineGoal):
            return straight_path(T_start, goal.T_base_tool)
        return path_through(T_start, goal.segments, goal.blend)
