"""How planning time grows: thousands of boxes, long programs, motions through many waypoints.

Small boxes at random places around the arm, none of them in its way; the first plan and a further
one. Programs whose steps are all stops, or all passed but the last. One motion through waypoints.
``over half`` is the (first) plan's time over that with half as many: 2 is linear.

    python -m benchmarks.bench_boxes
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from benchmarks import _common
from benchmarks.bench_replan import planning_here
from so101_motion.common.clock import ManualClock
from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.planning.goals import JointGoal, PathGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.tasks.program.program import ARM, Program, Waypoint
from so101_motion.tasks.program.rehearsal import rehearse
from so101_motion.tasks.program.solo import Solo

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
START, GOAL = (np.array([side * 0.6, -0.6, 0.6, 0.3, 0.0]) for side in (-1.0, 1.0))
SIZE, FREE, HEIGHT = 0.008, 0.36, 0.45  # of a box, and of the cylinder without any [m]


def around(count: int) -> Scene:
    """Boxes around the arm."""
    random, boxes = np.random.default_rng(0), list[Obstacle]()
    while len(boxes) < count:
        p = random.uniform([-0.5, -0.5, 0.0], [0.5, 0.5, 0.6])
        if np.hypot(p[0], p[1]) > FREE or p[2] > HEIGHT:
            name, T = f"box {len(boxes)}", SE3(np.eye(3), p)
            boxes.append(Obstacle(name=name, shape=Box(size=np.full(3, SIZE)), T_base_obstacle=T))
    return Scene(obstacles=tuple(boxes))


def wander(count: int) -> Array:
    """Configurations (count, 5) [rad] near each other, on a smooth course."""
    along = np.arange(count)[:, None] * np.array([0.11, 0.07, 0.13, 0.05, 0.17])
    return np.asarray([0.0, -0.6, 0.6, 0.3, 0.0] + 0.3 * np.sin(along))


def rehearsed(count: int, passes: bool) -> float:
    """How long a program is planned [ms]."""
    steps = [Waypoint(name=str(k), q=q, passes=passes) for k, q in enumerate(wander(count))]
    steps[-1] = replace(steps[-1], passes=False)
    with planning_here(RobotModel.load(), ManualClock(), 1.0) as rig:
        program = Program(steps=tuple({ARM: each} for each in steps))
        begin = time.thread_time()
        rehearse(Solo.of(rig), program)
        return 1e3 * (time.thread_time() - begin)


def through(planner: Planner, count: int) -> float:
    """How long a motion through waypoints is planned [ms]."""
    q = wander(count)
    request = PlanRequest(q_start=q[0], goal=PathGoal(waypoints=q[1:]), limits=LIMITS)
    begin = time.thread_time()
    planner.plan(request)
    return 1e3 * (time.thread_time() - begin)


def main() -> None:
    """Run everything and write the result."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    _common.single_thread()
    planner, rows = Planner(RobotModel.load()), list[_common.Row]()

    def among(count: int) -> tuple[float, ...]:
        request = PlanRequest(
            q_start=START, goal=JointGoal(q=GOAL), limits=LIMITS, scene=around(count)
        )
        times = []
        for _ in range(4):
            begin = time.thread_time()
            planner.plan(request)
            times.append(1e3 * (time.thread_time() - begin))
        return times[0], float(np.median(times[1:]))

    for what, counts, measured in (
        ("boxes", (0, 1_250, 2_500, 5_000, 10_000), among),
        ("stops", (250, 500, 1_000, 2_000), lambda count: (rehearsed(count, False),)),
        ("steps, passed", (250, 500, 1_000, 2_000), lambda count: (rehearsed(count, True),)),
        ("waypoints", (125, 250, 500, 1_000), lambda count: (through(planner, count),)),
    ):
        half, before = -1, 0.0
        for count in counts:
            first, *further = measured(count)
            row: dict[str, object] = {"what": f"{count} {what}", "plan (ms)": round(first, 1)}
            if further:
                row["further plan (ms)"] = round(further[0], 2)
            if count == 2 * half:
                row["over half"] = round(first / before, 2)
            rows.append(row)
            half, before = count, first
            print(row, flush=True)
    _common.write("bench_boxes", rows)


if __name__ == "__main__":
    main()
