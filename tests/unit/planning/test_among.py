"""Plans among other moving arms: they go around or wait, and never through."""

from dataclasses import replace

import numpy as np
import pytest
from harness.coal_check import CoalJudge
from harness.facing_arms import T_LEFT_RIGHT, Facing

from so101_motion.common.errors import InCollision
from so101_motion.planning.collision.apart import (
    PARTING,
    ROOM,
    first_meeting,
    nearness,
)
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.course import Course, OtherArm
from so101_motion.planning.collision.scene import Scene, StandingArm
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

CAPS = MotionLimits.uniform(velocity=1.5, acceleration=6.0, jerk=60.0)


def request(q_start, q_goal, *others, **more):
    goal = JointGoal(q=q_goal)
    return PlanRequest(q_start=q_start, goal=goal, limits=CAPS, others=others, **more)


def right(course):
    return OtherArm(name="right", T_base_other=T_LEFT_RIGHT, course=course)


def left(course):
    return OtherArm(name="left", T_base_other=T_LEFT_RIGHT.inverse, course=course)


def test_a_plan_keeps_off_an_arm_that_moves_and_the_earlier_of_two_paths_is_taken(planner):
    facing = Facing(11)
    waited = 0
    for _ in range(5):
        starts, goals = facing.task()
        first = planner.plan(request(starts[0], goals[0], right(Course.resting(starts[1], 0.0))))
        course = Course.along(first.trajectory, 0.0)
        second = planner.plan(request(starts[1], goals[1], left(course)))
        pair = (facing.bodies, course), (facing.bodies, Course.along(second.trajectory, 0.0))
        assert first_meeting(*pair, T_LEFT_RIGHT, since=0.0, room=0.99 * ROOM) is None
        np.testing.assert_array_equal(second.trajectory.q[-1], goals[1])
        report = second.report
        if report.waits:
            still = round(report.waits / second.trajectory.dt)
            assert np.all(second.trajectory.q[: still + 1] == starts[1])
            assert report.waits_for == ("left",)
            assert report.waits <= first.duration + 0.1
            assert report.for_others == f"waits {report.waits:.2f} s for left"
            waited += 1
            report = replace(report, waits=0.0)
            assert report.for_others == "goes around left"
        elif not report.waits_for:
            assert report.for_others == ""
    assert waited


def test_a_goal_where_another_arm_will_rest_is_refused_by_its_name(planner):
    facing = Facing(12)
    while True:
        q_left, q_right, q_goal = facing.near(), facing.near(), facing.near()
        if facing.are_apart(q_left, q_right) and not facing.are_apart(q_goal, q_right, room=0.005):
            break
    with pytest.raises(InCollision) as caught:
        planner.plan(request(q_left, q_goal, right(Course.resting(q_right, 0.0))))
    assert caught.value.second.startswith("right's ")
    assert f"from {caught.value.second}" in str(caught.value) or "into right's" in str(caught.value)


def test_an_arm_too_near_to_a_moving_one_leaves_and_never_comes_nearer(planner):
    facing = Facing(14)
    for _ in range(2):
        while True:
            (q_left, q_right), goals = (facing.near(), facing.near()), facing.task()[1]
            is_near = not facing.are_apart(q_left, q_right, 0.018)
            can_go = facing.are_apart(q_left, goals[1], 0.03)
            if is_near and can_go and facing.are_apart(q_left, q_right, 0.008):
                break
        away = planner.plan(request(q_right, goals[1], left(Course.resting(q_left, 0.0))))
        course = Course.along(away.trajectory, 0.0)
        plan = planner.plan(request(q_left, goals[0], right(course)))
        own = Course.along(plan.trajectory, 0.0)
        pair = (facing.bodies, own), (facing.bodies, course)
        gaps = [
            nearness(*pair, T_LEFT_RIGHT, at=t, room=ROOM) or ROOM
            for t in np.arange(0.0, max(own.end, course.end) + 0.02, 0.02)
        ]
        assert min(gaps) > gaps[0] - 2.0 * PARTING
        assert gaps[-1] == ROOM
        assert min(gaps[gaps.index(ROOM) + 15 :]) > 0.75 * ROOM


def test_an_arm_that_stands_blocks_like_its_bodies_do(planner):
    facing = Facing(13)
    verdicts = set()
    for _ in range(30):
        q_left, q_right = facing.near(), facing.near()
        arm = StandingArm(name="right", T_base_arm=T_LEFT_RIGHT, q=[[*q_right, 0.0]], room=ROOM)
        scene = Scene(arms=(arm,))
        free = CollisionModel(facing.model, scene).is_free(q_left)
        by_coal = CoalJudge(facing.model, scene).is_free(q_left)
        assert free == by_coal
        if facing.are_apart(q_left, q_right, room=ROOM + 0.0031):
            assert free
        if not facing.are_apart(q_left, q_right, room=ROOM + 0.0029):
            assert not free
        verdicts.add(free)
    assert verdicts == {True, False}


def test_scenes_with_other_arms_are_told_apart():
    arm = StandingArm(name="right", T_base_arm=T_LEFT_RIGHT, q=np.zeros((1, 6)))
    scene = Scene(arms=(arm,))
    assert scene == Scene(arms=(replace(arm),))
    assert scene != Scene()
    assert scene != Scene(arms=(replace(arm, room=0.01),))
    assert scene.called("right's gripper") == "right's gripper"
