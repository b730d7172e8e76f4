"""Picking cubes off a table from above and putting them down again."""

import numpy as np
import pytest

from so101_motion.common.errors import Unreachable
from so101_motion.common.geometry import SE3, rot_z
from so101_motion.planning.collision.scene import FLOOR_Z
from so101_motion.planning.goals import ApproachGoal, GoalMetric, LineGoal
from so101_motion.planning.planner import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
DOWN = np.diag([1.0, -1.0, -1.0])
HOVER, DESCENDED = 0.040, 0.005
CUBE = 0.020
JAW_OPEN = 0.5

PLACES = [
    (radius, azimuth)
    for radius in (0.11, 0.16, 0.22)
    for azimuth in np.radians((-80.0, -25.0, 30.0, 85.0))
]
YAWS = np.radians((0.0, 50.0, 100.0, 170.0, 230.0, 310.0))


def over(model, radius, azimuth, yaw, height):
    """The jaw's tip, pointing down, so far above the middle of a cube on the table."""
    x, y = (0.0388353, 0.0) + radius * np.array([np.cos(azimuth), np.sin(azimuth)])
    return SE3(rot_z(yaw) @ DOWN, (x, y, FLOOR_Z + 0.5 * CUBE + height))


def request(q_start, goal):
    return PlanRequest(q_start=q_start, goal=goal, limits=LIMITS, q_jaw=JAW_OPEN)


@pytest.mark.parametrize(("radius", "azimuth"), PLACES)
def test_from_above_every_place_and_yaw_is_reached_and_left_again(model, planner, radius, azimuth):
    for yaw in YAWS:
        goal = ApproachGoal(
            T_base_tool=over(model, radius, azimuth, yaw, DESCENDED),
            hover=(0.0, 0.0, HOVER - DESCENDED),
            frame="jaw_tip",
        )
        down = planner.plan(request(np.zeros(5), goal))
        tip = model.frame(down.q_goal, "jaw_tip")
        assert tip.p == pytest.approx(goal.T_base_tool.p, abs=1e-4)
        assert tip.R[:, 2] == pytest.approx([0.0, 0.0, -1.0], abs=0.02)
        last = np.array([model.frame(q, "jaw_tip").p for q in down.trajectory.q[-20:]])
        assert np.abs(last[:, :2] - tip.p[:2]).max() < 1e-4  # straight down
        up = LineGoal(
            T_base_tool=over(model, radius, azimuth, yaw, HOVER),
            frame="jaw_tip",
            metric=GoalMetric.POSITION_AND_APPROACH,
        )
        planner.plan(request(down.q_goal, up))


def test_an_approach_that_cannot_be_followed_says_why(model, planner):
    T = over(model, 0.16, 0.0, 0.0, -0.03)
    with pytest.raises(Exception, match=r"the jaw_tip can follow \d+ of the 40 mm .* the floor"):
        planner.plan(request(np.zeros(5), ApproachGoal(T_base_tool=T, frame="jaw_tip")))


def test_a_place_above_which_nothing_can_hover_is_refused_as_a_goal(model, planner):
    T = over(model, 0.6, 0.0, 0.0, 0.0)
    with pytest.raises(Unreachable, match="out of reach"):
        planner.plan(request(np.zeros(5), ApproachGoal(T_base_tool=T, frame="jaw_tip")))
