"""Arms of one cell keep apart when motions are planned: simulated joints on a simulated clock."""

import re
from concurrent.futures import Future, wait

import numpy as np
import pytest
from harness.facing_arms import FAST, T_LEFT_RIGHT, Facing, crossing_task

from so101_motion.arm import cell_member as member_module
from so101_motion.arm.cell import Cell
from so101_motion.arm.cell_member import CellMember
from so101_motion.arm.team_motion import TeamPlanning
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import (
    ConfigError,
    InCollision,
    Interrupted,
    MotionError,
    So101Error,
)
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.apart import GUARDED, first_meeting
from so101_motion.planning.collision.course import Course
from so101_motion.planning.collision.scene import Attached, Box, Scene
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.timing import online
from so101_motion.rig.simulated_rig import open_simulated

pytestmark = pytest.mark.usefixtures("planning_process")


@pytest.mark.parametrize("seed", [21, 22])
def test_a_move_that_begins_while_another_arm_moves_arrives_without_coming_near(pair_of, seed):
    facing = Facing(seed)
    starts, goals = crossing_task(facing)
    pair = pair_of(facing, *starts)
    first = pair.left.move(JointGoal(q=goals[0]), wait=False)
    while not pair.left.is_moving:
        pair.advance()
    second = pair.right.move(JointGoal(q=goals[1]), wait=False)
    pair.finish(first, second)
    first.result()
    second.result()
    np.testing.assert_allclose(pair.right.state.q_ref, goals[1], atol=1e-6)


def test_an_arm_that_waits_longer_than_planned_says_so_once_and_for_whom(pair_of, caplog):
    """Its plan was made while the other stood at its goal, and is carried out while that moves."""
    caplog.set_level("INFO", "so101_motion.arm.cell_member")
    facing = Facing(38)
    starts, goals = crossing_task(facing)
    pair = pair_of(facing, goals[0], starts[1])
    plan = pair.right.plan(JointGoal(q=goals[1]))
    pair.finish(pair.left.move(JointGoal(q=starts[0]), wait=False))
    first = pair.left.move(JointGoal(q=goals[0]), wait=False)
    while not pair.left.is_moving:
        pair.advance(0.0)
    second = pair.right.move(plan, wait=False)
    while not (pair.right.is_moving or second.future.done()):
        pair.advance(0.0)
    pair.finish(first, second)
    first.result()
    second.result()
    [said] = caplog.messages
    assert re.fullmatch(r"right waits \d\.\d s more before it moves, for left", said)


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
            motions.append(arm.move(JointGoal(q=q), wait=False))
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


def test_a_way_into_another_arm_is_refused_by_a_plan_and_stopped_unguarded_by_its_name(pair_of):
    facing = Facing(25)
    while True:
        q_left, q_right, q_goal = (facing.near() for _ in range(3))
        if facing.are_apart(q_left, q_right, 0.05) and not facing.are_apart(q_goal, q_right, 0.005):
            break
    pair = pair_of(facing, q_left, q_right)
    with pytest.raises(InCollision) as caught:
        pair.left.plan(JointGoal(q=q_goal))
    assert caught.value.second.startswith("right's ")
    motion = pair.left.retarget(q_goal, guard=None)
    pair.finish(motion)
    with pytest.raises(MotionError, match="right's"):
        motion.result()


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
    motion = pair.left.move(JointGoal(q=q_goal), wait=False)
    pair.finish(motion, room=0.002)
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


def test_one_stop_brings_all_arms_to_rest(pair_of):
    facing = Facing(28)
    starts, goals = facing.task()
    pair = pair_of(facing, *starts)
    motion = pair.left.move(JointGoal(q=goals[0]), wait=False)
    while not pair.left.is_moving:
        pair.advance()
    stops = [member.arm.start_stop() for member in pair.cell.members.values()]
    while not all(each.done() for each in stops):
        pair.advance()
    with pytest.raises(So101Error):
        motion.result()


def task_of(pair_of, seed):
    """Two arms, where they begin, and a common goal on the way to which they would meet."""
    facing = Facing(seed)
    starts, goals = crossing_task(facing)
    wanted = {name: JointGoal(q=q) for name, q in zip(("left", "right"), goals, strict=True)}
    return pair_of(facing, *starts), starts, wanted


def until_both_move(pair, *motions):
    """They begin at one moment, some milliseconds after their plan."""
    while not (pair.left.is_moving and pair.right.is_moving):
        assert not any(each.future.done() for each in motions)
        wait([each.future for each in motions], timeout=0.001)
        pair.advance(0.0002)


@pytest.mark.parametrize("seed", [31, 33])
def test_arms_that_move_together_begin_and_end_in_the_same_tick(pair_of, seed):
    pair, _, wanted = task_of(pair_of, seed)
    motions = pair.cell.start_together(wanted)
    until_both_move(pair, *motions.values())
    moving = []
    while not all(each.future.done() for each in motions.values()):
        moving.append((pair.left.is_moving, pair.right.is_moving))
        pair.advance()
    for motion in motions.values():
        motion.result()
    assert sum(a != b for a, b in moving) <= 30, "one may take a little longer to settle"
    for name, goal in wanted.items():
        np.testing.assert_allclose(pair.arms[name].state.q_ref, goal.q, atol=1e-6)


def start_with_a_late_arm(pair_of, monkeypatch, seconds, *, overslept=0.0):
    """Begin a common motion for which the left arm's thread, on a busy computer, comes late.

    It comes by so many seconds late to wait for the begin, or oversleeps it by so many.
    """
    own = CellMember.entered

    def late(member, trajectory, pause):
        if member.name != "left":
            return own(member, trajectory, pause)
        pause(seconds)
        return own(member, trajectory, lambda wait: pause(wait + overslept))

    monkeypatch.setattr(CellMember, "entered", late)
    pair, _, wanted = task_of(pair_of, 33)
    return pair, pair.cell.start_together(wanted)


def test_an_arm_that_is_ready_late_begins_with_the_other(pair_of, monkeypatch):
    pair, motions = start_with_a_late_arm(pair_of, monkeypatch, 0.04)
    began = {}
    while len(began) < 2:
        assert not any(motion.future.done() for motion in motions.values())
        wait([motion.future for motion in motions.values()], timeout=0.001)
        pair.advance(0.0002)
        for name, arm in (("left", pair.left), ("right", pair.right)):
            if arm.is_moving:
                began.setdefault(name, pair.clock.now())
    assert abs(began["left"] - began["right"]) < 0.011, "one cycle"
    pair.finish(*motions.values())
    for motion in motions.values():
        motion.result()


@pytest.mark.parametrize(("seconds", "overslept"), [(0.3, 0.0), (0.0, 0.3)])
def test_one_that_is_ready_much_too_late_says_so_and_moves_nowhere(
    pair_of, monkeypatch, seconds, overslept
):
    monkeypatch.setattr(member_module, "LATEST", 0.01)  # here a later begin would do, too
    pair, motions = start_with_a_late_arm(pair_of, monkeypatch, seconds, overslept=overslept)
    before = pair.left.state.q_ref
    while not motions["left"].future.done():  # slowly: the threads are to come in time
        wait([motions["left"].future], timeout=0.001)
        pair.advance(0.001)
    pair.finish(*motions.values())
    with pytest.raises(MotionError, match=r"ready 0\.\d+ s after the .* how busy"):
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


def test_what_prevents_a_common_motion_is_told_to_all_its_arms():
    def gone(plans):
        raise MotionError("b left the cell")

    planned = Future()
    planning = TeamPlanning(("a", "b"), lambda: planned, gone)
    parts = [planning.part(name) for name in ("a", "b")]
    planned.set_result({"a": None, "b": None})
    for part in parts:
        with pytest.raises(MotionError, match="b left the cell"):
            part.result(timeout=0)


def planned_pair(pair_of):
    """Two arms and a common motion for them that has not begun."""
    pair, _, wanted = task_of(pair_of, 31)
    return pair, pair.cell.plan_together(wanted)


def test_a_common_motion_that_was_looked_at_is_carried_out_as_it_is(pair_of):
    pair, plans = planned_pair(pair_of)
    motions = pair.cell.move(plans, wait=False)
    pair.finish(*motions.values())
    for name, motion in motions.items():
        motion.result()
        assert motion.plan is plans[name]
        np.testing.assert_allclose(pair.cell.members[name].arm.state.q_ref, plans[name].q_goal)


def test_a_common_motion_is_refused_when_an_arm_holds_more_than_it_was_planned_for(pair_of):
    pair, plans = planned_pair(pair_of)
    plank = Attached(name="plank", shape=Box(size=[0.02, 0.02, 0.5]), T_tool_object=SE3.identity())
    pair.right.scene = Scene(attached=(plank,), floor_z=None)
    motions = pair.cell.move(plans, wait=False)
    ends = [
        motion.future.exception() for motion in motions.values()
    ]  # the first ends those of the others
    assert any(isinstance(end, InCollision) and "plank" in str(end) for end in ends)
    assert all(isinstance(end, InCollision | Interrupted) for end in ends)


def test_a_common_motion_needs_a_plan_for_every_arm(pair_of):
    pair, plans = planned_pair(pair_of)
    with pytest.raises(ConfigError, match='none for "right"'):
        pair.cell.move({"left": plans["left"]}, wait=False)


def test_arms_that_are_not_there_cannot_be_moved_together(pair_of):
    facing = Facing(28)
    starts, goals = facing.task()
    pair = pair_of(facing, *starts)
    with pytest.raises(ConfigError, match="left, right"):
        pair.cell.plan_together({"middle": JointGoal(q=goals[0])})


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
    assert f"what ended the motion of {name}" in said[other]


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
