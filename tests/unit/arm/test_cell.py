"""Arms of one cell keep apart when motions are planned: simulated joints on a simulated clock."""

import re
from concurrent.futures import wait
from contextlib import ExitStack
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from harness.facing_arms import FAST, T_LEFT_RIGHT, Facing, FacingArms, crossing_task, in_time
from harness.random_scenes import obstacle
from harness.setpoints import swing

from benchmarks.bench_crowd import LAYOUTS, Crowd, follow_targets
from so101_motion.arm import cell_member as member_module
from so101_motion.arm.cell import Cell
from so101_motion.arm.cell_member import CellMember
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import (
    ConfigError,
    InCollision,
    Interrupted,
    MotionError,
    PlanningError,
)
from so101_motion.common.geometry import SE3
from so101_motion.control.streamed_trajectory import TimedPoint
from so101_motion.planning.cell.handover import JawGeometry
from so101_motion.planning.cell.meetings import grasps_of
from so101_motion.planning.collision.apart import (
    GUARDED,
    PARTING,
    ROOM,
    clearance_over_time,
    first_meeting,
)
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.course import Course
from so101_motion.planning.collision.scene import Attached, Box, Scene
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.motion_builder import DEPARTURE_SPEED
from so101_motion.planning.timing import online
from so101_motion.rig.simulated_rig import open_simulated

pytestmark = pytest.mark.usefixtures("planning_process")


def test_an_arm_that_waits_longer_than_planned_says_so_once_and_for_whom(pair_of, caplog):
    """Its plan was made while the other stood at its goal, and is carried out while that moves."""
    caplog.set_level("INFO", "so101_motion.arm.cell_member")
    facing = Facing(38)
    starts, goals = crossing_task(facing)
    pair = pair_of(facing, goals[0], starts[1])
    plan = pair.right.plan(JointGoal(q=goals[1]))
    pair.finish(pair.left.move(JointGoal(q=starts[0]), wait=False))
    first = pair.left.move(JointGoal(q=goals[0]), wait=False)
    while not pair.left.state.arm_moving:
        pair.advance(0.0)
    second = pair.right.move(plan, wait=False)
    while not (pair.right.state.arm_moving or second.future.done()):
        pair.advance(0.0)
    pair.arrive(first, second)
    [said] = caplog.messages
    assert re.fullmatch(r"right waits \d\.\d s more before it moves, for left", said)


def comes_near(facing, q_left, path, room):
    """Whether the right arm on its path would come near the left one that stands."""
    moving = Course(t=0.0, dt=0.01, q=np.column_stack([path, np.zeros(len(path))]))
    pair = (facing.bodies, Course.resting(q_left, 0.0)), (facing.bodies, moving)
    return first_meeting(*pair, T_LEFT_RIGHT, since=0.0, room=room, early=0.0) is not None


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
            motions.append(arm.move(JointGoal(q=q), wait=False))
            while not arm.state.arm_moving:
                pair.advance(0.0)  # no time passes while it is planned
        for _ in range(ticks):
            pair.advance()
        pair.left.start_stop()
        while pair.left.state.arm_moving:
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


def test_a_way_into_another_arm_is_refused_by_a_plan_and_stopped_unguarded_by_its_name(pair_of):
    facing = Facing(25)
    apart = facing.are_apart
    q_left, q_right, q_goal = facing.drawn(
        lambda a, b, goal: apart(a, b, 0.05) and not apart(goal, b, 0.005), 3
    )
    pair = pair_of(facing, q_left, q_right)
    with pytest.raises(InCollision) as caught:
        pair.left.plan(JointGoal(q=q_goal))
    assert caught.value.second.startswith("right's ")
    motion = pair.left.retarget(q_goal, guard=None)
    pair.finish(motion)
    with pytest.raises(MotionError, match="right's"):
        motion.result()


def test_arms_that_touch_at_the_start_are_told_to_be_moved_apart():
    """Neither moves, so that there is nobody to wait for."""
    clock = ManualClock()
    with open_simulated(clock=clock) as left, open_simulated(clock=clock) as right:
        cell = Cell()
        cell.add("left", left, SE3.identity())
        cell.add("right", right, SE3.from_rpy((0.0, 0.0, np.pi), (0.72, 0.0, 0.0)))
        goal = JointGoal(q=np.radians([60.0, 0.0, 0.0, 0.0, 0.0]))
        motion = left.arm.move(goal, wait=False)
        wait([motion.future], timeout=60.0)
        says = "at the start the jaw is 0 mm from right's jaw; move one of the arms away by hand"
        with pytest.raises(InCollision, match=says) as caught:
            motion.result(0.0)
        assert caught.value.where == "start"


def test_an_arm_that_left_the_cell_is_ignored(pair_of):
    facing = Facing(27)
    starts, _ = facing.task()
    pair = pair_of(facing, *starts)
    with pytest.raises(ConfigError, match="twice"):
        pair.cell.add("left", pair.rigs[0], SE3.identity())
    assert [each.name for each in pair.left.cell_member.others()] == ["right"]
    pair.cell.remove("right", pair.rigs[1])
    assert pair.left.cell_member.others() == ()
    assert pair.right.cell_member is None


def task_of(pair_of, seed):
    """Two arms, where they begin, and a common goal on the way to which they would meet."""
    facing = Facing(seed)
    starts, goals = crossing_task(facing)
    wanted = {name: JointGoal(q=q) for name, q in zip(("left", "right"), goals, strict=True)}
    return pair_of(facing, *starts), starts, wanted


def until_both_move(pair, *motions):
    """They begin at one moment, some milliseconds after their plan."""
    while not (pair.left.state.arm_moving and pair.right.state.arm_moving):
        assert not any(each.future.done() for each in motions)
        wait([each.future for each in motions], timeout=0.001)
        pair.advance(0.0002)


@pytest.mark.parametrize(("seconds", "overslept"), [(0.3, 0.0), (0.0, 0.3)])
def test_one_that_is_ready_much_too_late_says_so_and_moves_nowhere(
    pair_of, monkeypatch, seconds, overslept
):
    """Its thread, on a busy computer, comes late to wait for the begin, or oversleeps it."""
    monkeypatch.setattr(member_module, "LATEST", 0.01)  # here a later begin would do, too
    own = CellMember.entered

    def late(member, trajectory, pause):
        if member.name != "left":
            return own(member, trajectory, pause)
        pause(seconds)
        return own(member, trajectory, lambda wait: pause(wait + overslept))

    monkeypatch.setattr(CellMember, "entered", late)
    pair, _, wanted = task_of(pair_of, 33)
    motions = pair.cell.start_together(wanted)
    before = pair.left.state.q_ref
    while not motions["left"].future.done():  # slowly: the threads are to come in time
        wait([motions["left"].future], timeout=0.001)
        pair.advance(0.001)
    pair.finish(*motions.values())
    with pytest.raises(MotionError, match=r"ready 0\.\d+ s too late, .* how busy"):
        motions["left"].result()
    np.testing.assert_array_equal(pair.left.state.q_ref, before)


def test_an_arm_that_was_stopped_before_a_common_motion_began_is_seen_where_it_stands(pair_of):
    pair = pair_of(Facing(31), *crossing_task(Facing(31))[0])
    left, stands = pair.cell.members["left"], pair.left.state.q_ref
    goal = stands + np.array([0.5, 0.0, 0.0, 0.0, 0.0])
    motion = online.point_to_point(stands, goal, FAST, 0.01)
    left.expect(motion, pair.clock.now() + 0.05)
    assert left.plan_at(pair.clock.now()).end > pair.clock.now() + 0.3
    pair.advance(0.2)
    np.testing.assert_allclose(left.plan_at(pair.clock.now()).q[-1, :5], stands)


def planned_pair(pair_of):
    """Two arms and a common motion for them that has not begun."""
    pair, _, wanted = task_of(pair_of, 31)
    return pair, pair.cell.plan_together(wanted)


def test_a_common_motion_that_was_looked_at_is_carried_out_as_it_is(pair_of):
    pair, plans = planned_pair(pair_of)
    motions = pair.cell.move(plans, wait=False)
    pair.arrive(*motions.values())
    for name, motion in motions.items():
        assert motion.plan is plans[name]
        np.testing.assert_allclose(pair.cell.members[name].arm.state.q_ref, plans[name].q_goal)


def test_a_common_motion_begins_at_its_time_however_late_an_arm_asks_for_it(pair_of):
    (pair, plans), asked = planned_pair(pair_of), []
    left, motion = pair.cell.members["left"], plans["left"].trajectory
    left.expect(motion, begin := pair.clock.now() + 0.05)
    with left.entered(motion, asked.append):
        assert asked == [begin]


def put_new(arm):
    arm.scene = arm.scene.with_obstacles([obstacle("new", (0.05,) * 3, arm.T_base_tool.p)])


PLANK = Attached(name="plank", shape=Box(size=[0.02, 0.02, 0.5]), T_tool_object=SE3.identity())


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda arm: setattr(arm, "scene", Scene(attached=(PLANK,), floor_z=None)), "plank"),
        (put_new, "right: on this plan, which was made for another scene, .* 'new'; plan again"),
        (lambda arm: arm.set_speed(0.1), "right: .* its limit is 5.7"),
    ],
)
def test_a_common_motion_is_refused_when_what_it_was_planned_for_has_changed(pair_of, change, why):
    pair, plans = planned_pair(pair_of)
    change(pair.right)
    motions = pair.cell.move(plans, wait=False)
    ends = [each.future.exception() for each in motions.values()]  # the first ends the others
    assert any(isinstance(end, PlanningError) and re.search(why, str(end)) for end in ends)
    assert all(re.search(why, str(end)) for end in ends), "the reason is in every one of them"


def test_a_common_motion_needs_its_arms_and_a_plan_for_each(pair_of):
    pair, plans = planned_pair(pair_of)
    with pytest.raises(ConfigError, match='none for "right"'):
        pair.cell.move({"left": plans["left"]}, wait=False)
    with pytest.raises(ConfigError, match="left, right"):
        pair.cell.plan_together({"middle": JointGoal(q=np.zeros(5))})
    with pytest.raises(ConfigError, match="at least one of left and right"):
        pair.cell.plan_together({})
    with pytest.raises(ConfigError, match="degrees"):
        pair.cell.plan_together({"left": np.full(5, 45.0)})


@pytest.mark.parametrize("name", ["left", "right"])
def test_stopping_one_arm_of_a_common_motion_stops_all(pair_of, name):
    pair, _, wanted = task_of(pair_of, 31)
    motions = pair.cell.start_together(wanted)
    until_both_move(pair, *motions.values())
    for _ in range(20):
        pair.advance()
    pair.cell.members[name].arm.start_stop()
    pair.finish(*motions.values())
    said = {each: str(motion.future.exception()) for each, motion in motions.items()}
    other = next(each for each in said if each != name)
    assert "stop" in said[name]
    assert f"what ended the motion of {name}: stop" in said[other]


def test_a_stop_while_arms_are_planned_for_together_leaves_all_where_they_are(pair_of):
    pair, starts, wanted = task_of(pair_of, 31)
    motions = pair.cell.start_together(wanted)
    pair.right.start_stop()
    pair.finish(*motions.values())
    for motion in motions.values():
        with pytest.raises(Interrupted):
            motion.result()
    np.testing.assert_array_equal(pair.left.state.q_ref, starts[0])
    np.testing.assert_array_equal(pair.right.state.q_ref, starts[1])


# Four arms, crowded: a share of benchmarks/bench_crowd.py


def test_four_arms_that_follow_targets_into_the_middle_keep_apart():
    with Crowd(LAYOUTS["ring"], seed=11).opened() as crowd:
        ends = follow_targets(crowd, 150)
    assert crowd.touching == 0
    assert ends["held by another [arm ticks]"] > 150
    assert 0.5 * GUARDED < crowd.solids.nearest_hulls < 2.0 * GUARDED


# Handing over an object


STICK = Box(size=[0.02, 0.02, 0.16])


class Bench(FacingArms):
    """The left arm holds a stick at one end."""

    def __init__(self, stack):
        jaw = JawGeometry(RobotModel.load())
        held = next(e for e in grasps_of(STICK) if abs(e.T_object_grip.p[2]) > 0.06)
        T_tool_object = jaw.T_tool_grip(held.thickness) @ held.T_object_grip.inverse
        self.stick = Attached(name="stick", shape=STICK, T_tool_object=T_tool_object, mass=0.04)
        super().__init__(stack, scene=Scene(attached=(self.stick,)))

    def held(self, name):
        return [each.name for each in self.arms[name].scene.attached]

    def clearance(self):
        """How near the arms are to each other, without what they hold [m]."""
        courses = [
            (bodies_of(), Course.resting(each.state.q_ref, each.state.q_jaw))
            for each in self.arms.values()
        ]
        return clearance_over_time(*courses, T_LEFT_RIGHT, np.zeros(1))[0].distance

    def p_stick(self, name):
        """Where the middle of the stick is in the left arm's base frame [m]."""
        [held] = self.arms[name].scene.attached
        return self.cell.members[name].T_cell_base @ (
            self.arms[name].model.frame(self.arms[name].state.q_ref) @ held.T_tool_object.p
        )

    def arrive(self, motions):
        self.finish(motions)
        for motion in motions.values():
            motion.result()

    def finish(self, motions, until=lambda: False):
        def look():
            assert self.clearance() > 0.7 * GUARDED

        self.pass_time([each.future for each in motions.values()], until, look)


@pytest.fixture
def bench():
    with ExitStack() as stack:
        yield Bench(stack)


def test_a_stick_goes_from_hand_to_hand_with_its_shape_and_weight(bench):
    plan = bench.cell.plan_handover("left", "right", "stick")
    motions = bench.cell.start_handover(plan)
    bench.finish(motions, until=lambda: bench.held("right") == ["stick"])
    assert bench.held("left") == ["stick"], "both hold it"
    np.testing.assert_allclose(bench.p_stick("left"), bench.p_stick("right"), atol=1e-6)
    where = bench.p_stick("right")
    bench.arrive(motions)
    assert bench.held("left") == []
    [taken] = bench.arms["right"].scene.attached
    assert (taken.mass, taken.passed_to) == (0.04, "")
    np.testing.assert_array_equal(taken.shape.size, STICK.size)
    np.testing.assert_allclose(bench.p_stick("right"), where, atol=1e-6)


def test_stopping_one_arm_ends_the_handover_and_the_stick_stays_where_it_is(bench):
    motions = bench.cell.start_handover(bench.cell.plan_handover("left", "right", "stick"))
    bench.finish(motions, until=lambda: bench.arms["right"].state.arm_moving)
    for _ in range(20):
        bench.clock.advance(0.01)
    bench.arms["right"].start_stop()
    bench.finish(motions)
    for motion in motions.values():
        with pytest.raises(Interrupted):
            motion.result()
    assert (bench.held("left"), bench.held("right")) == (["stick"], [])


def test_a_hand_that_closes_on_nothing_takes_nothing(bench):
    plan = bench.cell.plan_handover("left", "right", "stick")
    bench.cell.members["right"].gripper.feels = True  # as a real one, and there is no stick
    motions = bench.cell.start_handover(plan)
    bench.finish(motions)
    with pytest.raises(MotionError, match=r"'stick' cannot be passed .* left still holds it"):
        motions["right"].result()
    with pytest.raises(Interrupted):
        motions["left"].result()
    assert (bench.held("left"), bench.held("right")) == (["stick"], [])


def test_an_object_that_was_lost_is_not_passed_on(bench):
    plan = bench.cell.plan_handover("left", "right", "stick")
    bench.arms["left"].scene = Scene()
    with pytest.raises(ConfigError, match=r"'stick' is not in the hand of left"):
        bench.cell.start_handover(plan)


# Followings, jogs and streams


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


def test_a_stream_into_another_arm_ends_before_it(pair_of, clock):
    starts = np.radians([[80.0, -45.0, 45.0, 60.0, 0.0], [0.0, -70.0, 60.0, 60.0, 0.0]])
    pair = pair_of(Facing(0), *starts)
    stream = in_time(clock, pair.left.stream)
    stream.push(swing(starts[0], starts[0] + np.radians([-80.0, 0.0, 0.0, 0.0, 0.0]), 6.0))
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


def test_an_arm_that_came_up_to_another_backs_out_slowly_and_goes_where_it_is_sent(pair_up_close):
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


# What is around an arm beyond its own scene: followings keep off it, also those under way


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
    with pytest.raises(MotionError, match=r"short of where it was sent, with .* close to 'crate'"):
        finish(clock, motion.future)
    assert arm.state.q[0] > 0.1
    arm.keep_off(arm.scene, arm.scene)
    finish(clock, arm.retarget(RIGHT).future)
    assert arm.state.q == pytest.approx(RIGHT, abs=1e-3)


@pytest.mark.parametrize("how", ["follow", "jog"])
def test_who_leads_an_arm_is_kept_off_what_comes_and_passes_where_it_was(arm, around, clock, how):
    motion = in_time(clock, getattr(arm, how))
    aim, to = (motion.aim, RIGHT) if how == "follow" else (motion.to_point, BEYOND)
    lead(arm, clock, aim, to, seconds=0.3)
    arm.keep_off(arm.scene, around)
    assert 0.0 < lead(arm, clock, aim, to) < 0.02
    assert any("'crate'" in each for each in motion.held_by)
    arm.keep_off(arm.scene, arm.scene)
    lead(arm, clock, aim, to, seconds=6.0)
    assert arm.T_base("tool").p == pytest.approx(BEYOND, abs=2e-3)
    finish(clock, motion.close())


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
    arm.keep_off(arm.scene, around)
    assert arm.plan(JointGoal(q=RIGHT)).report.straight, "plans do not know it"
    arm.keep_off(Scene(floor_z=-0.1), around)
    finish(clock, arm.retarget(RIGHT).future)


def test_what_is_held_longer_counts_for_a_jog_under_way(arm, around, clock):
    jog = in_time(clock, arm.jog)
    arm.keep_off(arm.scene, replace(around, attached=(POLE,)))
    lead(arm, clock, jog.to_point, BEYOND, seconds=3.0)
    assert any("'pole'" in each for each in jog.held_by)
    finish(clock, jog.close())


# Streamed points that lead into contact: the arm stops before it and says what is in the way


@pytest.fixture
def swift(clock):
    """The same arm at the speeds of others' streams."""
    with open_simulated(
        clock=clock, q_start=LEFT, speed=np.radians(150.0), acceleration=np.radians(500.0)
    ) as rig:
        yield rig.arm


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


NEAR = 0.002


def test_it_goes_by_nearer_than_our_own_plans_would(swift, clock):
    """Somebody else may have planned it, so that it bends away just before a wall."""
    u = np.linspace(0.0, 1.0, 126)
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
        return min(model.distances(each)[of_the_wall].min() for each in played.q[::4])

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


@pytest.mark.parametrize("how", ["retarget", "follow", "stream"])
def test_without_a_guard_nothing_of_the_scene_stops_an_arm(swift, clock, how):
    swift.scene = swift.scene.with_obstacles([CRATE])
    if how == "retarget":
        finish(clock, swift.retarget(RIGHT, guard=None).future)
    elif how == "follow":
        following = in_time(clock, partial(swift.follow, guard=None))
        lead(swift, clock, following.aim, RIGHT, seconds=5.0)
        finish(clock, following.close())
    else:
        stream = in_time(clock, lambda: swift.start_stream(guard=None).opened.result())
        stream.push(swing(LEFT, RIGHT, 4.0))
        finish(clock, stream.finish())
    assert swift.state.q == pytest.approx(RIGHT, abs=1e-3)
