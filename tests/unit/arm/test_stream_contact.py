"""Streamed points that lead into contact: the arm stops before it and says what is in the way."""

from dataclasses import replace

import numpy as np
import pytest
from harness.facing_arms import in_time

from so101_motion.common.errors import MotionError
from so101_motion.common.geometry import SE3
from so101_motion.control.streamed_trajectory import TimedPoint
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.planning.differential.guard import INEXACT
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.simulated_rig import open_simulated

LEFT = np.radians([60.0, -45.0, 45.0, 60.0, 0.0])
RIGHT = np.array([-1.0, 1.0, 1.0, 1.0, 1.0]) * LEFT
CRATE = Obstacle(
    name="crate",
    shape=Box(size=(0.4, 0.04, 0.4)),
    T_base_obstacle=SE3.from_translation((0.3, 0.0, 0.2)),
)
COLLISION = CollisionModel(RobotModel.load(), Scene(obstacles=(CRATE,)))
OF_THE_CRATE = np.array([CRATE.name in pair for pair in COLLISION.pairs])


@pytest.fixture
def arm(clock):
    """An arm to the left of where a crate may stand."""
    with open_simulated(
        clock=clock, q_start=LEFT, speed=np.radians(150.0), acceleration=np.radians(500.0)
    ) as rig:
        yield rig.arm


def clearance(arm):
    """How far the arm's reference is from the crate; less than 0 inside it [m]."""
    return COLLISION.distances(arm.state.q_ref, arm.state.q_jaw_ref)[OF_THE_CRATE].min()


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

    def __init__(self, arm, clock, points, *, ahead=2.0):
        self.stream, self.nearest = in_time(clock, arm.stream), np.inf
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
            self.q.append(arm.state.q_ref)
            self.nearest = min(self.nearest, clearance(arm))
        self.error = self.stream.future.exception()


@pytest.mark.parametrize(("seconds", "ahead"), [(8.0, 2.0), (2.0, 2.0), (2.0, 0.3)])
def test_it_stops_before_contact_within_its_limits_and_names_what_is_there(
    arm, clock, seconds, ahead
):
    arm.scene = arm.scene.with_obstacles([CRATE])
    played = Played(arm, clock, swing(LEFT, RIGHT, seconds), ahead=ahead)
    assert isinstance(played.error, MotionError)
    assert "into contact with 'crate'; move that away" in str(played.error)
    assert 0.003 < played.nearest < 0.05
    dt = 0.01
    for order, most in ((2, np.radians(600.0)), (3, 200.0)):
        assert np.abs(np.diff(played.q, order, axis=0)).max() / dt**order < 1.05 * most


def test_a_fast_one_stops_farther_away_because_servos_swing_past_a_stop(arm, clock):
    far = np.radians([105.0, -45.0, 45.0, 60.0, 0.0])
    to_far = swing(LEFT, far, 3.0)
    assert Played(arm, clock, to_far).error is None
    arm.scene = arm.scene.with_obstacles([CRATE])
    played = Played(arm, clock, swing(far, RIGHT, 2.5))
    assert "'crate'" in str(played.error)
    assert np.abs(np.diff(played.q, axis=0)).max() > 0.01 * np.radians(60.0)
    assert INEXACT < played.nearest < 0.05


NEAR = 0.002


@pytest.mark.parametrize("seconds", [2.5, 6.0])
def test_it_goes_by_nearer_than_our_own_plans_would(arm, clock, seconds):
    """Somebody else may have planned it, so that it bends away just before a wall."""
    u = np.linspace(0.0, 1.0, round(seconds / 0.02) + 1)
    share = 10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5
    q = np.outer(1.0 - 2.0 * share, LEFT * [1, 0, 0, 0, 0]) + LEFT * [0, 1, 1, 1, 1]
    q[:, 1] += np.radians(30.0) * np.sin(np.pi * share) ** 2
    points = [TimedPoint(t=0.02 * k, q=each) for k, each in enumerate(q)]
    played = Played(arm, clock, points)  # as it is smoothed, nothing is there yet
    assert played.error is None
    assert Played(arm, clock, swing(RIGHT, LEFT, 3.0)).error is None

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
    arm.scene = arm.scene.with_obstacles([wall(x)])
    assert Played(arm, clock, points).error is None
    arm.scene = replace(arm.scene, obstacles=())
    assert Played(arm, clock, swing(RIGHT, LEFT, 3.0)).error is None
    arm.scene = replace(arm.scene, obstacles=(wall(x - 0.006),))
    assert "'crate'" in str(Played(arm, clock, points).error)


def test_an_arm_in_contact_is_streamed_out_but_no_deeper(arm, clock):
    inside = np.array([0.1, 1.0, 1.0, 1.0, 1.0]) * LEFT
    assert Played(arm, clock, swing(LEFT, inside, 3.0)).error is None
    arm.keep_off(arm.scene, arm.scene.with_obstacles([CRATE]))
    before = clearance(arm)
    assert before < 0.0
    deeper = Played(arm, clock, swing(inside, -inside, 3.0))
    assert "'crate'" in str(deeper.error)
    assert deeper.nearest > before - 1e-3
    assert Played(arm, clock, swing(arm.state.q_ref, LEFT, 3.0)).error is None


def test_what_comes_while_it_is_played_stops_it(arm, clock):
    stream = in_time(clock, arm.stream)
    stream.push(swing(LEFT, RIGHT, 8.0))
    for _ in range(100):
        clock.advance(0.01)
    arm.keep_off(arm.scene, arm.scene.with_obstacles([CRATE]))
    while not stream.future.done():
        clock.advance(0.01)
    with pytest.raises(MotionError, match="'crate'"):
        stream.future.result()
    assert clearance(arm) > 0.003


def test_an_unguarded_stream_is_not_stopped(arm, clock):
    arm.scene = arm.scene.with_obstacles([CRATE])
    stream = in_time(clock, lambda: arm.start_stream(guard=None).opened.result())
    stream.push(swing(LEFT, RIGHT, 4.0))
    stream.finish()
    while not stream.future.done():
        clock.advance(0.01)
    stream.future.result()
    assert arm.state.q == pytest.approx(RIGHT, abs=1e-3)
