"""Programs on a simulated arm, planned for by the real worker, on a clock the test drives."""

import threading
import time
from concurrent.futures import Future
from contextlib import contextmanager

import numpy as np
import pytest

from so101_motion.arm.motion_queue import wait_here
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import (
    ConfigError,
    InCollision,
    Interrupted,
    MotionError,
    So101Error,
)
from so101_motion.common.geometry import SE3
from so101_motion.common.units import to_rad
from so101_motion.planning.collision.scene import FLOOR_Z, Box, Obstacle, Scene
from so101_motion.planning.goals import JointGoal
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.tasks.program import (
    ARM,
    Loop,
    Program,
    ProgramRun,
    Solo,
    Waypoint,
    rehearse,
    start_program,
)

pytestmark = pytest.mark.usefixtures("planning_process")

A = np.radians([20.0, -20.0, 20.0, 20.0, 0.0])
B = np.radians([-20.0, -20.0, 20.0, 20.0, 30.0])
INTO_THE_TABLE = np.radians([0.0, 80.0, 20.0, 0.0, 0.0])


class PausesKnown(ManualClock):
    """A clock that knows who pauses on it: the arm's own thread attends to it for that alone."""

    def __init__(self):
        super().__init__()
        self.pausing = set()

    @contextmanager
    def attend(self):
        me = threading.current_thread()
        pauses = me.name.startswith("so101-arm")
        with super().attend():
            if pauses:
                self.pausing.add(me)
            try:
                yield
            finally:
                self.pausing.discard(me)


@pytest.fixture
def clock():
    return PausesKnown()


@pytest.fixture
def rig(clock):
    with open_simulated(clock=clock, speed=to_rad(180.0), acceleration=to_rad(500.0)) as rig:
        yield rig


def program(*waypoints, rounds=1):
    return Program.of_waypoints(waypoints, rounds=rounds)


def at(q, name="there", **rest):
    return Waypoint(name=name, q=q, **rest)


def start(rig, made):
    return start_program(Solo.of(rig), rehearse(Solo.of(rig), made))


def until(rig, condition):
    """Let time pass, but only while somebody waits for it, until ``condition`` is true.

    What the arm's thread does between two motions takes real time, and none of the clock's.
    """
    clock, moment, end = rig.clock, threading.Event(), time.monotonic() + 60.0
    while time.monotonic() < end:
        if condition():
            return
        if rig.arm.state.arm_moving or rig.gripper.is_moving or clock.pausing:
            clock.advance(0.02)
        else:
            moment.wait(0.0005)
    pytest.fail("did not come true")


def finish(rig, run, look=lambda: None):
    """Let the run end; returns what ``look`` saw meanwhile, each as long as it lasted."""
    seen = []

    def is_over():
        if (now := look()) not in seen[-1:]:
            seen.append(now)
        return run.future.done()

    until(rig, is_over)
    run.future.result()
    return seen


def test_a_rehearsal_plans_every_leg_and_moves_nothing(rig, clock):
    made = rehearse(Solo.of(rig), program(at(A, pause=2.0), at(B), rounds=2))
    clock.advance(1.0)
    np.testing.assert_array_equal(rig.arm.state.q, np.zeros(5))
    first, second = (each.leg.plan for each in made.first_round)
    np.testing.assert_allclose(first.q_goal, A)
    np.testing.assert_array_equal(second.q_start, first.q_goal)
    back = made.arrivals[2].leg.plan
    np.testing.assert_allclose([back.q_start, back.q_goal], [B, A])
    assert made.duration == pytest.approx(first.duration + second.duration + 2.0)


def test_each_leg_is_planned_with_the_jaw_as_the_waypoint_before_leaves_it(rig):
    rehearse(Solo.of(rig), program(at(A, aperture=1.0), at(B)))
    request, _ = rig.arm.newest
    assert request.q_jaw == pytest.approx(rig.gripper.opened)
    np.testing.assert_allclose(request.q_start, A)


def test_of_waypoints_that_are_passed_the_slowest_step_counts_up_to_the_stop(rig):
    slow = (Waypoint(name="by", q=A, passes=True, speed=0.25), at(B))
    quick = (Waypoint(name="by", q=A, passes=True), at(B))
    durations = [rehearse(Solo.of(rig), program(*way)).duration for way in (slow, quick)]
    assert durations[0] > 1.4 * durations[1]
    with pytest.raises(ConfigError, match="speed"):
        at(A, speed=0.0)


def test_a_run_goes_round_and_round_and_the_jaw_moves_where_it_was_told(rig):
    run = start(rig, program(at(A, aperture=0.6), at(B, aperture=0.0, pause=1.0), rounds=2))
    seen = finish(rig, run, lambda: (run.where.round, run.where.index, run.where.doing))
    assert run.share == 1.0
    np.testing.assert_allclose(rig.arm.state.q, B, atol=to_rad(0.1))
    assert rig.gripper.aperture == pytest.approx(0.0, abs=0.02)
    told = [(lap, k, doing) for lap in (0, 1) for k, doing in ((0, "moving"), (1, "pausing"))]
    assert [where for where in seen if where in told] == told
    assert (1, 0, "jaw") in seen


def test_a_pause_lasts_as_long_as_it_should(rig, clock):
    run = start(rig, program(at(np.zeros(5), pause=3.0)))
    until(rig, lambda: run.where.doing == "pausing")
    begin = clock.now()
    finish(rig, run)
    assert clock.now() - begin == pytest.approx(3.0, abs=0.1)


def test_a_run_is_slowed_from_its_next_stop_on(rig, clock):
    rehearsal = rehearse(Solo.of(rig), program(at(A), at(B), at(A), at(B)))
    run, began = start_program(Solo.of(rig), rehearsal, speed=0.5), clock.now()
    until(rig, lambda: run.where.index == 1)
    first = clock.now() - began
    run.speed = 0.25  # for the third, since the second is under way
    until(rig, lambda: run.where.index == 2)
    second = clock.now() - began - first
    until(rig, lambda: run.where.index == 3)
    third = clock.now() - began - first - second
    run.stop()
    planned = [leg.at[-1] for leg in rehearsal.legs]
    assert [first, second, third] == pytest.approx(
        [2.0 * planned[0], 2.0 * planned[1], 4.0 * planned[2]], rel=0.15
    )


@pytest.mark.parametrize("doing", ["moving", "jaw", "pausing"])
@pytest.mark.parametrize("how", ["run", "arm"])
def test_stop_ends_a_run_whatever_it_is_doing(rig, clock, doing, how):
    run = start(rig, program(at(A, aperture=1.0, pause=5.0), at(B), rounds=None))
    until(rig, lambda: run.where.doing == doing)
    clock.advance(0.1)
    stop = run.stop if how == "run" else lambda: rig.arm.newest_motion.interrupt("stop")
    stop()
    until(rig, run.future.done)
    assert isinstance(run.future.exception(), Interrupted)
    until(rig, lambda: not rig.arm.state.arm_moving and not rig.gripper.is_moving)
    stands = rig.arm.state.q
    clock.advance(8.0)
    np.testing.assert_allclose(rig.arm.state.q, stands, atol=to_rad(0.05))


def test_a_run_does_not_fight_with_whoever_else_moves_the_arm(rig):
    run = start(rig, program(at(A, pause=5.0), at(B)))
    until(rig, lambda: run.where.doing == "pausing")
    newer = rig.arm.move(JointGoal(q=np.zeros(5)), wait=False)
    until(rig, run.future.done)
    error = run.future.exception()
    assert isinstance(error, Interrupted)
    assert error.by == "a newer motion"
    until(rig, newer.future.done)
    newer.result()


def test_a_run_that_finds_the_arm_elsewhere_says_so_and_moves_nothing(rig):
    rehearsal = rehearse(Solo.of(rig), program(at(A, "aside")))
    moved = rig.arm.move(JointGoal(q=B), wait=False)
    until(rig, moved.future.done)
    run = start_program(Solo.of(rig), rehearsal)
    until(rig, run.future.done)
    with pytest.raises(MotionError, match=r"waypoint 1 \(aside\): the arm has been moved"):
        run.future.result()
    np.testing.assert_allclose(rig.arm.state.q, B, atol=to_rad(0.1))


def test_a_leg_through_an_obstacle_that_has_come_since_is_refused_before_it_begins(rig):
    rehearsal = rehearse(Solo.of(rig), program(at(A, "aside")))
    middle = rehearsal.legs[0].plan.trajectory.sample(0.5 * rehearsal.legs[0].seconds).q
    T = SE3.from_translation(rig.arm.model.frame(middle).p)
    came = Obstacle(name="crate", shape=Box(size=[0.03] * 3), T_base_obstacle=T)
    before, rig.arm.scene = rig.arm.state.q, rig.arm.scene.with_obstacles([came])
    run = start_program(Solo.of(rig), rehearsal)
    until(rig, run.future.done)
    with pytest.raises(InCollision, match=r"waypoint 1 \(aside\).* 'crate'; plan again"):
        run.future.result()
    np.testing.assert_array_equal(rig.arm.state.q, before)


def test_nothing_and_a_jaw_that_is_not_there_cannot_be_rehearsed(rig):
    with pytest.raises(ConfigError, match="has no waypoint"):
        rehearse(Solo.of(rig), Program())
    with pytest.raises(ConfigError, match=r"left, right.* are several; `so101 cell run`"):
        rehearse(Solo.of(rig), Program(steps=({"left": at(A)}, {"right": at(A)})))
    with pytest.raises(ConfigError, match="this arm has none"):
        rehearse(Solo(rig.arm, None, rig.clock), program(at(A, aperture=1.0)))


# Loops


def test_a_loop_is_rehearsed_with_the_way_back_and_the_jaw_of_its_second_time(rig):
    def loop(times):
        made = program(at(A, pause=1.0), at(B, aperture=1.0), at(np.zeros(5)))
        again = Loop(first=0, last=1, times=times)
        return rehearse(Solo.of(rig), made.with_loop(again))

    made, opened = loop(4), rig.gripper.opened
    keys = [(each.indices[-1], each.stands[ARM].q_jaw == opened) for each in made.legs]
    assert keys == [(0, False), (1, False), (0, True), (1, True), (2, True)]
    assert made.duration - loop(3).duration == pytest.approx(loop(3).duration - loop(2).duration)


@pytest.mark.parametrize("places", [(A, B), (np.zeros(5),)], ids=["endless", "goes nowhere"])
def test_an_endless_run_goes_on_until_it_is_stopped(rig, places):
    run = start(rig, program(*map(at, places), rounds=None))
    until(rig, lambda: run.where.round > 2)
    assert 0.0 <= run.share < 1.0
    run.stop()
    until(rig, run.future.done)
    assert isinstance(run.future.exception(), Interrupted)


def test_a_run_that_is_still_planned_is_ended_by_a_stop_and_moves_nothing(rig):
    planning = Future()
    made = program(at(A))
    run = ProgramRun(Solo.of(rig), made, lambda: wait_here(planning))
    until(rig, lambda: not rig.arm.newest_motion.future.done())
    run.stop()
    until(rig, run.future.done)
    assert isinstance(run.future.exception(), Interrupted)
    np.testing.assert_array_equal(rig.arm.state.q, np.zeros(5))


# Waypoints that are passed

AROUND = np.radians(
    [[20, -20, 20, 20, 0], [30, -35, 30, 10, 10], [10, -45, 20, 30, 20], [-15, -30, 35, 5, 0]]
)


def passing(*places, passes=True):
    """Waypoints of which all but the last are passed."""
    last = len(places) - 1
    return tuple(
        Waypoint(name=f"{k}", q=q, passes=passes and k < last) for k, q in enumerate(places)
    )


def test_passing_where_the_arm_stands_is_no_motion(rig):
    there = np.zeros(5)
    made = rehearse(Solo.of(rig), program(*passing(there, there)))
    (leg,) = made.legs
    assert leg.plan is None
    made = rehearse(Solo.of(rig), program(*passing(there, A, A)))
    (leg,) = made.legs
    np.testing.assert_allclose(leg.at, [0.0, leg.plan.duration, leg.plan.duration], atol=0.02)


def test_a_passed_waypoint_that_cannot_be_reached_is_named(rig):
    with pytest.raises(InCollision, match=r"^waypoint 2 \(1\): "):
        rehearse(Solo.of(rig), program(*passing(A, INTO_THE_TABLE, B)))


@pytest.mark.parametrize("places", [(B,), AROUND[1:]])
def test_a_jaw_that_gripped_something_has_the_next_leg_planned_anew_as_a_whole(rig, places):
    rehearsal = rehearse(Solo.of(rig), program(at(A, pause=1.0), *passing(*places)))
    run = start_program(Solo.of(rig), rehearsal)
    until(rig, lambda: run.where.doing == "pausing")
    rig.gripper.move(0.5, wait=False)
    until(rig, lambda: run.where.index == 1 and run.where.doing == "moving")
    finish(rig, run)
    assert run.leg.plan is not rehearsal.legs[1].plan
    assert len(places) == 1 or len(run.leg.plan.path) == 4
    np.testing.assert_allclose(rig.arm.state.q, places[-1], atol=to_rad(0.1))


# Items


START = np.array([0.0, -1.4, 1.05, 1.2, 0.0])


@pytest.fixture
def among_things(clock, rig):
    T = SE3.from_translation((0.2, 0.05, FLOOR_Z + 0.015))
    cube = Obstacle(name="cube", shape=Box(size=np.full(3, 0.03)), T_base_obstacle=T, mass=0.02)
    rig.arm.scene = Scene(obstacles=(cube,))
    until(rig, rig.arm.move(JointGoal(q=START), wait=False).future.done)
    return rig


def test_what_ends_the_picking_of_a_program_is_told_with_its_step(among_things):
    rig = among_things
    with pytest.raises(So101Error, match=r"waypoint 1 \(there\): .*cub.*cube"):
        start(rig, program(at(START, item="cub")))
    run = start(rig, program(at(START, item="cube"), at(A)))
    until(rig, lambda: run.future.done() or (rig.things.held and run.where.index == 1))
    rig.things._let_go()
    rig.things._fall(rig.things._things["cube"])
    lost = r"waypoint 2 \(there\): the grip on 'cube' was lost while carrying 'cube'; the arm has"
    with pytest.raises(So101Error, match=lost + r" stopped, and 'cube' lies at \("):
        finish(rig, run)
    (cube,) = rig.arm.scene.items
    np.testing.assert_array_equal(cube.T_base_obstacle.p, rig.things.where("cube").p)
