"""Planning among thousands of boxes: the first plan, a further one, and how that grows.

Small boxes at random places around the arm, none of them in its way. ``over half`` is the first
plan's time over that with half as many boxes: 2 is linear.

    python -m benchmarks.bench_boxes
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from benchmarks import _common
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

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


def main() -> None:
    """Run everything and write the result."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    _common.single_thread()
    planner, rows, before = Planner(RobotModel.load()), list[_common.Row](), 0.0
    for count in (0, 1_250, 2_500, 5_000, 10_000):
        request = PlanRequest(
            q_start=START, goal=JointGoal(q=GOAL), limits=LIMITS, scene=around(count)
        )
        times = []
        for _ in range(4):
            begin = time.thread_time()
            planner.plan(request)
            times.append(1e3 * (time.thread_time() - begin))
        over = {"over half": round(times[0] / before, 2)} if before and count > 1_250 else {}
        before = times[0]
        rows.append(
            {
                "boxes": count,
                "first plan (ms)": round(times[0], 1),
                "further plan (ms)": round(float(np.median(times[1:])), 2),
                **over,
            }
        )
    _common.write("bench_boxes", rows)


if __name__ == "__main__":
    main()
