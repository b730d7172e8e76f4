"""Inverse kinematics: find joint angles for a pose goal.

How it works. Configurations come from closed forms (``ik_closed.py``) with measures that were taken
from the kinematic model (``geometry_from_model.py``). The model then judges each: a few micrometres
of error are polished away, the rest is reported, and nothing outside the joint limits or the goal's
tolerances is returned as a solution.

Position comes first. If a point can be reached but not with the wanted orientation, the
:class:`~so101_motion.common.errors.Unreachable` holds the configuration *at the point* with the
nearest orientation. If the point itself is out of reach, it holds the nearest reachable point
and what stops the arm there.

"Near the seed" is the Euclidean distance of joint angles.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache, partial
from itertools import chain
from math import dist

from numpy.typing import ArrayLike

from so101_motion.common.errors import Unreachable
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_deg, to_mm
from so101_motion.planning.goals import GoalMetric, PoseCloud, PoseGoal
from so101_motion.planning.kinematics.arm_geometry import Joints, to_joints
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.geometry_from_model import measure_structure
from so101_motion.planning.kinematics.ik_closed import ClosedForms, Workspace
from so101_motion.planning.kinematics.ik_cloud import Cloud, CloudSolver
from so101_motion.planning.kinematics.ik_task import (
    FULL_STRETCH,
    IkSolution,
    Task,
    binding_limit,
    check_goal,
    check_seed,
    judge,
    minimise,
)
from so101_motion.planning.kinematics.model import RobotModel

__all__ = ["IkSolution", "IkSolver"]

_EXACT = 1e-9  # larger position errors are polished [m]; chosen
_EXACT_ANGLE = 1e-6  # a full pose this near is exact [rad]; chosen
_SAME = 1e-6  # solutions closer than this count as one [rad]. Chosen
_JUST = 1e-3  # how far polishing may move a solution [rad]; chosen


class IkSolver:
    """Solves pose goals for one model. Belongs to the model's thread.

    Attributes:
        model: The kinematics it solves for.
        structure: The measures of the closed forms.

    Raises:
        ConfigError: The model is not built like the SO-101.
    """

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self.structure = measure_structure(model)
        self._source = ClosedForms(self.structure)
        chain_of = lru_cache(maxsize=8)(partial(ArmChain, model))
        self._clouds = CloudSolver(self.structure, chain_of)
        self._workspace = lru_cache(maxsize=8)(
            lambda frame: Workspace(self.structure, chain_of(frame))
        )

    def solve(self, goal: PoseGoal, q_seed: ArrayLike) -> IkSolution:
        """The solution nearest to the seed.

        If the goal leaves the roll free, it stays that of the seed if possible; if it leaves the
        pitch free, it is the one that moves the joints least.

        Args:
            goal: Goal pose of a gripper frame, and how much of it counts.
            q_seed: Joint angles to stay near, shape (5,), [rad]; they may be outside the limits.

        Raises:
            Unreachable: There is none. Has the nearest reachable pose, its error, and the limit
                that stops the arm there.
            ConfigError: Goal or seed hold numbers that are not valid.
        """
        task, seed = check_goal(self.model, goal), check_seed(q_seed)
        if goal.cloud is not None:
            return next(self._in_cloud(goal.cloud, task, seed))
        full = task.metric is GoalMetric.FULL_POSE
        best: IkSolution | None = None
        for configuration in self._source.nearest(task, seed):
            solution = self._judged(task, configuration)
            if _arrived(task, solution) and (solution.error_angle < _EXACT_ANGLE or not full):
                return solution
            if best is None or _miss(task, solution) < _miss(task, best):
                best = solution
        if best is not None and _arrived(task, best):
            return best
        return self._next_best(task, seed, best)

    def candidates(self, goal: PoseGoal, q_seed: ArrayLike) -> Iterator[IkSolution]:
        """All solutions, the one nearest to the seed first; for a choice by collision.

        If a goal leaves pitch or roll free, the solutions are spread over its range. The first is
        that of :meth:`solve`, with the same errors; the others follow by their distance from the
        seed and are computed when they are needed. No two are equal.
        """
        if goal.cloud is not None:
            task, seed = check_goal(self.model, goal), check_seed(q_seed)
            solutions = self._in_cloud(goal.cloud, task, seed)
            return chain([next(solutions)], solutions)
        first = self.solve(goal, q_seed)
        return chain([first], self._others(check_goal(self.model, goal), check_seed(q_seed), first))

    def _others(self, task: Task, seed: Joints, first: IkSolution) -> Iterator[IkSolution]:
        """The rest of :meth:`candidates`."""
        q_first = first.q.tolist()
        known: list[tuple[float, list[float]]] = []
        for configuration in self._source.spread(task, seed):
            solution = self._judged(task, configuration)
            q = solution.q.tolist()
            away = dist(q, seed)
            like = dist(q, q_first) <= _SAME or _is_known(q, away, known)
            if _arrived(task, solution) and not like:
                known.append((away, q))
                yield solution

    def _in_cloud(self, tolerance: PoseCloud, task: Task, seed: Joints) -> Iterator[IkSolution]:
        """All solutions in a cloud around the task's pose; raises if there is none."""
        R_base_goal = task.R_base_tool @ self.model.rotation_to_tool(task.frame).T
        cloud = Cloud(tolerance, task.frame, task.p_base, R_base_goal, task.R_base_tool)
        found = False
        for configuration in self._clouds.spread(cloud, seed, self._source.nearest(task, seed)):
            found = True
            yield judge(self.model, task, configuration)
        if not found:
            at_point = PoseGoal.at_point(task.p_base, frame=task.frame)
            nearest = self.solve(at_point, seed)  # or says why there is none
            configurations = self._source.nearest(task, seed)
            solutions = (judge(self.model, task, each) for each in configurations)
            best = min(solutions, key=lambda each: _miss(task, each), default=nearest)
            raise _outside_cloud(self.model, task, best)

    def _judged(self, task: Task, configuration: Joints) -> IkSolution:
        """A configuration pulled into the limits, judged by the model, polished if that helps."""
        solution = judge(self.model, task, configuration)
        if solution.error_position > _EXACT:
            q = minimise(self.model, _at_point(task), solution.q)
            polished = judge(self.model, task, to_joints(q))
            if polished.error_position < solution.error_position:
                return polished
        return solution

    def _next_best(self, task: Task, seed: Joints, best: IkSolution | None) -> IkSolution:
        """Search numerically when no closed form has arrived; raises if that fails too."""
        if best is None and task.metric is not GoalMetric.POSITION_ONLY:
            configurations = self._source.nearest(_at_point(task), seed)
            best = next(
                (self._judged(task, configuration) for configuration in configurations), None
            )
        if best is not None and best.error_position <= task.position_tolerance:
            better = self._judged(task, to_joints(minimise(self.model, task, best.q)))
        else:
            better = self._at_edge(task, seed)
        if best is None or _miss(task, better) < _miss(task, best):
            best = better
        if _arrived(task, best):
            return best
        raise _unreachable(self.model, task, best)

    def _at_edge(self, task: Task, seed: Joints) -> IkSolution:
        """The configuration at the reachable point nearest to one that is out of reach."""
        starts = self._workspace(task.frame).starts(task.point, seed)
        ends = [minimise(self.model, _at_point(task), q) for q in starts]
        q_best = min(ends, key=lambda q: self._away(task, q))
        return judge(self.model, task, to_joints(q_best))

    def _away(self, task: Task, q: Array) -> float:
        return dist(self.model.rotation_and_position(q, task.frame)[1].tolist(), task.point)


def _at_point(task: Task) -> Task:
    """The same task without an orientation."""
    return task._replace(metric=GoalMetric.POSITION_ONLY)


def _is_known(q: list[float], away: float, known: list[tuple[float, list[float]]]) -> bool:
    """Whether ``known``, by distance from the seed, holds joint angles at distance ``away``."""
    for other_away, other in reversed(known):
        if away - other_away > _JUST:
            return False
        if dist(q, other) <= _SAME:
            return True
    return False


def _arrived(task: Task, solution: IkSolution) -> bool:
    return (
        solution.error_position <= task.position_tolerance
        and solution.error_angle <= task.angle_tolerance
    )


def _miss(task: Task, solution: IkSolution) -> tuple[float, float]:
    """Error for comparison: position beyond its tolerance first, then the angle."""
    return max(solution.error_position - task.position_tolerance, 0.0), solution.error_angle


def _held_back(limit: str) -> str:
    return "fully stretched" if limit == FULL_STRETCH else f"stopped by {limit}"


def _unreachable(model: RobotModel, task: Task, best: IkSolution) -> Unreachable:
    """The error with the nearest pose, its distance, and the limit in the way."""
    p_base = model.frame(best.q, task.frame).p
    limit = binding_limit(model, task, best.q)
    off, turned = to_mm(best.error_position), to_deg(best.error_angle)
    if best.error_position > task.position_tolerance:
        message = (
            f"{task.frame} cannot reach {_millimetres(task.p_base)}: it is {_digits(off)} mm out "
            f"of reach; the nearest reachable point is {_millimetres(p_base)}"
            + (f", where the arm is {_held_back(limit)}" if limit else "")
            + "; move the target there"
        )
    else:
        joints = ", ".join(f"{to_deg(angle):.1f}" for angle in best.q.tolist())
        message = (
            f"{task.frame} can reach {_millimetres(p_base)}, but five joints cannot turn it as "
            f"asked: the nearest pose, joints ({joints}) deg, is {_digits(off)} mm and "
            f"{turned:.1f} deg off, and {to_deg(task.angle_tolerance):.1f} deg are allowed; allow "
            "more, or ask for the position only"
        )
    return Unreachable(
        message,
        error_position=best.error_position,
        error_angle=best.error_angle,
        p_base_nearest=p_base,
        q_nearest=best.q,
        limit=limit,
    )


def _outside_cloud(model: RobotModel, task: Task, best: IkSolution) -> Unreachable:
    """The error for a cloud without any reachable pose."""
    p_base = model.frame(best.q, task.frame).p
    return Unreachable(
        f"no pose within the tolerances around {_millimetres(task.p_base)} can be reached: the"
        f" nearest is {_digits(to_mm(best.error_position))} mm and"
        f" {to_deg(best.error_angle):.1f} deg"
        " off; allow more of o_x, o_y, o_z or theta, or move the target",
        error_position=best.error_position,
        error_angle=best.error_angle,
        p_base_nearest=p_base,
        q_nearest=best.q,
        limit=binding_limit(model, task, best.q),
    )


def _millimetres(p_base: Array) -> str:
    x, y, z = (round(to_mm(value), 1) + 0.0 for value in p_base.tolist())
    return f"({x}, {y}, {z}) mm"


def _digits(off_mm: float) -> str:
    return f"{off_mm:.1f}" if off_mm >= 1.0 else f"{off_mm:.2f}"
