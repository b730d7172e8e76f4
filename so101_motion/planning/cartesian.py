"""Ways of the tool: from a prescribed line or path to curves of the joints.

How it works. On a line every point of the tool's way is prescribed; what five joints leave open is
the pitch, for some goals the roll, and which way the elbow bends. That is decided for the whole
line at once:

1. *Lay out* postures in columns, one column each centimetre or so (``tool_postures.py``).
2. *Search* them for the best sequence from the start to the end (``tool_search.py``).
3. *Look for contact* along the sequence. What is blocked is forbidden, and the search repeated;
   if that does not soon help, all postures that might still be used are looked at.
4. *Lay a smooth curve* through it along which the tool keeps to its way (``tool_curve.py``).

If a look finds nothing, a closer one is taken (``way_search.py`` is one look). If the closest finds
nothing either, the error says how far the way can be followed, to the millimetre, and what ends it
there (``tool_refusal.py``).

How the arm then moves along the curves is told in ``path_timing.py``.
"""

from __future__ import annotations

import math
from functools import lru_cache

from so101_motion.errors import ConfigError, PlanningError
from so101_motion.geometry import Array
from so101_motion.planning.arm_chain import ArmChain
from so101_motion.planning.collision import CollisionModel
from so101_motion.planning.goals import GoalMetric, LineGoal, PoseGoal, WayGoal
from so101_motion.planning.ik import IkSolver
from so101_motion.planning.ik_task import check_goal
from so101_motion.planning.tool_motion import ToolMotion
from so101_motion.planning.tool_postures import Fineness
from so101_motion.planning.tool_refusal import refusal
from so101_motion.planning.tool_way import ToolWay, straight_way, way_through
from so101_motion.planning.way_search import Tools, WaySearch, WayTask

LOOKS = (
    Fineness(spacing=0.0125, pitch_step=math.radians(5.0), offsets=9, rolls=1),
    Fineness(spacing=0.005, pitch_step=math.radians(2.0), offsets=9, rolls=9),
    Fineness(spacing=0.0025, pitch_step=math.radians(1.0), offsets=13, rolls=13),
)
"""How closely a way is looked at, one look after the other. Chosen: benchmarks/bench_line.py."""

STILL = 1e-6
"""A way on which the tool turns and moves by less than this is no motion [rad], [m]. Chosen."""


class LinePlanner:
    """Finds joint motions for lines and paths of the tool. Belongs to one thread."""

    def __init__(self, ik: IkSolver) -> None:
        self._ik = ik
        self._chain = lru_cache(maxsize=8)(lambda frame: ArmChain(ik.model, frame))

    @property
    def tool(self) -> ArmChain:
        """Kinematics of the tool point."""
        return self._chain("tool")

    def find(
        self, goal: WayGoal, q_start: Array, collision: CollisionModel, q_jaw: float
    ) -> ToolMotion:
        """Curves of the joints along which the tool follows the goal's way, free of contact.

        Args:
            goal: The line or path, and what else counts.
            q_start: A free posture inside the limits, shape (5,), [rad]; the way starts there.
            collision: What is in the way.
            q_jaw: Jaw angle during the motion [rad].

        Raises:
            Unreachable: The way cannot be followed to its end; says for how many millimetres it
                can, and what stops the arm there.
            InCollision: It could be, but not free of contact.
            ConfigError: The goal holds numbers that cannot be meant.
        """
        found = self._look(goal, q_start, collision, q_jaw)
        if isinstance(found, ToolMotion):
            return found
        raise refusal(self._ik, found)

    def find_if_any(
        self, goal: WayGoal, q_start: Array, collision: CollisionModel, q_jaw: float
    ) -> ToolMotion | None:
        """As :meth:`find`, but None where the way cannot be followed, without asking why."""
        found = self._look(goal, q_start, collision, q_jaw)
        return found if isinstance(found, ToolMotion) else None

    def _look(
        self, goal: WayGoal, q_start: Array, collision: CollisionModel, q_jaw: float
    ) -> ToolMotion | WaySearch:
        """What is found; or the closest look, which found nothing."""
        tools = self._tools(goal.frame)
        way = self._way(goal, q_start)
        if way.spin and (goal.metric is GoalMetric.POSITION_ONLY or way.turn < STILL):
            return ToolMotion(q_start=q_start, curves=(), off=0.0, turned=0.0)
        task = WayTask(goal=goal, way=way, q_start=q_start, collision=collision, q_jaw=q_jaw)
        for fineness in LOOKS:
            search = WaySearch(tools, task, fineness)
            found = search.run()
            if found is not None:
                return found
        return search

    def _tools(self, frame: str) -> Tools:
        structure = self._ik.structure
        if structure is None:
            raise PlanningError(
                "straight lines need an arm with a pan, three parallel joints and a roll, which"
                " this URDF does not describe; move to the pose instead"
            )
        return Tools(
            ik=self._ik, structure=structure, chain=self._chain(frame), tool_chain=self.tool
        )

    def _way(self, goal: WayGoal, q_start: Array) -> ToolWay:
        """The way of a goal that has been checked."""
        for key in ("tolerance", "orientation_tolerance"):
            if not 0.0 < getattr(goal, key) < math.inf:
                raise ConfigError(key, getattr(goal, key), "must be positive and finite")
        if isinstance(goal, LineGoal):
            poses = [goal.T_base_tool]
        else:
            poses = [segment.T_base_tool for segment in goal.segments]
        for T_base_tool in poses:
            pose = PoseGoal(T_base_tool=T_base_tool, metric=goal.metric, frame=goal.frame)
            check_goal(self._ik.model, pose)
        T_start = self._ik.model.frame(q_start, goal.frame)
        if isinstance(goal, LineGoal):
            return straight_way(T_start, goal.T_base_tool)
        return way_through(T_start, goal.segments, goal.blend)
