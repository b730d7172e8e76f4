"""Search a tool path at one resolution: columns, the best sequence, a curve.

See ``cartesian.py`` for how it works.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.cartesian.configuration_columns import (
    Columns,
    ConfigurationSource,
    Criteria,
    Resolution,
)
from so101_motion.planning.cartesian.curve_fit import EXACT, SMOOTHED, CurveFitter, FitFailure
from so101_motion.planning.cartesian.ladder_graph import Indices, LadderGraph
from so101_motion.planning.cartesian.tool_path import ToolPath
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.goals import GoalMetric, ToolGoal
from so101_motion.planning.kinematics.arm_geometry import ArmStructure
from so101_motion.planning.kinematics.batch_ik import angles_between, rotation_angles
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.timing.exact_retiming import time_exactly
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point
from so101_motion.planning.timing.path_geometry import JointPath
from so101_motion.planning.timing.trajectory import Trajectory

SAME = 1e-6  # a motion smaller than this is none [rad]. Chosen: a servo tick is 1.5e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToolMotion:
    """Joint curves that follow a tool path, still without timing."""

    q_start: Array  # joint angles at the start, shape (5,), [rad]
    # one after the other; the arm rests between them. Empty if the arm is there already
    curves: tuple[JointPath, ...]
    off: float  # largest distance of the tool from its path [m]
    turned: float  # largest deviation of its orientation, as far as that counts [rad]

    @property
    def waypoints(self) -> Array:
        """The configurations through which the curves go, shape (m, 5), [rad]."""
        knots = [curve.evaluate(curve.knots).q[1:] for curve in self.curves]
        return np.concatenate([self.q_start[None], *(knots or [self.q_start[None]])])

    def timed(self, limits: MotionLimits, dt: float, tool: ArmChain) -> list[Trajectory]:
        """The motion on these curves, from rest to rest, as fast as the limits allow."""
        if float(np.ptp(self.waypoints, axis=0).max()) <= SAME:
            return [point_to_point(self.q_start, self.q_start, limits, dt)]
        return [time_exactly(curve, limits, dt, tool_speed_fn=tool.speeds) for curve in self.curves]


FEWEST = 8  # fewest parts into which a path between two rests is cut
TURN_SPACING = 0.15  # largest turn of the tool between two columns [rad]. Chosen: 9 degrees
ATTEMPTS = 20  # how many sequences are tried. Chosen: none of 684 random lines needed more than 4
FIT_FAILURES = 10  # sequences without a curve after which the search is given up
CONTACTS_BEFORE_THOROUGH = 3  # sequences in contact after which all configurations are checked
AT_ONCE = 16  # points between two checkpoints; chosen: some milliseconds
_LOOKS = 8  # number of points of each piece of a curve at which the tool is compared with its path


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathTask:
    """The path to follow, and the obstacles."""

    goal: ToolGoal  # the goal with its metric and tolerances
    tool_path: ToolPath  # the path of the goal's frame
    q_start: Array  # joint angles at the start, shape (5,), [rad]
    collision: CollisionModel  # checks for contact
    q_jaw: float  # jaw angle during the motion [rad]

    def is_free(self, q: Array) -> bool:
        """Whether a configuration is free of contact."""
        return self.collision.is_free(q, self.q_jaw)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tools:
    """Kinematics that a search uses."""

    ik: IkSolver  # the arm's solver
    structure: ArmStructure  # the arm's structure
    chain: ArmChain  # kinematics of the frame that follows the path
    tool_chain: ArmChain  # kinematics of the tool, whose orientation counts


class PathSearch:
    """One search of a path at one resolution.

    Attributes:
        s: Places of the columns, shape (n,), [m]; the first is the start.
        fit_failures: Where no curve could be fitted through a sequence.
    """

    def __init__(self, tools: Tools, task: PathTask, resolution: Resolution) -> None:
        self.task, self._tools, self._resolution = task, tools, resolution
        self._source = ConfigurationSource(tools.structure, tools.tool_chain)
        model, goal = tools.ik.model, task.goal
        self._fitter = CurveFitter(tools.chain, model.lower, model.upper, goal.tolerance)
        self._R_frame_tool = model.rotation_to_tool(goal.frame)
        self._criteria = Criteria(
            metric=goal.metric,
            frame=goal.frame,
            orientation_tolerance=goal.orientation_tolerance,
            roll=float(task.q_start[4]),
            pitch=float(task.q_start[1:4].sum()),
        )
        self.s, self._rests = _stations(task.tool_path, resolution.spacing)
        parts = self._parts(self.s[1:])
        columns = [each for part in parts for each in part.allowed()]
        start, p_start = task.q_start[None], task.tool_path.places(self.s[:1])
        self.ladder = LadderGraph(
            [start, *(np.clip(each.q, model.lower, model.upper) for each in columns)],
            [np.zeros(1), *(each.price for each in columns)],
            [self._source.in_front(start, p_start), *(each.in_front for each in columns)],
            task.collision.checkpoint,
        )
        self.fit_failures: list[FitFailure] = []

    def columns(self, s: Array) -> Columns:
        """Configurations for places on the path, shape (n,), [m]."""
        parts = zip(*self._parts(s), strict=True)
        return Columns(*(np.concatenate(values) for values in parts))

    def _parts(self, s: Array) -> Iterator[Columns]:
        p, R = self.task.tool_path.places(s), self._R_base_tool(s)
        for begin in range(0, len(s), AT_ONCE):
            self.task.collision.checkpoint()
            some = slice(begin, begin + AT_ONCE)
            yield self._source.columns(self._criteria, p[some], R[some], self._resolution)

    def run(self) -> ToolMotion | None:
        """Find the motion; None if there is none at this resolution."""
        in_contact = 0
        for _ in range(ATTEMPTS):
            if len(self.fit_failures) == FIT_FAILURES:
                return None
            rows = self.ladder.best()
            if rows is None:
                return None
            if self._is_blocked(rows):
                in_contact += 1
                self._forbid_blocked(rows, thorough=in_contact >= CONTACTS_BEFORE_THOROUGH)
                continue
            found = self._curves(self.ladder.sequence(rows))
            if isinstance(found, ToolMotion):
                return found
            self.fit_failures.append(found)
            i = int(np.clip(np.searchsorted(self.s, found.s, "right"), 1, len(self.s) - 1))
            self.ladder.forbid_step(i - 1, rows[i - 1], rows[i])
        return None

    def farthest(self) -> tuple[int, Array]:
        """The last column reached free of contact, and its configurations (k, 5) [rad]."""
        thorough = False
        while True:
            column = self.ladder.farthest()
            rows = self.ladder.best(column)
            assert rows is not None
            if column == 0 or not self._is_blocked(rows):
                q = self.ladder.q[column][self.ladder.reached(column)]
                free = [each for each in q if self.task.is_free(each)]
                return column, np.array(free or self.ladder.sequence(rows)[-1:])
            self._forbid_blocked(rows, thorough=thorough)
            thorough = True

    def _is_blocked(self, rows: Indices) -> bool:
        q = self.ladder.sequence(rows)
        return self.task.collision.first_blocked(q, self.task.q_jaw) is not None

    def _forbid_blocked(self, rows: Indices, *, thorough: bool) -> None:
        """Forbid configurations in contact: of a sequence, or of all that might still be used."""
        looked_at = self.ladder.useful() if thorough else [row[None] for row in rows]
        found = False
        for column, here in enumerate(looked_at[1:], 1):
            q = self.ladder.q[column]
            blocked = [row for row in here.tolist() if not self.task.is_free(q[row])]
            if blocked:
                self.ladder.forbid(column, np.array(blocked))
                found = True
        if not found:
            self._forbid_blocked_steps(rows)

    def _forbid_blocked_steps(self, rows: Indices) -> None:
        q = self.ladder.sequence(rows)
        for i, leg in enumerate(pairwise(q)):
            if self.task.collision.first_blocked(np.array(leg), self.task.q_jaw) is not None:
                self.ladder.forbid_step(i, rows[i], rows[i + 1])

    def _curves(self, q: Array) -> ToolMotion | FitFailure:
        """Curves between the rests through configurations near those of a sequence."""
        curves: list[JointPath] = []
        off = turned = 0.0
        free = self.task.goal.metric is GoalMetric.POSITION_ONLY
        stiffnesses = SMOOTHED if free else EXACT
        for begin, end in pairwise(self._rests):
            s = self.s[begin : end + 1]
            judge = self._judge(float(s[0]))
            found = self._fitter.fit(self.task.tool_path, s, q[begin : end + 1], stiffnesses, judge)
            if isinstance(found, FitFailure):
                return found
            curves.append(found)
            off = max(off, self._off(found, float(s[0])))
            turned = max(turned, float(self._turned(found, float(s[0]))[1].max()))
        return ToolMotion(q_start=self.task.q_start, curves=tuple(curves), off=off, turned=turned)

    def _judge(self, begin: float) -> Callable[[JointPath], FitFailure | None]:
        """The check of orientation and contact for a curve that starts at ``begin`` [m]."""

        def judge(curve: JointPath) -> FitFailure | None:
            s, angles = self._turned(curve, begin)
            worst = int(np.argmax(angles))
            if angles[worst] > self.task.goal.orientation_tolerance:
                (q,) = curve.evaluate(s[worst : worst + 1] - begin).q
                return FitFailure(s=float(s[worst]), q=q, turned=float(angles[worst]))
            knots = curve.evaluate(curve.knots).q
            blocked = self.task.collision.first_blocked(knots, self.task.q_jaw)
            if blocked is None:
                return None
            nearest = int(np.argmin(np.abs(knots - blocked).max(axis=1)))
            return FitFailure(s=begin + float(curve.knots[nearest]), q=blocked, in_contact=True)

        return judge

    def _off(self, curve: JointPath, begin: float) -> float:
        """Largest distance of the tool from its path [m]."""
        at = _looks(curve)
        p = self._tools.chain.positions(curve.evaluate(at).q)
        return float(np.linalg.norm(p - self.task.tool_path.places(begin + at), axis=1).max())

    def _turned(self, curve: JointPath, begin: float) -> tuple[Array, Array]:
        """Places on the path [m], and how far the tool is turned off there [rad]."""
        metric = self.task.goal.metric
        if metric is GoalMetric.POSITION_ONLY:
            return np.array([begin]), np.zeros(1)
        at = _looks(curve)
        R = self._tools.tool_chain.rotations(curve.evaluate(at).q)
        wanted = self._R_base_tool(begin + at)
        if metric is GoalMetric.POSITION_AND_APPROACH:
            return begin + at, angles_between(R[:, :, 2], wanted[:, :, 2])
        return begin + at, rotation_angles(R.transpose(0, 2, 1) @ wanted)

    def _R_base_tool(self, s: Array) -> Array:
        """Wanted rotations of the tool; without meaning where only the position counts."""
        if self.task.goal.metric is GoalMetric.POSITION_ONLY:
            return np.broadcast_to(np.eye(3), (len(s), 3, 3))
        return self.task.tool_path.rotations(s) @ self._R_frame_tool


def _looks(curve: JointPath) -> Array:
    """The points at which a curve is compared with its path."""
    return np.linspace(0.0, curve.length, _LOOKS * (len(curve.knots) - 1) + 1)


def _stations(tool_path: ToolPath, spacing: float) -> tuple[Array, list[int]]:
    """Places for columns, evenly spaced between rests [m], and the indices of start, rests, end."""
    places, rests = [np.zeros(1)], [0]
    for begin, end in pairwise([0.0, *tool_path.rests, tool_path.length]):
        share = (end - begin) / tool_path.length
        count = max(
            FEWEST,
            math.ceil((end - begin) / spacing),
            math.ceil(share * tool_path.turn / TURN_SPACING),
        )
        places.append(np.linspace(begin, end, count + 1)[1:])
        rests.append(rests[-1] + count)
    return np.concatenate(places), rests
