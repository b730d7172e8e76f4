"""Plans cancelled at every possible moment."""

import numpy as np
import pytest

from so101_motion.common.geometry import SE3
from so101_motion.planning.checkpoint import Abandoned
from so101_motion.planning.collision.scene import Box, Obstacle, PointCloud, Scene
from so101_motion.planning.goals import JointGoal, LineGoal, PathGoal, PoseGoal
from so101_motion.planning.planner import Planner
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
Q_START = np.radians([60.0, 0.0, 0.0, 0.0, 0.0])
Q_GOAL = np.radians([-60.0, 0.0, 10.0, 0.0, 0.0])


def scene():
    post = Obstacle(
        name="post",
        shape=Box(size=np.array([0.05, 0.05, 0.3])),
        T_base_obstacle=SE3.from_translation((0.3, 0.0, 0.15)),
    )
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (40_000, 3))
    cloud = Obstacle(
        name="cloud",
        shape=PointCloud(points=points, resolution=0.01),
        T_base_obstacle=SE3.from_translation((0.2, 0.3, 0.05)),
    )
    return Scene(obstacles=(post, cloud))


class Patience:
    """A checkpoint that gives up at a certain call."""

    def __init__(self):
        self.calls, self.last = 0, None

    def __call__(self):
        self.calls += 1
        if self.calls == self.last:
            raise Abandoned


@pytest.mark.parametrize("kind", ["joints", "pose", "line", "path"])
def test_a_plan_that_is_given_up_anywhere_leaves_the_planner_as_it_was(model, kind):
    goal = {
        "joints": JointGoal(q=Q_GOAL),
        "pose": PoseGoal(T_base_tool=model.frame(Q_GOAL)),
        "line": LineGoal(
            T_base_tool=SE3(
                model.frame(Q_START).R, model.frame(Q_START).p + np.array([0.0, 0.02, 0.02])
            )
        ),
        "path": PathGoal(waypoints=np.array([Q_START + 0.1, Q_START - 0.1])),
    }[kind]
    request = PlanRequest(q_start=Q_START, goal=goal, limits=LIMITS, scene=scene())
    patience = Patience()
    wanted = Planner(model, patience).plan(request)
    assert patience.calls > 20
    planner, given_up = Planner(model, patience), 0
    for last in np.unique(np.geomspace(1, patience.calls, 12).astype(int)).tolist():
        patience.calls, patience.last = 0, last
        try:
            planner.plan(request)  # what has been built for the scene by now is kept
        except Abandoned:
            given_up += 1
    assert given_up > 5
    patience.last = None
    made = planner.plan(request)
    assert np.array_equal(made.trajectory.q, wanted.trajectory.q)
    assert np.array_equal(made.path, wanted.path)
