"""Straight lines and paths of the tool: share found of those that exist, accuracy, time.

Whether a line exists is decided by exhaustion: a flood fill over points a millimetre apart, all
pitches a degree apart, both sides and both ways to bend, in which the arm may also stop and change
its configuration with the tool held still. It is more lenient than a planner (it only checks that
neighbouring configurations are near and free, not the motion between them), so it may count lines
that do not exist. It is asked only about the lines that were refused.

Run: ``python -m benchmarks.bench_line``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np

from benchmarks import _common
from so101_motion.common.errors import PlanningError, Unreachable
from so101_motion.common.geometry import SE3, Array, rot_z
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import FLOOR_Z
from so101_motion.planning.goals import (
    ApproachGoal,
    Goal,
    GoalMetric,
    LineGoal,
    LineTo,
    PoseCloud,
    PoseGoal,
    ToolPathGoal,
)
from so101_motion.planning.kinematics.arm_geometry import ArmStructure
from so101_motion.planning.kinematics.batch_ik import (
    configurations,
    facing,
    hands,
    straight_pitches,
)
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner, PlanRequest
from so101_motion.planning.request import Plan
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.verify import limit_report

N = 500
LINE = 0.1
DT = 0.01
LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
CAPPED = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=0.1)
DOWN = np.diag([1.0, -1.0, -1.0])
CPU, WALL = "CPU of the thread", "wall"

BETWEEN_POINTS, BETWEEN_PITCHES = 0.001, np.radians(1.0)
"""How finely the oracle looks [m], [rad]."""

STEP, PAN_STEP = 0.2, 1.0
"""How near configurations must be for the oracle to step from one to the other, any joint but the
pan and the pan [rad]; past the pan axis it turns by as much within a millimetre."""


class Bench:
    """The arm, its planner, and random lines."""

    def __init__(self) -> None:
        self.model = RobotModel.load()
        self.collision = CollisionModel(self.model)
        self.planner = Planner(self.model)
        self.ik = IkSolver(self.model)
        self.tool = ArmChain(self.model)
        self.rng = np.random.default_rng(0)

    def free_posture(self) -> Array:
        """A random configuration without contact."""
        while True:
            q: Array = self.rng.uniform(self.model.lower, self.model.upper)
            if self.collision.is_free(q):
                return q

    def lines(self) -> list[PlanRequest]:
        """Lines in random directions from random configurations, whose ends can be reached."""
        requests: list[PlanRequest] = []
        while len(requests) < N:
            q = self.free_posture()
            T = self.model.frame(q)
            way = self.rng.standard_normal(3)
            p_end = T.p + LINE * way / np.linalg.norm(way)
            try:
                self.ik.solve(PoseGoal.at_point(p_end), q)
            except Unreachable:
                continue
            requests.append(request(q, LineGoal(T_base_tool=SE3(T.R, p_end))))
        return requests

    def attempt(self, asked: PlanRequest) -> Plan | PlanningError:
        """A plan, or why there is none."""
        try:
            return self.planner.plan(asked)
        except PlanningError as error:
            return error


def request(q_start: Array, goal: Goal, limits: MotionLimits = LIMITS) -> PlanRequest:
    """A request as the benchmark makes them."""
    return PlanRequest(q_start=q_start, goal=goal, limits=limits, dt=DT, q_jaw=0.0)


def exists(bench: Bench, asked: PlanRequest) -> float:
    """The share of a line that can be followed at all, by exhaustion."""
    structure = bench.ik.structure
    assert structure is not None
    assert isinstance(asked.goal, LineGoal)
    p_start, p_end = bench.model.frame(asked.q_start).p, asked.goal.T_base_tool.p
    count = round(LINE / BETWEEN_POINTS) + 1
    points = p_start + np.linspace(0.0, 1.0, count)[:, None] * (p_end - p_start)
    columns = _every_posture(structure, points, asked.q_start)
    reached = asked.q_start[None]
    for i, q in enumerate(columns):
        free = np.array([bench.collision.is_free(each) for each in q], dtype=bool)
        q = q[free]
        here = _near(reached, q).any(axis=0)
        near = _near(q, q)
        while True:  # with the tool held still
            more = near[here].any(axis=0)
            if np.array_equal(more | here, here):
                break
            here |= more
        if not here.any():
            return i / (count - 1)
        reached = q[here]
    return 1.0


def _every_posture(structure: ArmStructure, points: Array, q_start: Array) -> list[Array]:
    roll = np.array([[[q_start[4]]]])
    hand = hands(structure, "tool", roll)
    target = facing(structure, points, hand.lateral)
    even = q_start[1:4].sum() + np.arange(0.0, 2.0 * np.pi, BETWEEN_PITCHES)
    straight = straight_pitches(structure, target, hand)
    every = np.broadcast_to(even, (*straight.shape[:2], len(even)))
    grid = configurations(structure, target, hand, np.concatenate([every, straight], axis=2), roll)
    return [q[excess <= 1e-6] for q, excess in zip(grid.q, grid.excess, strict=True)]


def _near(a: Array, b: Array) -> Array:
    apart = np.abs(a[:, None] - b[None])
    return np.asarray((apart[..., 0] <= PAN_STEP) & (apart[..., 1:].max(axis=2) <= STEP))


def line_rows(bench: Bench) -> list[_common.Row]:
    """Random lines: how many of those that exist are found, and what it takes."""
    requests = bench.lines()
    answers, times = _common.measure(bench.attempt, requests)
    found = [isinstance(answer, Plan) for answer in answers]
    refused = [k for k, each in enumerate(found) if not each]
    shares = {k: exists(bench, requests[k]) for k in refused}
    missed = sum(share == 1.0 for share in shares.values())
    told = [abs(_fraction(answers[k]) - share) for k, share in shares.items() if share < 1.0]
    plans = [answer for answer in answers if isinstance(answer, Plan)]
    off = [_off_line(bench, plan) for plan in plans]
    load = max(limit_report(plan.trajectory, LIMITS).worst for plan in plans)
    print(
        f"of {N} lines of {to_mm(LINE)} whose ends can be reached {len(plans)} are found and"
        f" {missed} more exist: {100.0 * len(plans) / (len(plans) + missed):.2f} %"
    )
    rows: list[_common.Row] = [
        {
            "what": "line of 100 mm, found",
            **_common.summary(np.array(times)[found]),
            "clock": CPU,
            "solved": f"{len(plans)} of {len(plans) + missed} that exist",
            "off [m]": float(max(off)),
            "load": load,
            "duration": float(np.median([plan.duration for plan in plans])),
        },
        {
            "what": "line of 100 mm, refused",
            **_common.summary(np.array(times)[refused]),
            "clock": CPU,
            "told wrong by [m]": LINE * float(np.median(told)),
            "told wrong by, p95 [m]": LINE * float(np.percentile(told, 95.0)),
        },
    ]
    return rows + _stages(plans)


def to_mm(length: float) -> str:
    """A length in words."""
    return f"{1e3 * length:.0f} mm"


def _fraction(answer: Plan | PlanningError) -> float:
    return float(getattr(answer, "fraction", None) or 0.0)


def _off_line(bench: Bench, plan: Plan) -> float:
    """How far the tool is from the line at any sample, by the model [m]."""
    p = np.array([bench.model.frame(q).p for q in plan.trajectory.q])
    along = (p[-1] - p[0]) / np.linalg.norm(p[-1] - p[0])
    offset = p - p[0]
    return float(np.linalg.norm(offset - np.outer(offset @ along, along), axis=1).max())


def _stages(plans: Sequence[Plan]) -> list[_common.Row]:
    stages = dict.fromkeys(stage for plan in plans for stage in plan.report.stages_ms)
    return [
        {
            "what": f"  {stage}",
            **_common.summary([plan.report.stages_ms.get(stage, 0.0) * 1e-3 for plan in plans]),
            "clock": WALL,
        }
        for stage in stages
    ]


def table_rows(bench: Bench) -> list[_common.Row]:
    """Down to a cube on the table, 40 mm above it and then 5 mm, at any place and any yaw."""
    rows: list[_common.Row] = []
    for metric in GoalMetric:
        goals = [
            ApproachGoal(
                T_base_tool=T, hover=np.array([0.0, 0.0, 0.035]), metric=metric, frame="jaw_tip"
            )
            for T in _over_the_table(0.005)
        ]
        rows.append(_row(bench, f"down to a cube, {metric.value}", goals))
    any_turn = [
        PoseGoal(T_base_tool=T, frame="jaw_tip", cloud=PoseCloud(theta=np.pi))
        for T in _over_the_table(0.040)
    ]
    rows.append(_row(bench, "above a cube, cloud with any turn", any_turn))
    return rows


def _over_the_table(height: float) -> list[SE3]:
    """The jaw's tip, pointing down, over the middle of 20 mm cubes all over the table."""
    poses = []
    for radius in (0.10, 0.13, 0.16, 0.19, 0.22):
        for azimuth in np.radians(np.arange(-100, 101, 25)):
            x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
            p = np.array([0.0388353 + x, y, FLOOR_Z + 0.010 + height])
            poses += [SE3(rot_z(yaw) @ DOWN, p) for yaw in np.radians(np.arange(0, 360, 30))]
    return poses


def _row(
    bench: Bench, what: str, goals: Sequence[Goal], limits: MotionLimits = LIMITS
) -> _common.Row:
    start = np.zeros(5)
    requests = [request(start, goal, limits) for goal in goals]
    answers, times = _common.measure(bench.attempt, requests)
    solved = sum(isinstance(answer, Plan) for answer in answers)
    why = sorted({type(answer).__name__ for answer in answers if not isinstance(answer, Plan)})
    return {
        "what": what,
        **_common.summary(times),
        "clock": CPU,
        "solved": f"{solved} of {len(goals)}",
        "else": ", ".join(why),
    }


def path_rows(bench: Bench) -> list[_common.Row]:
    """A square of 60 mm with corners rounded within 8 mm, at different places."""
    rows: list[_common.Row] = []
    for limits, named in ((LIMITS, ""), (CAPPED, ", tool at 100 mm/s")):
        requests = []
        for pan in np.radians(np.arange(-80, 81, 10)):
            q = np.radians([0.0, -20.0, 20.0, 90.0, 0.0])
            q[0] = pan
            T = bench.model.frame(q)
            corners = 0.03 * np.array([[1, 0], [1, 1], [-1, 1], [-1, -1], [1, -1], [1, 0], [0, 0]])
            segments = tuple(
                LineTo(T_base_tool=SE3(T.R, T.p + np.array([x, y, 0.0]))) for x, y in corners
            )
            goal = ToolPathGoal(
                segments=segments, blend=0.008, metric=GoalMetric.POSITION_AND_APPROACH
            )
            requests.append(request(q, goal, limits))
        answers, times = _common.measure(bench.attempt, requests)
        plans = [answer for answer in answers if isinstance(answer, Plan)]
        rows.append(
            {
                "what": f"square with rounded corners{named}",
                **_common.summary(times),
                "clock": CPU,
                "solved": f"{len(plans)} of {len(requests)}",
                "duration": float(np.median([plan.duration for plan in plans])),
            }
        )
    return rows


def speed_rows(bench: Bench) -> list[_common.Row]:
    """The tool's speed at ten thousand samples, at once and one by one."""
    q, qd = bench.rng.uniform(bench.model.lower, bench.model.upper, (2, 10_000, 5))

    def one_by_one(_: int) -> Array:
        jacobian = bench.model.frame_jacobian
        velocity = [jacobian(here)[:3] @ rate for here, rate in zip(q, qd, strict=True)]
        return np.asarray(np.linalg.norm(velocity, axis=1))

    together, fast = _common.measure(lambda _: bench.tool.speeds(q, qd), range(20))
    single, slow = _common.measure(one_by_one, range(3))
    assert np.allclose(together[0], single[0], atol=1e-12)
    return [
        {"what": "10 000 tool speeds at once", **_common.summary(fast), "clock": CPU},
        {"what": "10 000 tool speeds one by one", **_common.summary(slow), "clock": CPU},
    ]


def main() -> None:
    """Run everything and write the result."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    _common.single_thread()
    bench = Bench()
    begin = time.perf_counter()
    bench.planner.warm_up()
    print(f"warm-up {time.perf_counter() - begin:.2f} s")
    rows = [
        *line_rows(bench),
        *table_rows(bench),
        *path_rows(bench),
        *speed_rows(bench),
    ]
    _common.write("bench_line", rows)


if __name__ == "__main__":
    main()
