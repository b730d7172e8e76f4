"""Arms of one cell keep apart, whatever moves them: simulated joints on a clock the test drives."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from functools import partial

import numpy as np
import pytest
from harness.facing_arms import T_LEFT_RIGHT, Facing

from so101_motion.arm.cell import Cell
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import (
    ConfigError,
    InCollision,
    Interrupted,
    MotionError,
    So101Error,
)
from so101_motion.common.geometry import SE3
from so101_motion.control.streamed_trajectory import TimedPoint
from so101_motion.planning.collision.apart import (
    GUARDED,
    PARTING,
    ROOM,
    first_meeting,
    nearness,
)
from so101_motion.planning.collision.course import Course
from so101_motion.planning.collision.scene import Attached, Box, Scene
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.motion_builder import DEPARTURE_SPEED
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.hardware_rig import open_simulated

FAST = MotionLimits.uniform(velocity=3.0, acceleration=8.0, jerk=150.0)


@pytest.fixture(scope="module", autouse=True)
def planning_process():
    """One rig stays open, so that the others find the planning process running."""
    with open_simulated(clock=ManualClock()) as rig:
        rig.arm.plan(JointGoal(q=np.full(5, 0.2)))
        yield


def in_time(clock, call):
    """Call what waits for an arm while time passes."""
    with ThreadPoolExecutor(1) as threads:
        done = threads.submit(call)
        while not done.done():
            clock.advance(0.01)
    return done.result()


class Pair:
    """Two simulated arms that face each other; every advance looks whether they are apart."""

    def __init__(self, clock, facing, q_left, q_right, stack):
        self.clock, self.facing = clock, facing
        self.rigs = [
            stack.enter_context(open_simulated(clock=clock, q_start=q)) for q in (q_left, q_right)
        ]
        self.left, self.right = (rig.arm for rig in self.rigs)
        self.cell = Cell()
        self.cell.add("left", self.rigs[0], SE3.identity())
        self.cell.add("right", self.rigs[1], T_LEFT_RIGHT)

    def advance(self, seconds=0.01, room=0.7 * GUARDED):
        self.clock.advance(seconds)
        assert self.are_apart(room)

    def are_apart(self, room):
        return self.facing.are_apart(self.left.state.q_ref, self.right.state.q_ref, room)

    def gap(self):
        """How near they are, up to 30 mm [m]."""
        left, right = (
            Course.resting(each.state.q_ref, each.state.q_jaw_ref)
            for each in (self.left, self.right)
        )
        pair = (self.facing.bodies, left), (self.facing.bodies, right)
        found = nearness(*pair, T_LEFT_RIGHT, at=0.0, room=0.03)
        return 0.03 if found is None else found

    def finish(self, *motions, room=0.7 * GUARDED):
        moving = 0  # cycles; how many pass while a plan is made depends on how busy the machine is
        while moving < 3000:
            if all(each.future.done() for each in motions):
                return
            self.advance(room=room)
            moving += self.left.is_moving or self.right.is_moving
        raise AssertionError("it goes on and on")


@pytest.fixture
def stack():
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def pair_of(clock, stack):
    return lambda facing, *starts: Pair(clock, facing, *starts, stack)


def crossing_task(facing):
    """A task in which the straight motions of both at once would meet."""
    while True:
        starts, goals = facing.task()
        middles = [0.5 * (a + b) for a, b in zip(starts, goals, strict=True)]
        if not facing.are_apart(*middles, room=0.005):
            return starts, goals


@pytest.mark.parametrize("seed", [21, 22])
def test_a_move_that_begins_while_another_arm_moves_arrives_without_coming_near(pair_of, seed):
    facing = Facing(seed)
    starts, goals = crossing_task(facing)
    pair = pair_of(facing, *starts)
    first = pair.left.start_move(JointGoal(q=goals[0]))
    while not pair.left.is_moving:
        pair.advance()
    second = pair.right.start_move(JointGoal(q=goals[1]))
    pair.finish(first, second)
    first.result()
    second.result()
    np.testing.assert_allclose(pair.right.state.q_ref, goals[1], atol=1e-6)


def comes_near(facing, q_left, path, room):
    """Whether the right arm on its path would come near the left one that stands."""
    left, right = (
        (facing.bodies, course)
        for course in (
            Course.resting(q_left, 0.0),
            Course(t=0.0, dt=0.01, q=np.column_stack([path, np.zeros(len(path))])),
        )
    )
    met = first_meeting(left, right, T_LEFT_RIGHT, since=0.0, room=room, early=0.0)
    return met is not None


def test_an_arm_that_is_stopped_in_the_way_stops_the_other_and_says_so(pair_of):
    facing = Facing(23)
    stopped = arrived = 0
    for ticks in (40, 80, 120, 20, 60, 100, 140, 160, 180, 200):
        if stopped and arrived:
            break
        starts, goals = crossing_task(facing)
        pair = pair_of(facing, *starts)
        motions = []
        for arm, q in zip((pair.left, pair.right), goals, strict=True):
            motions.append(arm.start_move(JointGoal(q=q)))
            while not arm.is_moving:
                pair.advance(0.0)  # no time passes while it is planned
        for _ in range(ticks):
            pair.advance()
        pair.left.start_stop()
        while pair.left.is_moving:
            pair.advance()
        path, q_right = motions[1].plan.trajectory.q, pair.right.state.q_ref
        left_over = path[np.argmin(np.abs(path - q_right).max(axis=1)) :]
        pair.finish(*motions)
        error, q_left = motions[1].future.exception(), pair.left.state.q_ref
        if comes_near(facing, q_left, left_over, 0.5 * GUARDED):
            assert isinstance(error, MotionError)
            assert "left's" in str(error)
            stopped += 1
        elif not comes_near(facing, q_left, left_over, 3.0 * GUARDED):
            assert error is None
            arrived += 1
    assert stopped
    assert arrived


def test_followings_that_are_led_into_each_other_hold_and_go_on_when_they_can(pair_of, clock):
    facing = Facing(24)
    starts, goals = crossing_task(facing)
    pair = pair_of(facing, *starts)
    followings = [
        in_time(clock, partial(arm.open_following, limits=FAST, stale_after=None))
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


def test_an_unguarded_retarget_into_another_arm_is_stopped_and_names_it(pair_of):
    facing = Facing(25)
    while True:
        q_left, q_right, q_goal = (facing.near() for _ in range(3))
        if facing.are_apart(q_left, q_right, 0.05) and not facing.are_apart(q_goal, q_right, 0.005):
            break
    pair = pair_of(facing, q_left, q_right)
    motion = pair.left.start_unguarded_retarget(q_goal)
    pair.finish(motion)
    with pytest.raises(MotionError, match="right's"):
        motion.result()


@pytest.fixture
def pair_in_the_way(pair_of):
    """The right arm reaches to the middle; the left one is turned aside."""
    left, right = np.radians([[80.0, -45.0, 45.0, 60.0, 0.0], [0.0, -70.0, 60.0, 60.0, 0.0]])
    return pair_of(Facing(0), left, right)


def test_a_jog_towards_another_arm_holds_before_it(pair_in_the_way, clock):
    pair = pair_in_the_way
    jog = in_time(clock, pair.left.open_jog)
    begin = pair.left.T_base("tool").p
    for _ in range(400):
        with suppress(MotionError):
            jog.twist((0.04, 0.03, 0.0))
        pair.advance()
    assert pair.left.T_base("tool").p[0] > begin[0] + 0.02, "as far as there is room"
    said = str(jog.future.exception()) if jog.future.done() else str(jog.held_by)
    assert "right's" in said


def test_a_stream_into_another_arm_ends_before_it(pair_in_the_way, clock):
    pair = pair_in_the_way
    stream = in_time(clock, pair.left.open_stream)
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


def test_a_plan_through_an_arm_that_stands_there_is_refused_with_its_name(pair_of):
    facing = Facing(25)
    while True:
        q_left, q_right, q_goal = (facing.near() for _ in range(3))
        if facing.are_apart(q_left, q_right, 0.05) and not facing.are_apart(q_goal, q_right, 0.005):
            break
    pair = pair_of(facing, q_left, q_right)
    with pytest.raises(InCollision) as caught:
        pair.left.plan(JointGoal(q=q_goal))
    assert caught.value.second.startswith("right's ")


def test_arms_that_are_too_near_already_may_part(pair_of):
    facing = Facing(26)
    while True:
        q_left, q_right = facing.near(), facing.near()
        if facing.are_apart(q_left, q_right, 0.004) and not facing.are_apart(
            q_left, q_right, 0.008
        ):
            break
    pair = pair_of(facing, q_left, q_right)
    q_goal = facing.near()
    while not facing.are_apart(q_goal, q_right, 0.05):
        q_goal = facing.near()
    motion = pair.left.start_move(JointGoal(q=q_goal))
    pair.finish(motion, room=0.002)
    motion.result()


@pytest.fixture
def pair_led_up_close(pair_of, clock):
    """The left arm was led up to the right one, and braked into what must stay free."""
    starts = np.radians([[-50.0, -30.0, 40.0, 30.0, 0.0], [80.0, -60.0, 60.0, 40.0, 0.0]])
    pair = pair_of(Facing(0), *starts)
    led = in_time(clock, partial(pair.left.open_unguarded_following, limits=FAST, gate=9.0))
    for _ in range(60):
        led.aim(np.radians([0.0, 10.0, 0.0, 0.0, 0.0]))
        pair.clock.advance(0.01)
    assert any("right's" in each for each in led.held_by)
    assert 0.7 * GUARDED < pair.gap() < GUARDED
    pair.following = in_time(clock, partial(pair.left.open_following, limits=FAST, gate=9.0))
    return pair


def test_an_arm_that_was_led_up_to_another_backs_out_slowly_and_goes_where_it_is_sent(
    pair_led_up_close,
):
    pair = pair_led_up_close
    begin = pair.gap()
    motion = pair.left.start_move(JointGoal(q=np.radians([-60.0, -40.0, 50.0, 40.0, 0.0])))
    while not motion.future.done():
        pair.clock.advance(0.01)
        assert pair.gap() > begin - 2.0 * PARTING
    motion.result()
    assert motion.plan.report.departure
    assert np.abs(motion.plan.trajectory.qd[:30]).max() <= DEPARTURE_SPEED
    assert pair.gap() >= ROOM


def test_an_arm_that_was_led_up_to_another_is_led_away_and_no_nearer(pair_led_up_close):
    pair = pair_led_up_close
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


def test_an_arm_that_is_led_into_another_slides_along_it(pair_of, clock):
    starts = np.radians([[-50.0, -30.0, 40.0, 30.0, 0.0], [0.0, -60.0, 60.0, 40.0, 0.0]])
    pair = pair_of(Facing(0), *starts)
    following = in_time(clock, partial(pair.left.open_following, limits=FAST, gate=9.0))
    wanted, nearest = np.radians([50.0, -10.0, 30.0, 20.0, 40.0]), np.inf
    for _ in range(300):  # pan is led into the right arm, the others need not stop for that
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


def test_an_arm_that_left_the_cell_is_not_minded(pair_of):
    facing = Facing(27)
    starts, _ = facing.task()
    pair = pair_of(facing, *starts)
    with pytest.raises(ConfigError, match="twice"):
        pair.cell.add("left", pair.rigs[0], SE3.identity())
    assert [each.name for each in pair.left.place.others()] == ["right"]
    pair.cell.remove("right", pair.rigs[1])
    assert pair.left.place.others() == ()
    assert pair.right.place is None


def test_one_stop_brings_all_arms_to_rest(pair_of):
    facing = Facing(28)
    starts, goals = facing.task()
    pair = pair_of(facing, *starts)
    motion = pair.left.start_move(JointGoal(q=goals[0]))
    while not pair.left.is_moving:
        pair.advance()
    stops = [place.arm.start_stop() for place in pair.cell.places.values()]
    while not all(each.done() for each in stops):
        pair.advance()
    with pytest.raises(So101Error):
        motion.result()


@pytest.mark.parametrize("seed", [31, 33])
def test_arms_that_move_together_begin_and_end_in_the_same_tick(pair_of, seed):
    facing = Facing(seed)
    starts, goals = crossing_task(facing)
    pair = pair_of(facing, *starts)
    wanted = {name: JointGoal(q=q) for name, q in zip(("left", "right"), goals, strict=True)}
    motions = pair.cell.start_together(wanted)
    while not (pair.left.is_moving and pair.right.is_moving):
        pair.advance(0.0)  # no time passes until both have begun
    moving = []
    while not all(each.future.done() for each in motions.values()):
        moving.append((pair.left.is_moving, pair.right.is_moving))
        pair.advance()
    for motion in motions.values():
        motion.result()
    assert sum(a != b for a, b in moving) <= 30, "one may take a little longer to settle"
    np.testing.assert_allclose(pair.left.state.q_ref, goals[0], atol=1e-6)
    np.testing.assert_allclose(pair.right.state.q_ref, goals[1], atol=1e-6)


def planned_pair(pair_of):
    """Two arms and a common motion for them that has not begun."""
    facing = Facing(31)
    starts, goals = crossing_task(facing)
    pair = pair_of(facing, *starts)
    plans = pair.cell.plan_together({"left": JointGoal(q=goals[0]), "right": JointGoal(q=goals[1])})
    return pair, plans


def test_a_common_motion_that_was_looked_at_is_carried_out_as_it_is(pair_of):
    pair, plans = planned_pair(pair_of)
    motions = pair.cell.start_execute(plans)
    pair.finish(*motions.values())
    for name, motion in motions.items():
        motion.result()
        assert motion.plan is plans[name]
        np.testing.assert_allclose(pair.cell.places[name].arm.state.q_ref, plans[name].q_goal)


def test_a_common_motion_is_refused_when_an_arm_holds_more_than_it_was_planned_for(pair_of):
    pair, plans = planned_pair(pair_of)
    plank = Attached(name="plank", shape=Box(size=[0.02, 0.02, 0.5]), T_tool_object=SE3.identity())
    pair.right.scene = Scene(attached=(plank,), floor_z=None)
    motions = pair.cell.start_execute(plans)
    ends = [
        motion.future.exception() for motion in motions.values()
    ]  # the first ends those of the others
    assert any(isinstance(end, InCollision) and "plank" in str(end) for end in ends)
    assert all(isinstance(end, InCollision | Interrupted) for end in ends)


def test_a_common_motion_needs_a_plan_for_every_arm(pair_of):
    pair, plans = planned_pair(pair_of)
    with pytest.raises(ConfigError, match='none for "right"'):
        pair.cell.start_execute({"left": plans["left"]})


def test_arms_that_are_not_there_cannot_be_moved_together(pair_of):
    facing = Facing(28)
    starts, goals = facing.task()
    pair = pair_of(facing, *starts)
    with pytest.raises(ConfigError, match="left, right"):
        pair.cell.plan_together({"middle": JointGoal(q=goals[0])})


@pytest.mark.parametrize("name", ["left", "right"])
def test_who_stops_one_of_the_arms_that_move_together_stops_all(pair_of, name):
    facing = Facing(31)
    starts, goals = crossing_task(facing)
    pair = pair_of(facing, *starts)
    wanted = {each: JointGoal(q=q) for each, q in zip(("left", "right"), goals, strict=True)}
    motions = pair.cell.start_together(wanted)
    while not (pair.left.is_moving and pair.right.is_moving):
        pair.advance(0.0)
    for _ in range(20):
        pair.advance()
    pair.cell.places[name].arm.start_stop()
    pair.finish(*motions.values())
    said = {each: str(motion.future.exception()) for each, motion in motions.items()}
    other = next(each for each in said if each != name)
    assert "stop" in said[name]
    assert f"what ended the motion of {name}" in said[other]


def test_a_stop_while_arms_are_planned_for_together_leaves_all_where_they_are(pair_of):
    facing = Facing(31)
    starts, goals = crossing_task(facing)
    pair = pair_of(facing, *starts)
    wanted = {each: JointGoal(q=q) for each, q in zip(("left", "right"), goals, strict=True)}
    motions = pair.cell.start_together(wanted)
    pair.right.start_stop()
    pair.finish(*motions.values())
    for motion in motions.values():
        with pytest.raises(Interrupted):
            motion.result()
    np.testing.assert_array_equal(pair.left.state.q_ref, starts[0])
    np.testing.assert_array_equal(pair.right.state.q_ref, starts[1])
