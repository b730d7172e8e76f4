"""Plans of a handover between two arms: fifty random poses, checked by other means."""

from dataclasses import replace

import numpy as np
import pytest
from harness.facing_arms import T_LEFT_RIGHT, Facing

from so101_motion.common.errors import ConfigError, NoPath
from so101_motion.common.geometry import SE3, rotation_angle, rotation_by
from so101_motion.planning.cell.grasps import grasps_of
from so101_motion.planning.cell.handover import JawGeometry, plan_handover
from so101_motion.planning.cell.team_requests import HandoverRequest, TeamMember
from so101_motion.planning.collision.apart import clearance_over_time
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.course import Course
from so101_motion.planning.collision.scene import Attached, Box, Scene, Sphere
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Strength

CAPS = MotionLimits.uniform(velocity=1.5, acceleration=6.0, jerk=60.0)
ASIDE = np.radians([60.0, -30.0, 30.0, 30.0, 0.0])


def stick_in_hand(random, jaw):
    """A stick that is held somehow."""
    sides = random.uniform((0.012, 0.012, 0.1), (0.03, 0.03, 0.18))
    stick = Box(size=sides)
    grasps = list(grasps_of(stick))
    held = grasps[random.integers(len(grasps))]
    off = SE3(rotation_by(random.uniform(-0.1, 0.1, 3)), random.uniform(-0.003, 0.003, 3))
    T_tool_object = jaw.T_tool_grip(held.thickness) @ off @ held.T_object_grip.inverse
    return Attached(name="stick", shape=stick, T_tool_object=T_tool_object, mass=0.05)


def request_for(thing, q_left=ASIDE, q_right=ASIDE):
    strength = Strength.of_servos(12.0)
    team = [
        TeamMember(
            name=name,
            T_cell_base=T,
            request=PlanRequest(
                q_start=q,
                goal=JointGoal(q=q),
                limits=CAPS,
                scene=Scene(attached=held),
                strength=strength,
            ),
        )
        for name, T, q, held in (
            ("left", SE3.identity(), q_left, (thing,)),
            ("right", T_LEFT_RIGHT, q_right, ()),
        )
    ]
    return HandoverRequest(team=tuple(team), giver="left", taker="right", thing=thing.name)


def clearance(left, right, held_left, held_right):
    """How near the arms come, what they hold included [m]."""
    pair = (bodies_of(held_left), left), (bodies_of(held_right), right)
    times = np.linspace(0.0, max(left.end, right.end), 12)
    return min(each.distance for each in clearance_over_time(*pair, T_LEFT_RIGHT, times))


@pytest.mark.parametrize("seed", range(5))
def test_ten_random_poses_of_a_stick_are_passed_on(planner, seed):
    """Fifty of them in all."""
    random, model = np.random.default_rng(seed), Facing(0).model
    jaw = JawGeometry(model)
    for _ in range(10):
        thing = stick_in_hand(random, jaw)
        plan = plan_handover(planner, request_for(thing))
        left, right = plan.approach["left"], plan.approach["right"]
        np.testing.assert_allclose(plan.take.q_start, right.q_goal, atol=1e-9)
        np.testing.assert_allclose(plan.leave.q_start, left.q_goal, atol=1e-9)
        # One thing: it is where it was, in either hand.
        before = model.frame(left.q_goal) @ thing.T_tool_object
        after = T_LEFT_RIGHT @ model.frame(plan.take.q_goal) @ plan.taken.T_tool_object
        np.testing.assert_allclose(after.p, before.p, atol=1e-9)
        assert rotation_angle(after.R.T @ before.R) < 1e-9
        # The arms keep apart all the time, and the thing off the taker until it goes for it.
        comes = Course.along(right.trajectory, plan.q_jaw_open)
        assert clearance(Course.along(left.trajectory, 0.0), comes, (thing,), ()) > 0.019
        rest = Course.resting(left.q_goal, plan.q_jaw_free)
        assert clearance(rest, Course.along(plan.take.trajectory, plan.q_jaw_open), (), ()) > 0.019
        rest = Course.resting(plan.take.q_goal, plan.q_jaw_closed)
        leave = Course.along(plan.leave.trajectory, plan.q_jaw_free)
        assert clearance(leave, rest, (), ()) > 0.019
        last = Course.resting(plan.leave.q_goal, plan.q_jaw_free)
        assert clearance(last, rest, (), (plan.taken,)) > 0.019


def test_an_impossible_handover_says_why(planner):
    at = SE3.from_translation((0.0, 0.0, 0.1))
    ball = Attached(name="ball", shape=Sphere(radius=0.015), T_tool_object=at)
    with pytest.raises(NoPath, match=r"'ball' is too small to be passed on: .*20 mm must stay"):
        plan_handover(planner, request_for(ball))
    crate = replace(ball, name="crate", shape=Box(size=[0.1, 0.1, 0.1]))
    with pytest.raises(NoPath, match="'crate' is too thick"):
        plan_handover(planner, request_for(crate))
    with pytest.raises(ConfigError, match="left, right"):
        plan_handover(planner, replace(request_for(ball), taker="middle"))
    with pytest.raises(ConfigError, match="which holds: ball"):
        plan_handover(planner, replace(request_for(ball), thing="stick"))
    with pytest.raises(ConfigError, match="itself"):
        plan_handover(planner, replace(request_for(ball), taker="left"))
