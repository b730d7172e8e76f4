"""Solve, plan and time fixed problems and write the numbers to a file: same_numbers.py FILE.

Written on two processors, two files tell whether both compute the same.
"""

import sys
from itertools import islice

import numpy as np

from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.planning.goals import GoalMetric, JointGoal, PoseGoal
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner, PlanRequest
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
BOXES = Scene(
    obstacles=tuple(
        Obstacle(
            name=f"box {k}",
            shape=Box(size=np.array([0.06, 0.06, 0.2])),
            T_base_obstacle=SE3(np.eye(3), np.array(p_base)),
        )
        for k, p_base in enumerate([(0.22, 0.1, 0.1), (0.22, -0.1, 0.1), (0.3, 0.0, 0.1)])
    )
)


def main(file: str) -> None:
    model, found = RobotModel.load(), {}
    random = np.random.default_rng(1)
    q_all = random.uniform(model.lower, model.upper, (300, 5))
    solver = IkSolver(model)
    for metric in GoalMetric:
        for frame in ("tool", "jaw_tip"):
            solutions = [
                solution.q
                for q in q_all
                for solution in islice(
                    solver.candidates(
                        PoseGoal(T_base_tool=model.frame(q, frame), metric=metric, frame=frame),
                        np.zeros(5),
                    ),
                    4,
                )
            ]
            found[f"ik, {metric.value}, {frame}"] = np.array(solutions)
    planner = Planner(model)
    for k, (start, goal) in enumerate(q_all[:60].reshape(-1, 2, 5)):
        scene = BOXES if k % 2 else Scene()
        request = PlanRequest(
            q_start=start, goal=JointGoal(q=goal), limits=LIMITS, scene=scene, seed=k
        )
        try:
            found[f"plan {k}"] = planner.plan(request).trajectory.q
        except PlanningError as error:
            found[f"refused {k}"] = np.array([type(error).__name__])
        stop = online.stop(start, 0.2 * goal, np.zeros(5), LIMITS, 0.01)  # by ruckig
        found[f"stop {k}"] = stop.q
    np.savez(file, **found)


if __name__ == "__main__":
    main(sys.argv[1])
