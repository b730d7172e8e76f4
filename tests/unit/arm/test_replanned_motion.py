"""Motions that are planned again while they move: simulated joints, and a planner in our hands."""

from concurrent.futures import Future

import numpy as np
import pytest
from harness.setpoints import shares

from so101_motion.arm.replanned_motion import LEAD, ReplannedMotion
from so101_motion.common.errors import (
    ConfigError,
    InCollision,
    Interrupted,
    So101Error,
    WorkerError,
)
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Obstacle, Scene, Sphere
from so101_motion.planning.goals import LineGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner
from so101_motion.rig.rig import HARD_STOP, TICK
from so101_motion.rig.simulated_rig import open_simulated

LEFT = np.array([0.9, 0.0, 0.0, 0.0, 0.0])
BALL = Sphere(radius=0.04)
AHEAD, FARTHER, AT_THE_GOAL = (0.25, 0.0, 0.23), (0.24, 0.08, 0.23), (0.15, 0.19, 0.23)


def ball(p, name="ball"):
    T = SE3.from_translation(p)
    return Scene(obstacles=(Obstacle(name=name, shape=BALL, T_base_obstacle=T),))


class HandledPlanner:
    """Plans at once; what an arm asks while it moves is answered when the test wants it."""

    def __init__(self):
        self._planner = Planner(RobotModel.load())
        self.holds, self.dies, self.asked = False, False, []

    def plan(self, request):
        answer = Future()
        if request.lead is not None:
            self.asked.append((request, answer))
            if self.dies:
                answer.set_exception(WorkerError("the planning process has been closed"))
            if self.dies or self.holds:
                return answer
        self.give(request, answer)
        return answer

    def give(self, request, answer):
        try:
            answer.set_result(self._planner.plan(request))
        except So101Error as error:
            answer.set_exception(error)


@pytest.fixture(scope="module")
def warm():
    return HandledPlanner()


@pytest.fixture
def planner(warm):
    warm.holds, warm.dies, warm.asked = False, False, []
    return warm


@pytest.fixture
def rig(clock, planner):
    with open_simulated(clock=clock, q_start=LEFT) as rig:
        rig.arm._planner = planner.plan
        yield rig


@pytest.fixture
def tape(rig):
    """Every setpoint of the arm."""
    setpoints = []
    rig.executor.listen(lambda state: setpoints.append(state.q_ref))
    return setpoints


def finish(clock, motion):
    while not motion.future.done():
        clock.advance(TICK)
    motion.result()


def under_way(rig, clock, to=-LEFT):
    motion = rig.arm.move(to, replan=True, wait=False)
    while not rig.arm.state.arm_moving:
        clock.advance(TICK)
    clock.advance(0.4)
    return motion


def is_free(tape, scene):
    collision = CollisionModel(RobotModel.load(), scene)
    return collision.first_blocked(np.array(tape), tolerance=0.2) is None


def test_an_obstacle_in_the_way_is_gone_around_without_a_stop(rig, clock, tape):
    motion = under_way(rig, clock)
    first, before = motion.plan, len(tape)
    rig.arm.scene = ball(AHEAD)
    finish(clock, motion)
    np.testing.assert_allclose(rig.arm.state.q, -LEFT, atol=1e-3)
    assert motion.plan is not first
    assert is_free(tape[before:], ball(AHEAD))
    moved = np.abs(np.diff(np.array(tape), axis=0)).max(axis=1) > 0.0
    assert moved[np.flatnonzero(moved)[0] : np.flatnonzero(moved)[-1]].all()
    assert max(shares(tape, TICK, rig.arm.effective_limits(None))) <= 1.001


def test_a_scene_that_leaves_the_way_free_changes_nothing(rig, clock, planner):
    motion = under_way(rig, clock)
    first = motion.plan
    rig.arm.scene = ball((0.25, 0.0, 0.6))
    finish(clock, motion)
    assert (motion.plan, planner.asked) == (first, [])


def test_without_an_answer_the_arm_stops_before_the_obstacle(rig, clock, planner, tape):
    planner.holds = True
    motion = under_way(rig, clock)
    rig.arm.scene = ball(AHEAD)
    while rig.arm.state.arm_moving:
        clock.advance(TICK)
        if len(planner.asked) > 1 and rig.arm.state.qd.any():
            assert planner.asked[0][1].cancelled()  # it was late
    assert is_free(tape, ball(AHEAD))
    assert max(shares(tape, TICK, HARD_STOP)) <= 1.02
    finish(clock, motion)  # it is planned from rest
    np.testing.assert_allclose(rig.arm.state.q, -LEFT, atol=1e-3)


def test_what_is_planned_from_hard_braking_does_not_turn_back_faster_than_the_cap(
    rig, clock, planner, tape
):
    motion = under_way(rig, clock)
    clock.advance(0.6)
    planner.holds = True
    rig.arm.scene = ball((0.25, -0.02, 0.23))  # so near that it brakes as hard as it can
    clock.advance(0.06)
    limits = rig.arm.effective_limits(None)
    leads = [request.lead for request, _ in planner.asked]
    assert max(np.abs(lead.qdd[0]).max() for lead in leads) > 5.0 * limits.acceleration[0]
    assert max(np.abs(lead.qd).max() for lead in leads) <= 1.001 * limits.velocity[0]
    planner.holds = False
    finish(clock, motion)
    assert shares(tape, TICK, limits)[0] <= 1.001


@pytest.mark.parametrize(("away", "off_path"), [(0.06, True), (0.04, False)])
def test_each_joint_stops_by_itself_if_no_stop_on_the_path_is_free_and_that_one_touches_nothing(
    rig, clock, planner, tape, away, off_path
):
    to = np.array([-0.9, -0.5, -0.5, -0.5, 0.0])
    under_way(rig, clock, to)
    clock.advance(0.3)
    planner.holds = True
    x, y, z = RobotModel.load().frame(rig.arm.state.q).p
    rig.arm.scene = ball((x, y - away, z))
    clock.advance(0.3)
    shares_of_way = ((np.array(tape) - LEFT) / (to - LEFT + 1e-12))[:, :4]
    assert (np.ptp(shares_of_way, axis=1).max() > 0.01) == off_path
    assert max(shares(tape, TICK, HARD_STOP)) <= 1.001


def test_a_late_plan_is_not_played_and_the_next_has_more_time(rig, clock, planner):
    planner.holds = True
    motion = under_way(rig, clock)
    rig.arm.scene = ball(FARTHER)
    clock.advance(0.06)
    (_, late), (request, answer) = planner.asked
    assert late.cancelled()
    planner.give(request, answer)
    clock.advance(0.1)
    assert motion.plan is answer.result()
    finish(clock, motion)


def test_a_plan_begins_later_by_the_time_that_the_check_took(rig, clock, planner, monkeypatch):
    motion, check = under_way(rig, clock), ReplannedMotion._check

    def slow(self, *args):
        self._looked -= 1.5 * TICK
        return check(self, *args)

    monkeypatch.setattr(ReplannedMotion, "_check", slow)
    (old, k), rig.arm.scene, planner.holds = motion.playing.played, ball(AHEAD), True
    clock.advance(2 * TICK)
    np.testing.assert_allclose(planner.asked[0][0].lead.q[0], old.q[k + LEAD + 1], atol=1e-4)


def test_a_stop_is_at_once_whatever_the_planner_does(rig, clock, planner, tape):
    planner.holds = True
    motion = under_way(rig, clock)
    rig.arm.scene = ball(FARTHER)
    clock.advance(TICK)
    before = len(tape)
    planner.give(*planner.asked[0])
    stopped = rig.arm.start_stop()
    clock.advance(0.5)
    assert stopped.done()
    with pytest.raises(Interrupted, match="stop"):
        motion.result()
    swing = np.abs(tape[-1] - tape[before]).max()
    assert 0.0 < swing < 0.1  # as short as that of any motion
    assert not rig.arm.state.arm_moving


def test_a_planner_that_dies_ends_in_a_stop(rig, clock, planner, tape):
    planner.dies = True
    motion = under_way(rig, clock)
    rig.arm.scene = ball(AHEAD)
    with pytest.raises(WorkerError):
        finish(clock, motion)
    assert not rig.arm.state.arm_moving
    assert is_free(tape, ball(AHEAD))


def test_a_new_goal_is_gone_to_without_a_stop(rig, clock, tape):
    first = under_way(rig, clock)
    second = rig.arm.move(0.3 * LEFT, replan=True, wait=False)
    finish(clock, second)
    with pytest.raises(Interrupted, match="a newer motion"):
        first.result()
    np.testing.assert_allclose(rig.arm.state.q, 0.3 * LEFT, atol=1e-3)
    assert max(shares(tape, TICK, rig.arm.effective_limits(None))) <= 1.001


def test_an_interrupted_motion_is_over_when_the_arm_rests(rig, clock):
    motion = under_way(rig, clock)
    motion.interrupt("test")
    while rig.arm.state.arm_moving:
        assert not motion.future.done()
        clock.advance(TICK)
    with pytest.raises(Interrupted, match="test"):
        motion.result()


@pytest.mark.parametrize("is_stop", [False, True])
def test_a_new_goal_while_the_arm_is_being_stopped_is_gone_to_from_rest(rig, clock, is_stop):
    motion = under_way(rig, clock)
    if is_stop:
        rig.arm.start_stop()
    else:
        motion.interrupt("test")
    clock.advance(TICK)
    newer = rig.arm.move(LEFT, replan=True, wait=False)
    finish(clock, newer)
    np.testing.assert_allclose(rig.arm.state.q, LEFT, atol=1e-3)


def test_a_new_goal_that_cannot_be_reached_ends_in_a_stop(rig, clock):
    under_way(rig, clock)
    rig.arm.scene = ball(AT_THE_GOAL)
    with pytest.raises(InCollision):
        finish(clock, rig.arm.move(-LEFT, replan=True, wait=False))
    assert not rig.arm.state.arm_moving


def test_an_arm_whose_goal_is_taken_waits_until_it_is_free(rig, clock):
    motion = under_way(rig, clock)
    rig.arm.scene = ball(AT_THE_GOAL)
    clock.advance(2.0)
    assert not rig.arm.state.arm_moving
    assert not motion.future.done()
    rig.arm.scene = Scene()
    finish(clock, motion)
    np.testing.assert_allclose(rig.arm.state.q, -LEFT, atol=1e-3)


def test_things_that_move_are_expected_where_they_go(rig, clock, planner):
    under_way(rig, clock)
    rig.arm.scene = ball((0.25, 0.0, 0.43))
    clock.advance(0.05)
    assert planner.asked == []
    rig.arm.scene = ball((0.25, 0.0, 0.4))  # it comes down
    clock.advance(TICK)
    ((request, _),) = planner.asked
    lowest = min(each.T_base_obstacle.p[2] for each in request.scene.obstacles)
    assert lowest == pytest.approx(0.4 - 0.3 * 0.03 / 0.05, abs=0.05)


def test_a_prescribed_way_is_refused(rig):
    with pytest.raises(ConfigError, match="this goal prescribes the path"):
        rig.arm.move(LineGoal(T_base_tool=rig.arm.T_base()), replan=True)
