"""An arm that is deep in contact gets out of it when it is asked to."""

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError, InCollision
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Obstacle, Scene, Sphere
from so101_motion.planning.goals import LeaveContactGoal
from so101_motion.planning.planner import Planner, PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

BELOW = np.array([0.3, 1.2, 0.0, 1.2, 0.5])
"""The gripper is far below the table."""

LIMITS = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=50.0)


def plan(model, q_start, scene=None):
    request = PlanRequest(
        q_start=q_start, goal=LeaveContactGoal(), limits=LIMITS, scene=scene or Scene()
    )
    return Planner(model).plan(request)


def test_it_rises_and_stops_as_soon_as_it_is_free(model):
    found = plan(model, BELOW)
    collision = CollisionModel(model)
    heights = [model.frame(q).p[2] for q in found.trajectory.q]
    assert np.all(np.diff(heights) > -1e-6)
    assert collision.is_free(found.q_goal)
    halfway = BELOW + 0.5 * (found.q_goal - BELOW)
    assert not collision.is_free(halfway), "it goes no farther than it must"


def test_a_free_arm_stays(model):
    found = plan(model, np.zeros(5))
    assert found.trajectory.duration == 0.0


def test_an_arm_that_is_buried_is_told_of_the_hand(model):
    buried = Obstacle(name="heap", shape=Sphere(radius=0.9), T_base_obstacle=SE3.identity())
    with pytest.raises(InCollision, match="no straight motion frees it; move the arm by hand"):
        plan(model, np.zeros(5), Scene(obstacles=(buried,)))


@pytest.mark.parametrize("farthest", [0.0, -1.0, 2.1, np.nan])
def test_an_invalid_length_is_refused(farthest):
    with pytest.raises(ConfigError, match="farthest"):
        LeaveContactGoal(farthest=farthest)
