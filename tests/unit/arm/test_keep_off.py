"""What is around an arm beyond its own scene: its followings keep off it, also those under way."""

from dataclasses import replace

import numpy as np
import pytest
from harness.facing_arms import in_time

from so101_motion.common.errors import MotionError
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Attached, Box, Obstacle, Scene
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.simulated_rig import open_simulated

LEFT = np.radians([60.0, -45.0, 45.0, 60.0, 0.0])
RIGHT = np.array([-1.0, 1.0, 1.0, 1.0, 1.0]) * LEFT
CRATE = Obstacle(
    name="crate",
    shape=Box(size=(0.4, 0.04, 0.4)),
    T_base_obstacle=SE3.from_translation((0.3, 0.0, 0.2)),
)


@pytest.fixture
def arm(clock):
    """An arm to the left of where a crate may stand."""
    with open_simulated(clock=clock, q_start=LEFT) as rig:
        yield rig.arm


@pytest.fixture
def around(arm):
    """The arm's own scene with the crate."""
    return arm.scene.with_obstacles([CRATE])


COLLISION = CollisionModel(RobotModel.load(), Scene(obstacles=(CRATE,)))
OF_THE_CRATE = np.array([CRATE.name in pair for pair in COLLISION.pairs])


def clearance(arm):
    """How far the arm's reference is from the crate; less than 0 inside it [m]."""
    return COLLISION.distances(arm.state.q_ref, arm.state.q_jaw_ref)[OF_THE_CRATE].min()


def finish(clock, future):
    while not future.done():
        clock.advance(0.02)
    return future.result()


def lead(arm, clock, following, q, seconds=4.0):
    """Lead the arm towards ``q``; how near it comes to the crate meanwhile [m]."""
    nearest = np.inf
    for _ in range(round(100 * seconds)):
        following.aim(q)
        clock.advance(0.01)
        nearest = min(nearest, clearance(arm))
    return nearest


def test_a_retarget_stops_short_of_it_and_names_it_until_it_is_gone(arm, around, clock):
    arm.keep_off(arm.scene, around)
    motion = arm.retarget(RIGHT)
    with pytest.raises(MotionError, match="close to 'crate'"):
        finish(clock, motion.future)
    assert arm.state.q[0] > 0.1
    arm.keep_off(arm.scene, arm.scene)
    finish(clock, arm.retarget(RIGHT).future)
    assert arm.state.q == pytest.approx(RIGHT, abs=1e-3)


def test_a_following_under_way_keeps_off_what_comes_and_passes_where_it_was(arm, around, clock):
    following = in_time(clock, arm.follow)
    lead(arm, clock, following, LEFT, seconds=0.2)
    arm.keep_off(arm.scene, around)
    assert lead(arm, clock, following, RIGHT) > 0.0
    assert any("'crate'" in each for each in following.held_by)
    arm.keep_off(arm.scene, arm.scene)
    lead(arm, clock, following, RIGHT, seconds=6.0)
    assert arm.state.q == pytest.approx(RIGHT, abs=1e-2)
    finish(clock, following.close())


def test_an_arm_that_is_in_it_follows_targets_out_and_no_deeper(arm, around, clock):
    """The crate comes to where the arm is."""
    inside = np.array([0.1, 1.0, 1.0, 1.0, 1.0]) * LEFT
    finish(clock, arm.retarget(inside).future)
    following = in_time(clock, arm.follow)
    lead(arm, clock, following, inside, seconds=0.2)
    arm.keep_off(arm.scene, around)
    before = clearance(arm)
    assert before < 0.0
    assert lead(arm, clock, following, -inside, seconds=2.0) > before - 1e-3, "no deeper"
    lead(arm, clock, following, LEFT)
    assert clearance(arm) > 0.0
    assert arm.state.q == pytest.approx(LEFT, abs=1e-2)
    finish(clock, following.close())


def test_a_retarget_leads_out_of_it_too(arm, around, clock):
    inside = np.array([0.1, 1.0, 1.0, 1.0, 1.0]) * LEFT
    finish(clock, arm.retarget(inside).future)
    arm.keep_off(arm.scene, around)
    finish(clock, arm.retarget(LEFT).future)
    assert arm.state.q == pytest.approx(LEFT, abs=1e-3)


def test_beside_another_scene_of_the_arm_it_does_not_count(arm, around, clock):
    arm.keep_off(Scene(floor_z=-0.1), around)
    finish(clock, arm.retarget(RIGHT).future)


def test_a_jog_keeps_off_it(arm, around, clock):
    arm.keep_off(arm.scene, around)
    jog = in_time(clock, arm.jog)
    beyond = arm.model.frame(RIGHT).p
    for _ in range(500):
        jog.to_point(beyond)
        clock.advance(0.01)
        assert clearance(arm) > 0.0
    assert clearance(arm) < 0.02, "it came there"
    finish(clock, jog.close())


def test_a_jog_under_way_keeps_off_what_comes_and_passes_where_it_was(arm, around, clock):
    jog = in_time(clock, arm.jog)
    beyond = arm.model.frame(RIGHT).p

    def jogged(seconds):
        nearest = np.inf
        for _ in range(round(100 * seconds)):
            jog.to_point(beyond)
            clock.advance(0.01)
            nearest = min(nearest, clearance(arm))
        return nearest

    jogged(0.3)
    arm.keep_off(arm.scene, around)
    assert 0.0 < jogged(4.0) < 0.02
    assert any("'crate'" in each for each in jog.held_by)
    arm.keep_off(arm.scene, arm.scene)
    jogged(6.0)
    assert arm.T_base("tool").p == pytest.approx(beyond, abs=2e-3)
    finish(clock, jog.close())


def test_a_jog_that_something_comes_over_goes_out_of_it(arm, around, clock):
    inside = np.array([0.1, 1.0, 1.0, 1.0, 1.0]) * LEFT
    finish(clock, arm.retarget(inside).future)
    jog = in_time(clock, arm.jog)
    arm.keep_off(arm.scene, around)
    before = clearance(arm)
    for _ in range(600):
        jog.to_point(arm.model.frame(LEFT).p)
        clock.advance(0.01)
        assert clearance(arm) > before - 1e-3
    assert clearance(arm) > 0.0
    finish(clock, jog.close())


def test_what_is_held_longer_counts_for_a_jog_under_way(arm, around, clock):
    jog = in_time(clock, arm.jog)
    far = SE3.from_translation((0.0, 0.0, 0.3))
    pole = Attached(name="pole", shape=Box(size=(0.01, 0.01, 0.4)), T_tool_object=far)
    arm.keep_off(arm.scene, replace(around, attached=(pole,)))
    for _ in range(300):
        jog.to_point(arm.model.frame(RIGHT).p)
        clock.advance(0.01)
    assert any("'pole'" in each for each in jog.held_by)
    finish(clock, jog.close())


def test_plans_do_not_know_it(arm, around):
    arm.keep_off(arm.scene, around)
    assert arm.plan(JointGoal(q=RIGHT)).report.straight


def test_what_is_held_longer_counts_from_the_next_following_on(arm, around, clock):
    """The one under way may not look often enough at something that moves so far."""
    following = in_time(clock, arm.follow)
    before = following.guard
    far = SE3.from_translation((0.0, 0.0, 0.3))
    pole = Attached(name="pole", shape=Box(size=(0.01, 0.01, 0.4)), T_tool_object=far)
    arm.keep_off(arm.scene, replace(around, attached=(pole,)))
    assert following.guard is before
    newer = in_time(clock, arm.follow)
    assert newer.guard is not before
    finish(clock, newer.close())


def test_an_arm_says_what_it_touches_where_it_was_measured(arm, around, clock):
    inside = np.array([0.1, 1.0, 1.0, 1.0, 1.0]) * LEFT
    finish(clock, arm.retarget(inside).future)
    assert arm.touching() == ""
    arm.keep_off(arm.scene, around)
    assert arm.touching().endswith(" close to 'crate'")
    finish(clock, arm.retarget(LEFT).future)
    assert arm.touching() == ""
