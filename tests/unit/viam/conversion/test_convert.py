import logging
import math
from dataclasses import replace

import numpy as np
import pytest
from google.protobuf.struct_pb2 import Struct
from grpclib import Status
from viam.proto.common import PoseCloud as ViamCloud
from viam.proto.component.arm import MoveOptions

from so101_motion.common.errors import ConfigError, InCollision, Interrupted, So101Error
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import MARGIN, Scene
from so101_motion.planning.goals import GoalMetric, PoseGoal
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.planner_options import (
    OptionWarnings,
    PlannerOptions,
    from_goal_cloud,
    to_goal_cloud,
)

BASE = MotionLimits.uniform(velocity=math.radians(90), acceleration=math.radians(100), jerk=20.0)


@pytest.mark.parametrize(
    ("sent", "velocity_deg", "acceleration_deg", "tool_speed"),
    [
        (dict(max_vel_degs_per_sec=0.0, max_acc_degs_per_sec2=0.0, max_tcp_speed=0.0),
         [90] * 5, [100] * 5, None),  # zeros count as not given
        (dict(max_vel_degs_per_sec=120.0, max_acc_degs_per_sec2=50.0, max_tcp_speed=0.25),
         [120] * 5, [50] * 5, 0.25),
        (dict(max_vel_degs_per_sec=1000.0, max_acc_degs_per_sec2=1e6),
         [180] * 5, [500] * 5, None),  # lowered to what can be set
        (dict(max_vel_degs_per_sec=120.0, max_vel_degs_per_sec_joints=[10, 20, 0, 0, 50]),
         [10, 20, 90, 90, 50], [100] * 5, None),  # the lists win
    ],
)  # fmt: skip
def test_a_given_cap_replaces_the_arms_own_for_the_move(
    sent, velocity_deg, acceleration_deg, tool_speed
):
    limits = convert.from_move_options(MoveOptions(**sent), BASE)

    assert np.degrees(limits.velocity) == pytest.approx(velocity_deg)
    assert np.degrees(limits.acceleration) == pytest.approx(acceleration_deg)
    assert limits.tool_speed == tool_speed
    assert limits.jerk == pytest.approx(20.0 * np.array(acceleration_deg) / 100.0)
    assert convert.from_move_options(None, BASE) is BASE
    capped = replace(BASE, tool_speed=0.1)
    assert convert.from_move_options(MoveOptions(**sent), capped).tool_speed == (tool_speed or 0.1)


@pytest.mark.parametrize("key", ["max_vel_degs_per_sec_joints", "max_acc_degs_per_sec2_joints"])
@pytest.mark.parametrize("count", [1, 4, 6])
def test_a_list_needs_one_entry_for_each_joint(key, count):
    with pytest.raises(ConfigError, match=f"{key}.* has {count} entries"):
        convert.from_move_options(MoveOptions(**{key: [1.0] * count}), BASE)


@pytest.mark.parametrize(
    "options",
    [
        {"max_vel_degs_per_sec": math.nan},
        {"max_acc_degs_per_sec2": math.inf},
        {"max_tcp_speed": math.nan},
        {"max_vel_degs_per_sec": 1e-6},
        {"max_tcp_speed": 1e-9},
        {"max_acc_degs_per_sec2_joints": [1, 2, 3, 4, math.nan]},
        {"max_vel_degs_per_sec": -10.0},
        {"max_acc_degs_per_sec2": -0.5},
        {"max_tcp_speed": -0.1},
        {"max_vel_degs_per_sec_joints": [10, 20, 30, -1, 50]},
        {"max_vel_degs_per_sec": math.nan, "max_vel_degs_per_sec_joints": [10, 20, 30, 40, 50]},
    ],
)
def test_a_cap_that_is_no_speed_is_refused_by_its_name(options):
    with pytest.raises(ConfigError, match=next(iter(options))):
        convert.from_move_options(MoveOptions(**options), BASE)


@pytest.mark.parametrize(
    ("extra", "metric"),
    [
        ({}, GoalMetric.POSITION_ONLY),
        ({"goal_metric_type": "position_only"}, GoalMetric.POSITION_ONLY),
        ({"goal_metric_type": "position_and_approach"}, GoalMetric.POSITION_AND_APPROACH),
        ({"goal_metric_type": "full_pose"}, GoalMetric.FULL_POSE),
        ({"goal_metric_type": "squared_norm"}, GoalMetric.FULL_POSE),
    ],
)
def test_the_goal_metric_is_position_only_unless_told_otherwise(extra, metric):
    assert convert.from_goal_metric(extra) is metric


def test_a_null_is_not_zero_and_what_is_absent_or_not_finite_never_leaves():
    struct = Struct()
    struct.update({"a": None, "b": 0.0, "c": [1.0, {"d": True}], "e": "x"})

    assert convert.from_struct(struct) == {"a": None, "b": 0.0, "c": [1.0, {"d": True}], "e": "x"}
    sent = convert.to_result(
        {
            "none": None,
            "nan": math.nan,
            "inf": [1.0, math.inf],
            "array": np.array([1.0, 2.0]),
            "inner": {"none": None, "ok": np.float64(3.0)},
            "text": "x",
            "flag": False,
        }
    )

    assert sent == {"array": [1.0, 2.0], "inner": {"ok": 3.0}, "text": "x", "flag": False}


def test_every_kind_of_error_has_a_status():
    kinds = {So101Error, *So101Error.__subclasses__()}
    assert {each for each in kinds if each.__module__.startswith("so101_motion.")} <= set(
        convert.STATUS
    )  # the page's own errors never come this way


@pytest.mark.parametrize(
    ("by", "status"),
    [
        ("stop", Status.CANCELLED),
        ("cancelled", Status.CANCELLED),
        ("a newer motion", Status.ABORTED),
        ("shutdown", Status.CANCELLED),
        ("the removal of its motion service", Status.CANCELLED),
    ],
)
def test_an_interrupted_motion_says_by_what(by, status):
    error = convert.grpc_error(Interrupted(by))

    assert error.status is status
    assert by in error.message


def test_an_arm_in_contact_is_told_the_command_that_backs_it_out():
    touch = InCollision("it touches", first="a", second="b", where="start", can_back_out=True)
    assert '"leave_contact"' in convert.grpc_error(touch).message


def test_an_error_leaves_as_one_sentence_with_its_cause():
    with pytest.raises(convert.GRPCError) as caught, convert.grpc_statuses():
        raise ConfigError("port", "x", "line one\nline two")

    assert caught.value.status is Status.INVALID_ARGUMENT
    assert "\n" not in caught.value.message
    assert isinstance(caught.value.__cause__, ConfigError)
    with pytest.raises(ZeroDivisionError), convert.grpc_statuses():
        raise ZeroDivisionError  # a mistake of the program is not dressed up


GOAL = PoseGoal(T_base_tool=SE3.identity())


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
    undercut = PlannerOptions.of({"collision_buffer_mm": 1e-8}).search(Scene())
    assert (undercut.scene.margin, undercut.seed) == (MARGIN, 0)
    assert PlannerOptions.of({}).goal(GOAL).metric is GoalMetric.POSITION_ONLY


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
        *(
            ({"goal_metric_type": value}, "goal_metric_type.*position_only")
            for value in ("Position_Only", "", 3.0)
        ),
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
