"""Arms of one cell keep apart that follow targets or are jogged: simulated, a simulated clock."""

from functools import partial

import numpy as np
import pytest
from harness.facing_arms import FAST, Facing, crossing_task, in_time

from so101_motion.common.errors import MotionError
from so101_motion.control.streamed_trajectory import TimedPoint
from so101_motion.planning.collision.apart import GUARDED, PARTING, ROOM
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.motion_builder import DEPARTURE_SPEED
from so101_motion.planning.timing import online

pytestmark = pytest.mark.usefixtures("planning_process")


def test_followings_with_targets_in_each_other_hold_and_go_on_when_they_can(pair_of, clock):
    facing = Facing(24)
    starts, goals = crossing_task(facing)
    pair = pair_of(facing, *starts)
    followings = [
        in_time(clock, partial(arm.follow, limits=FAST, stale_after=None))
        for arm in (pair.left, pair.right)
    ]
    held = set()
    for k in range(300):
        for following, q, other in zip(followings, goals, (starts[0], starts[1]), strict=True):
            following.aim(q if k < 150 else other)
            held.update(following.held_by)
        pair.advance()
    assert any("left's" in each or "right's" in each for each in held)
    for following in followings:
        following.close()
    pair.finish(*followings)


@pytest.fixture
def pair_in_the_way(pair_of):
    """The right arm reaches to the middle; the left one is turned aside."""
    left, right = np.radians([[80.0, -45.0, 45.0, 60.0, 0.0], [0.0, -70.0, 60.0, 60.0, 0.0]])
    return pair_of(Facing(0), left, right)


def test_a_jog_towards_another_arm_slows_down_before_it_and_slides_along_it_at_a_slant(
    pair_in_the_way, clock
):
    pair = pair_in_the_way
    jog = in_time(clock, pair.left.jog)
    begin, nearest = pair.left.T_base("tool").p, np.inf
    for _ in range(400):
        jog.twist((0.04, 0.03, 0.0))
        pair.advance()
        nearest = min(nearest, pair.gap())
    assert pair.left.T_base("tool").p[0] > begin[0] + 0.02, "as far as there is room"
    assert np.abs(pair.left.state.qd_ref).max() < 0.01
    assert any("right's" in each for each in jog.held_by)
    along, begin = np.array([0.0275, -0.0119, 0.0]), pair.left.T_base("tool").p  # into it by 10 deg
    for _ in range(150):
        jog.twist(along)
        pair.advance()
        nearest = min(nearest, pair.gap())
    assert (pair.left.T_base("tool").p - begin) @ along / np.linalg.norm(along) > 0.01
    assert 1.1 * GUARDED < nearest < 1.3 * GUARDED


def test_an_arm_with_a_following_that_has_no_target_yet_is_seen_where_it_stands(pair_of, clock):
    before, there = np.radians([[100.0, -90.0, 80.0, 60.0, 0.0], [0.0, -70.0, 60.0, 60.0, 0.0]])
    beside, beyond = np.radians([[80.0, -45.0, 45.0, 60.0, 0.0], [0.0, -60.0, 50.0, 60.0, 0.0]])
    pair = pair_of(Facing(0), before, beside)
    (left, right), arm = pair.rigs, pair.left
    further = before + np.array([0.05, 0.0, 0.0, 0.0, 0.0])
    move = online.point_to_point(before, further, arm.limits, 0.01)
    in_time(clock, lambda: left.executor.execute(move).result())
    in_time(clock, partial(arm.set_torque, False))
    in_time(clock, left.executor.call(lambda driver: driver.push(there)).result)
    in_time(clock, partial(arm.set_torque, True))
    in_time(clock, arm.follow)

    crossing = online.point_to_point(beside, beyond, pair.right.limits, 0.01)
    moving = right.executor.execute(crossing)
    for _ in range(400):
        pair.advance()
    with pytest.raises(MotionError, match="stopped with the wrist close to left's"):
        moving.result(timeout=0)


def test_two_jogs_towards_each_other_hold_and_part_again(pair_of, clock):
    starts = np.radians([[55.0, -60.0, 60.0, 45.0, 0.0], [-55.0, -60.0, 60.0, 45.0, 0.0]])
    pair = pair_of(Facing(0), *starts)
    jogs = [in_time(clock, arm.jog) for arm in (pair.left, pair.right)]
    held, nearest = set(), np.inf
    for k in range(500):
        for jog in jogs:  # first each towards the other's base
            jog.twist((0.05 if k < 250 else -0.05, 0.0, 0.0))
            held.update(jog.held_by)
        pair.clock.advance(0.01)
        nearest = min(nearest, pair.gap())
    assert any("left's" in each for each in held)
    assert any("right's" in each for each in held)
    assert 0.99 * GUARDED < nearest < 1.5 * GUARDED
    assert pair.gap() > 2.0 * GUARDED


def test_a_stream_into_another_arm_ends_before_it(pair_in_the_way, clock):
    pair = pair_in_the_way
    stream = in_time(clock, pair.left.stream)
    q, share = pair.left.state.q_ref, np.linspace(0.0, 1.0, 301)
    turn = np.radians(-80.0) * (10.0 * share**3 - 15.0 * share**4 + 6.0 * share**5)
    stream.push(
        [
            TimedPoint(t=0.02 * k, q=q + np.array([each, 0.0, 0.0, 0.0, 0.0]))
            for k, each in enumerate(turn)
        ]
    )
    pair.finish(stream)
    with pytest.raises(MotionError, match="right's"):
        stream.future.result()


@pytest.fixture
def pair_up_close(pair_of, clock):
    """The left arm followed a target up to the right one, and braked into what must stay free."""
    starts = np.radians([[-50.0, -30.0, 40.0, 30.0, 0.0], [80.0, -60.0, 60.0, 40.0, 0.0]])
    pair = pair_of(Facing(0), *starts)
    approach = in_time(clock, partial(pair.left.follow, guard=None, limits=FAST, gate=9.0))
    for _ in range(60):
        approach.aim(np.radians([0.0, 10.0, 0.0, 0.0, 0.0]))
        pair.clock.advance(0.01)
    assert any("right's" in each for each in approach.held_by)
    assert 0.7 * GUARDED < pair.gap() < GUARDED
    pair.following = in_time(clock, partial(pair.left.follow, limits=FAST, gate=9.0))
    return pair


def test_an_arm_that_came_up_to_another_backs_out_slowly_and_goes_where_it_is_sent(
    pair_up_close,
):
    pair = pair_up_close
    begin = pair.gap()
    motion = pair.left.move(JointGoal(q=np.radians([-60.0, -40.0, 50.0, 40.0, 0.0])), wait=False)
    while not motion.future.done():
        pair.clock.advance(0.01)
        assert pair.gap() > begin - 2.0 * PARTING
    motion.result()
    assert motion.plan.report.departure
    assert np.abs(motion.plan.trajectory.qd[:30]).max() <= DEPARTURE_SPEED
    assert pair.gap() >= ROOM


def test_an_arm_that_came_up_to_another_follows_a_target_away_and_no_nearer(pair_up_close):
    pair = pair_up_close
    begin, following = pair.gap(), pair.following
    for _ in range(3):  # again and again
        for aim in (pair.left.state.q_ref, np.radians([0.0, 10.0, 0.0, 0.0, 0.0])):
            for _ in range(8):
                following.aim(aim)
                pair.clock.advance(0.01)
                assert pair.gap() > begin - 2.0 * PARTING
    for _ in range(40):
        following.aim(np.radians([-50.0, -30.0, 40.0, 30.0, 0.0]))
        pair.clock.advance(0.01)
        assert pair.gap() > begin - 2.0 * PARTING
    assert pair.gap() > 2.0 * GUARDED
    assert following.held_by == ()


def test_an_arm_that_follows_a_target_into_another_slides_along_it(pair_of, clock):
    starts = np.radians([[-50.0, -30.0, 40.0, 30.0, 0.0], [0.0, -60.0, 60.0, 40.0, 0.0]])
    pair = pair_of(Facing(0), *starts)
    following = in_time(clock, partial(pair.left.follow, limits=FAST, gate=9.0))
    wanted, nearest = np.radians([50.0, -10.0, 30.0, 20.0, 40.0]), np.inf
    for _ in range(300):  # the target of pan is in the right arm, the others need not stop for that
        following.aim(wanted)
        pair.clock.advance(0.01)
        nearest = min(nearest, pair.gap())
    assert GUARDED < nearest < 1.3 * GUARDED
    assert any("right's" in each for each in following.held_by)
    off = np.degrees(wanted - pair.left.state.q_ref)
    assert off[0] > 40.0
    assert np.abs(off[1:]).max() < 8.0
    for _ in range(200):
        following.aim(np.radians([-50.0, -30.0, 40.0, 30.0, 0.0]))
        pair.clock.advance(0.01)
    assert following.held_by == ()
    assert pair.gap() > 2.0 * GUARDED
