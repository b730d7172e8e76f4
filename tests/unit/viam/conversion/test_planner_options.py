import logging
import math

import pytest
from viam.proto.common import PoseCloud as ViamCloud

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import MARGIN, Scene
from so101_motion.planning.goals import GoalMetric, PoseGoal
from so101_motion.viam.conversion.planner_options import (
    OptionWarnings,
    PlannerOptions,
    from_goal_cloud,
    to_goal_cloud,
)

GOAL = PoseGoal(T_base_tool=SE3.identity())


def test_a_request_that_says_nothing_counts_the_point_alone():
    options = PlannerOptions.of({})
    assert options.goal(GOAL).metric is GoalMetric.POSITION_ONLY
    assert options.search(Scene()).seed == 0


def test_tolerances_seed_margin_and_time_are_taken():
    extra = {
        "goal_metric_type": "position_and_approach",
        "position_tolerance_mm": 2,
        "orientation_tolerance_deg": 10,
        "rseed": 7,
        "timeout": 1.5,
        "route_effort": 40,
        "collision_buffer_mm": 8,
    }
    options = PlannerOptions.of(extra)
    goal, search = options.goal(GOAL), options.search(Scene())
    assert goal.metric is GoalMetric.POSITION_AND_APPROACH
    assert (goal.position_tolerance, goal.approach_tolerance) == pytest.approx(
        (0.002, math.radians(10))
    )
    assert (search.seed, search.time_budget, search.route_effort) == (7, 1.5, 40)
    assert search.scene.margin == pytest.approx(0.008)


def test_a_margin_below_our_own_does_not_undercut_it():
    options = PlannerOptions.of({"collision_buffer_mm": 1e-8})
    assert options.search(Scene()).scene.margin == MARGIN


def test_a_cloud_replaces_the_metric():
    extra = {"pose_cloud": {"x": 3, "oz": 0.1, "theta": 180}}
    cloud = PlannerOptions.of(extra).goal(GOAL).cloud
    assert (cloud.x, cloud.o_z, cloud.theta) == pytest.approx((0.003, 0.1, math.pi))
    same = from_goal_cloud(ViamCloud(x=3, o_z=0.1, theta=180))
    assert same == cloud
    assert from_goal_cloud(to_goal_cloud(cloud)) == cloud


@pytest.mark.parametrize(
    ("extra", "says"),
    [
        ({"goal_metric_type": "positon_only"}, 'did you mean "position_only"'),
        ({"pose_cloud": {"X": 1}}, "pose_cloud"),
        ({"pose_cloud": {"x": -1}}, "x"),
        ({"pose_cloud": {"x": float("nan")}}, "finite"),
        ({"pose_cloud": 3}, "object"),
        ({"pose_cloud": {}, "goal_metric_type": "position_only"}, "give one"),
        ({"timeout": "soon"}, "timeout"),
        ({"rseed": 1.5}, "whole"),
        ({"route_effort": 0}, "route_effort"),
        ({"orientation_tolerance_deg": 400}, "180"),
    ],
)
def test_invalid_input_is_refused_by_name(extra, says):
    with pytest.raises(ConfigError, match=says):
        PlannerOptions.of(extra)


def test_misspelt_options_and_those_without_effect_are_said_once_and_not_those_of_others(caplog):
    ignored = OptionWarnings(logging.getLogger("planner"))
    for _ in range(2):
        ignored.warn({"positon_tolerance_mm": 1, "timeout": 1, "interpolate": False, "tag": "x"})
        ignored.warn({"resolution": 2, "plan_tag": "x"})
    misspelt, without = (record.message for record in caplog.records)
    assert 'did you mean "position_tolerance_mm"' in misspelt
    assert without == 'planner option "resolution" has no effect on our planner'
