"""Inverse kinematics: how often it finds a solution, and how long a solve takes.

Targets are the poses of 10,000 random configurations inside the limits, so every one can be
reached; the seed is always the home configuration, all joints at zero. Success is judged here, by
forward kinematics alone: within 0.1 mm, inside the limits, and within 1 degree of the approach (or
of the whole rotation) where it counts. What is timed is the public call, with its checks of the
goal and of the solution.

The points out of reach are random ones that were refused. Peers are on the same targets in the same
run: pin-pink, its differential inverse kinematics repeated until it is within 0.1 mm, at most 200
times, with joint limits, and with the faster of its solvers that is installed; and roboticstoolbox
if it is installed, its compiled Levenberg-Marquardt with joint limits and up to 100 restarts.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import qpsolvers
import so101_description
from pink import Configuration, solve_ik
from pink.tasks import FrameTask

from benchmarks import _common
from so101_motion.common.errors import Unreachable
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_mm
from so101_motion.planning.goals import GoalMetric, PoseGoal
from so101_motion.planning.kinematics.ik import IkSolution, IkSolver
from so101_motion.planning.kinematics.ik_task import angle_between
from so101_motion.planning.kinematics.model import RobotModel

N = 10_000
SEED = 0
HOME = np.zeros(5)
WITHIN = 1e-4
APPROACH = np.radians(1.0)
PINK_STEPS = 200
PINK_DT = 0.2
FRAMES = ("tool", "jaw_tip")


def main() -> None:
    """Run everything, print the table, write the results."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    _common.single_thread()
    model = RobotModel.load()
    solver = IkSolver(model)
    rng = np.random.default_rng(SEED)
    configurations = rng.uniform(model.lower, model.upper, (N, 5))
    rows = []
    medians = {}
    for metric in GoalMetric:
        for frame in FRAMES:
            goals = targets(model, configurations, metric, frame)
            row = ours(solver, goals)
            medians[metric, frame] = row["median"]
            rows.append(row)
    rows += [out_of_reach(solver, rng, frame) for frame in FRAMES]
    rows.append(all_candidates(solver, targets(model, configurations[:1000])))
    pink = Pink()
    for metric, frame in (
        (GoalMetric.POSITION_ONLY, "tool"),
        (GoalMetric.POSITION_ONLY, "jaw_tip"),
        (GoalMetric.POSITION_AND_APPROACH, "tool"),
    ):
        row = peer(pink, model, targets(model, configurations, metric, frame))
        rows.append({**row, "times_ours": row["median"] / medians[metric, frame]})
    rows += toolbox_rows(model, configurations, medians)
    peers = ("pin-pink", "qpsolvers", pink.solver, "roboticstoolbox-python")
    _common.write("bench_ik", rows, peers=peers)


def targets(
    model: RobotModel,
    configurations: Array,
    metric: GoalMetric = GoalMetric.POSITION_ONLY,
    frame: str = "tool",
) -> list[PoseGoal]:
    """The poses that configurations, shape (n, 5), [rad], bring a frame to, as goals."""
    return [
        PoseGoal(T_base_tool=model.frame(q, frame), metric=metric, frame=frame)
        for q in configurations
    ]


def ours(solver: IkSolver, goals: Sequence[PoseGoal]) -> dict[str, Any]:
    """The public solve."""

    def solve(goal: PoseGoal) -> Array | None:
        try:
            return solver.solve(goal, HOME).q
        except Unreachable:
            return None

    return judged(solver.model, goals, solve, f"{goals[0].metric.value}, {goals[0].frame}")


def out_of_reach(solver: IkSolver, rng: np.random.Generator, frame: str) -> dict[str, Any]:
    """Points that are refused, each with its nearest reachable point and limit by name."""

    def refused(p_base: Array) -> str | None:
        try:
            solver.solve(PoseGoal.at_point(p_base, frame=frame), HOME)
        except Unreachable as error:
            return error.limit
        return None

    points = rng.uniform([-0.6, -0.6, -0.4], [0.6, 0.6, 0.7], (N, 3))
    far = [p_base for p_base in points if refused(p_base)][: N // 4]
    found, times = _common.measure(refused, far)
    return {
        "what": f"out of reach, {frame}",
        **_common.summary(times),
        "success_percent": 100.0 * sum(map(bool, found)) / len(far),
    }


def all_candidates(solver: IkSolver, goals: Sequence[PoseGoal]) -> dict[str, Any]:
    """Every alternative for a point, as a planner asks for when the first is in collision."""

    def solve(goal: PoseGoal) -> list[IkSolution]:
        return list(solver.candidates(goal, HOME))

    found, times = _common.measure(solve, goals)
    return {
        "what": "all candidates for a point, tool",
        **_common.summary(times),
        "solutions": float(np.mean([len(solutions) for solutions in found])),
    }


class Pink:
    """Differential inverse kinematics of pin-pink, repeated from home until it arrives."""

    def __init__(self) -> None:
        available = qpsolvers.available_solvers
        self.solver: str = "daqp" if "daqp" in available else available[0]
        model = pin.buildModelFromUrdf(str(so101_description.URDF_PATH))
        self._model = pin.buildReducedModel(model, [model.getJointId("gripper")], np.zeros(6))
        self._data = self._model.createData()

    def solve(self, goal: PoseGoal) -> Array | None:
        """Joint angles, shape (5,), [rad], where it arrived or gave up; None where it failed."""
        costs = {
            GoalMetric.POSITION_ONLY: 0.0,
            GoalMetric.POSITION_AND_APPROACH: [0.1, 0.1, 0.0],
        }
        task = FrameTask(goal.frame, position_cost=1.0, orientation_cost=costs[goal.metric])
        T = goal.T_base_tool
        task.set_target(pin.SE3(np.array(T.R), np.array(T.p)))
        configuration = Configuration(self._model, self._data, HOME)
        for _ in range(PINK_STEPS):
            error = task.compute_error(configuration)
            aligned = goal.metric is GoalMetric.POSITION_ONLY or (
                np.hypot(*error[3:5]) < 0.5 * APPROACH
            )
            if np.linalg.norm(error[:3]) < 0.5 * WITHIN and aligned:
                break
            try:
                v = solve_ik(configuration, [task], PINK_DT, solver=self.solver, damping=1e-6)
            except Exception:
                return None  # its QP has no solution, or the solver says so
            configuration.integrate_inplace(v, PINK_DT)
        return np.array(configuration.q)


def toolbox_rows(
    model: RobotModel, configurations: Array, medians: dict[tuple[GoalMetric, str], float]
) -> list[dict[str, Any]]:
    """The same points by roboticstoolbox; none if it is not installed."""
    try:
        from roboticstoolbox import ET, ETS
    except ImportError:
        return []
    rows = []
    for frame in FRAMES:
        arm = model.pin_model
        chain = ETS()
        for joint in range(1, 6):
            limits = [model.lower[joint - 1], model.upper[joint - 1]]
            chain = chain * ET.SE3(arm.jointPlacements[joint].homogeneous) * ET.Rz(qlim=limits)
        chain = chain * ET.SE3(arm.frames[arm.getFrameId(frame)].placement.homogeneous)
        within = {"mask": np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]), "tol": 0.5 * WITHIN**2}

        def solve(goal: PoseGoal, chain: Any = chain, within: Any = within) -> Array | None:
            T = goal.T_base_tool.matrix
            found = chain.ik_LM(T, q0=HOME, slimit=100, joint_limits=True, **within)
            return np.asarray(found.q) if found.success else None

        goals = targets(model, configurations, frame=frame)
        row = judged(model, goals, solve, f"roboticstoolbox LM position_only, {frame}")
        ours = medians[GoalMetric.POSITION_ONLY, frame]
        rows.append({**row, "times_ours": row["median"] / ours})
    return rows


def peer(pink: Pink, model: RobotModel, goals: Sequence[PoseGoal]) -> dict[str, Any]:
    """The same goals by pin-pink."""
    what = f"pin-pink ({pink.solver}) {goals[0].metric.value}, {goals[0].frame}"
    return judged(model, goals, pink.solve, what)


def judged(
    model: RobotModel,
    goals: Sequence[PoseGoal],
    solve: Callable[[PoseGoal], Array | None],
    what: str,
) -> dict[str, Any]:
    """Times of a solver, and how often forward kinematics agrees that it has solved."""
    solve(goals[0])
    found, times = _common.measure(solve, goals)
    good, worst = 0, 0.0
    for goal, q in zip(goals, found, strict=True):
        if q is None or model.outside(q, tolerance=1e-9) is not None:
            continue
        T = model.frame(q, goal.frame)
        away = float(np.linalg.norm(T.p - goal.T_base_tool.p))
        if away <= WITHIN and missing_turn(goal, T.R) <= APPROACH + 1e-9:
            good, worst = good + 1, max(worst, away)
    return {
        "what": what,
        **_common.summary(times),
        "success_percent": 100.0 * good / len(goals),
        "worst_mm": to_mm(worst),
    }


def missing_turn(goal: PoseGoal, R_base_frame: Array) -> float:
    """What is left of the orientation that counts [rad]."""
    wanted = goal.T_base_tool.R
    if goal.metric is GoalMetric.POSITION_ONLY:
        return 0.0
    if goal.metric is GoalMetric.POSITION_AND_APPROACH:
        return angle_between(R_base_frame[:, 2].tolist(), wanted[:, 2].tolist())
    cosine = 0.5 * (np.trace(R_base_frame.T @ wanted) - 1.0)
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


if __name__ == "__main__":
    main()
