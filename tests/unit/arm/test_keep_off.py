"""What is around an arm beyond its own scene: its followings keep off it, also those under way."""

from dataclasses import replace

import numpy as np
import pytest
from harness.facing_arms import in_time
from harness.random_scenes import obstacle

from so101_motion.common.errors import MotionError
from so101_motion.common.geometry import SE3
from so101_motion.control.streamed_trajectory import TimedPoint
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Attached, Box, Scene
from so101_motion.planning.differential.guard import INEXACT
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.simulated_rig import open_simulated

LEFT = np.radians([60.0, -45.0, 45.0, 60.0, 0.0])
RIGHT = np.array([-1.0, 1.0, 1.0, 1.0, 1.0]) * LEFT
INSIDE = np.array([0.1, 1.0, 1.0, 1.0, 1.0]) * LEFT  # where the crate would be
BEYOND = RobotModel.load().frame(RIGHT).p
CRATE = obstacle("crate", (0.4, 0.04, 0.4), (0.3, 0.0, 0.2))


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


POLE = Attached(
    name="pole",
    shape=Box(size=(0.01, 0.01, 0.4)),
    T_tool_object=SE3.from_translation((0.0, 0.0, 0.3)),
)


def finish(clock, future):
    while not future.done():
        clock.advance(0.02)
    return future.result()


def lead(arm, clock, aim, to, seconds=4.0):
    """Lead the arm towards ``to``; how near it comes to the crate meanwhile [m]."""
    nearest = np.inf
    for _ in range(round(100 * seconds)):
        aim(to)
        clock.advance(0.01)
        nearest = min(nearest, clearance(arm))
    return nearest


@pytest.fixture
def arm_inside(arm, clock):
    """An arm where the crate would be."""
    finish(clock, arm.retarget(INSIDE).future)
    return arm


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
    lead(arm, clock, following.aim, LEFT, seconds=0.2)
    arm.keep_off(arm.scene, around)
    assert lead(arm, clock, following.aim, RIGHT) > 0.0
    assert any("'crate'" in each for each in following.held_by)
    arm.keep_off(arm.scene, arm.scene)
    lead(arm, clock, following.aim, RIGHT, seconds=6.0)
    assert arm.state.q == pytest.approx(RIGHT, abs=1e-2)
    finish(clock, following.close())


def test_an_arm_that_is_in_it_follows_targets_out_and_no_deeper(arm_inside, around, clock):
    """The crate comes to where the arm is."""
    arm, following = arm_inside, in_time(clock, arm_inside.follow)
    lead(arm, clock, following.aim, INSIDE, seconds=0.2)
    arm.keep_off(arm.scene, around)
    before = clearance(arm)
    assert before < 0.0
    assert lead(arm, clock, following.aim, -INSIDE, seconds=2.0) > before - 1e-3, "no deeper"
    lead(arm, clock, following.aim, LEFT)
    assert clearance(arm) > 0.0
    assert arm.state.q == pytest.approx(LEFT, abs=1e-2)
    finish(clock, following.close())


def test_a_retarget_leads_out_of_it_and_the_arm_says_what_it_touches(arm_inside, around, clock):
    arm = arm_inside
    assert arm.touching() == ""
    arm.keep_off(arm.scene, around)
    assert arm.touching().endswith(" close to 'crate'")
    finish(clock, arm.retarget(LEFT).future)
    assert arm.touching() == ""
    assert arm.state.q == pytest.approx(LEFT, abs=1e-3)


def test_beside_another_scene_of_the_arm_it_does_not_count(arm, around, clock):
    arm.keep_off(Scene(floor_z=-0.1), around)
    finish(clock, arm.retarget(RIGHT).future)


def test_a_jog_keeps_off_it(arm, around, clock):
    arm.keep_off(arm.scene, around)
    jog = in_time(clock, arm.jog)
    assert lead(arm, clock, jog.to_point, BEYOND, seconds=5.0) > 0.0
    assert clearance(arm) < 0.02, "it came there"
    finish(clock, jog.close())


def test_a_jog_under_way_keeps_off_what_comes_and_passes_where_it_was(arm, around, clock):
    jog = in_time(clock, arm.jog)
    lead(arm, clock, jog.to_point, BEYOND, seconds=0.3)
    arm.keep_off(arm.scene, around)
    assert 0.0 < lead(arm, clock, jog.to_point, BEYOND) < 0.02
    assert any("'crate'" in each for each in jog.held_by)
    arm.keep_off(arm.scene, arm.scene)
    lead(arm, clock, jog.to_point, BEYOND, seconds=6.0)
    assert arm.T_base("tool").p == pytest.approx(BEYOND, abs=2e-3)
    finish(clock, jog.close())


def test_a_jog_that_something_comes_over_goes_out_of_it(arm_inside, around, clock):
    arm, jog = arm_inside, in_time(clock, arm_inside.jog)
    arm.keep_off(arm.scene, around)
    before = clearance(arm)
    assert lead(arm, clock, jog.to_point, arm.model.frame(LEFT).p, seconds=6.0) > before - 1e-3
    assert clearance(arm) > 0.0
    finish(clock, jog.close())


def test_what_is_held_longer_counts_for_a_jog_under_way(arm, around, clock):
    jog = in_time(clock, arm.jog)
    arm.keep_off(arm.scene, replace(around, attached=(POLE,)))
    lead(arm, clock, jog.to_point, BEYOND, seconds=3.0)
    assert any("'pole'" in each for each in jog.held_by)
    finish(clock, jog.close())


def test_plans_do_not_know_it(arm, around):
    arm.keep_off(arm.scene, around)
    assert arm.plan(JointGoal(q=RIGHT)).report.straight


def test_what_is_held_longer_counts_from_the_next_following_on(arm, around, clock):
    """The one under way may not look often enough at something that moves so far."""
    following = in_time(clock, arm.follow)
    before = following.guard
    arm.keep_off(arm.scene, replace(around, attached=(POLE,)))
    assert following.guard is before
    newer = in_time(clock, arm.follow)
    assert newer.guard is not before
    finish(clock, newer.close())


# Streamed points that lead into contact: the arm stops before it and says what is in the way


@pytest.fixture
def swift(clock):
    """The same arm at the speeds of others' streams."""
    with open_simulated(
        clock=clock, q_start=LEFT, speed=np.radians(150.0), acceleration=np.radians(500.0)
    ) as rig:
        yield rig.arm


def swing(begin, end, seconds, period=0.02):
    """Points from rest to rest."""
    u = np.linspace(0.0, 1.0, round(seconds / period) + 1)
    q = begin + (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5)[:, None] * (end - begin)
    return [TimedPoint(t=period * k, q=each) for k, each in enumerate(q)]


class Played:
    """A stream that was played to its end.

    Attributes:
        q: The setpoints.
        nearest: How near they came to the crate [m].
        error: Why it ended early.
    """

    def __init__(self, swift, clock, points, *, ahead=2.0):
        self.stream, self.nearest = in_time(clock, swift.stream), np.inf
        self.q, t, sent = [], 0.0, 0
        while not self.stream.future.done():
            while sent < len(points) and points[sent].t < t + ahead:
                try:
                    self.stream.push([points[sent]])
                except MotionError:
                    break
                sent += 1
                if sent == len(points):
                    self.stream.finish()
            clock.advance(0.01)
            t += 0.01
            self.q.append(swift.state.q_ref)
            self.nearest = min(self.nearest, clearance(swift))
        self.error = self.stream.future.exception()


@pytest.mark.parametrize(("seconds", "ahead"), [(8.0, 2.0), (2.0, 2.0), (2.0, 0.3)])
def test_it_stops_before_contact_within_its_limits_and_names_what_is_there(
    swift, clock, seconds, ahead
):
    swift.scene = swift.scene.with_obstacles([CRATE])
    played = Played(swift, clock, swing(LEFT, RIGHT, seconds), ahead=ahead)
    assert isinstance(played.error, MotionError)
    assert "into contact with 'crate'; move that away" in str(played.error)
    assert 0.003 < played.nearest < 0.05
    dt = 0.01
    for order, most in ((2, np.radians(600.0)), (3, 200.0)):
        assert np.abs(np.diff(played.q, order, axis=0)).max() / dt**order < 1.05 * most


def test_a_fast_one_stops_farther_away_because_servos_swing_past_a_stop(swift, clock):
    far = np.radians([105.0, -45.0, 45.0, 60.0, 0.0])
    to_far = swing(LEFT, far, 3.0)
    assert Played(swift, clock, to_far).error is None
    swift.scene = swift.scene.with_obstacles([CRATE])
    played = Played(swift, clock, swing(far, RIGHT, 2.5))
    assert "'crate'" in str(played.error)
    assert np.abs(np.diff(played.q, axis=0)).max() > 0.01 * np.radians(60.0)
    assert INEXACT < played.nearest < 0.05


NEAR = 0.002


@pytest.mark.parametrize("seconds", [2.5, 6.0])
def test_it_goes_by_nearer_than_our_own_plans_would(swift, clock, seconds):
    """Somebody else may have planned it, so that it bends away just before a wall."""
    u = np.linspace(0.0, 1.0, round(seconds / 0.02) + 1)
    share = 10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5
    q = np.outer(1.0 - 2.0 * share, LEFT * [1, 0, 0, 0, 0]) + LEFT * [0, 1, 1, 1, 1]
    q[:, 1] += np.radians(30.0) * np.sin(np.pi * share) ** 2
    points = [TimedPoint(t=0.02 * k, q=each) for k, each in enumerate(q)]
    played = Played(swift, clock, points)  # as it is smoothed, nothing is there yet
    assert played.error is None
    assert Played(swift, clock, swing(RIGHT, LEFT, 3.0)).error is None

    def wall(x):
        return replace(CRATE, T_base_obstacle=SE3.from_translation((x + 0.2, 0.0, 0.2)))

    def room(x):
        model = CollisionModel(RobotModel.load(), Scene(obstacles=(wall(x),)))
        of_the_wall = np.array([CRATE.name in pair for pair in model.pairs])
        return min(model.distances(each)[of_the_wall].min() for each in played.q[::2])

    x = 0.5
    for _ in range(6):
        x -= room(x) - NEAR
    assert room(x) == pytest.approx(NEAR, abs=3e-4)
    swift.scene = swift.scene.with_obstacles([wall(x)])
    assert Played(swift, clock, points).error is None
    swift.scene = replace(swift.scene, obstacles=())
    assert Played(swift, clock, swing(RIGHT, LEFT, 3.0)).error is None
    swift.scene = replace(swift.scene, obstacles=(wall(x - 0.006),))
    assert "'crate'" in str(Played(swift, clock, points).error)


def test_an_arm_in_contact_is_streamed_out_but_no_deeper(swift, clock):
    assert Played(swift, clock, swing(LEFT, INSIDE, 3.0)).error is None
    swift.keep_off(swift.scene, swift.scene.with_obstacles([CRATE]))
    before = clearance(swift)
    assert before < 0.0
    deeper = Played(swift, clock, swing(INSIDE, -INSIDE, 3.0))
    assert "'crate'" in str(deeper.error)
    assert deeper.nearest > before - 1e-3
    assert Played(swift, clock, swing(swift.state.q_ref, LEFT, 3.0)).error is None


def test_what_comes_while_it_is_played_stops_it(swift, clock):
    stream = in_time(clock, swift.stream)
    stream.push(swing(LEFT, RIGHT, 8.0))
    for _ in range(100):
        clock.advance(0.01)
    swift.keep_off(swift.scene, swift.scene.with_obstacles([CRATE]))
    with pytest.raises(MotionError, match="'crate'"):
        finish(clock, stream.future)
    assert clearance(swift) > 0.003


def test_an_unguarded_stream_is_not_stopped(swift, clock):
    swift.scene = swift.scene.with_obstacles([CRATE])
    stream = in_time(clock, lambda: swift.start_stream(guard=None).opened.result())
    stream.push(swing(LEFT, RIGHT, 4.0))
    stream.finish()
    finish(clock, stream.future)
    assert swift.state.q == pytest.approx(RIGHT, abs=1e-3)
