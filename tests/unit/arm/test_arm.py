"""The arm on simulated joints, planned for by the real worker, on a clock the test drives."""

import threading

import numpy as np
import pytest
from harness import endless_plan
from harness.facing_arms import in_time

from so101_motion.arm.motion_handle import Motion
from so101_motion.common.errors import Interrupted, MotionError
from so101_motion.common.modes import Mode
from so101_motion.planning.goals import JointGoal, PoseGoal
from so101_motion.planning.request import Search
from so101_motion.rig.simulated_rig import open_simulated

pytestmark = pytest.mark.usefixtures("planning_process")

READY = np.radians([0.0, -45.0, 45.0, 60.0, 0.0])
ASIDE = np.radians([40.0, -20.0, 30.0, 30.0, 50.0])


@pytest.fixture
def rig(clock):
    with open_simulated(clock=clock) as rig:
        yield rig


@pytest.fixture
def arm(rig):
    return rig.arm


def finish(clock, motion):
    """Let time pass until ``motion`` is over."""
    while not motion.future.done():
        clock.advance(0.05)
    motion.result()


def run_until(clock, condition):
    while not condition():
        clock.advance(0.01)


def test_a_point_is_reached_with_the_joints_of_this_very_arm(arm):
    p = np.array([0.25, 0.0, 0.12])
    assert np.degrees(arm.plan(PoseGoal.at_point(p)).q_goal[2]) > 30.0
    upper = np.array(arm.model.upper)
    upper[2] = np.radians(20.0)
    arm.set_range(arm.model.lower, upper)
    plan = arm.plan(PoseGoal.at_point(p))
    assert np.degrees(plan.trajectory.q[:, 2].max()) <= 20.201
    assert arm.model.frame(plan.q_goal).p == pytest.approx(p, abs=1e-4)


def plan_in_vain(arm, clock):
    """A motion that has begun to plan for a minute."""
    planning = threading.Event()
    search = Search(scene=endless_plan.SCENE, time_budget=60.0)

    def step(motion):
        planning.set()
        arm.plan(JointGoal(q=endless_plan.Q_GOAL), q_start=endless_plan.Q_START, search=search)

    motion = arm.start_series([step])
    run_until(clock, planning.is_set)
    return motion


def test_a_step_that_plans_in_vain_ends_with_its_motion(arm, clock):
    motion = plan_in_vain(arm, clock)
    in_time(clock, arm.stop)
    with pytest.raises(Interrupted, match="stop"):
        motion.result(10.0)


def test_closing_an_arm_ends_what_it_plans_and_then_refuses_to_move(clock):
    with open_simulated(clock=clock) as rig:
        motion = plan_in_vain(rig.arm, clock)
    with pytest.raises(Interrupted, match="shutdown"):
        motion.result(0.0)
    with pytest.raises(MotionError, match="closed"):
        rig.arm.move(JointGoal(q=READY), wait=False)


@pytest.fixture
def late_move(arm, clock):
    """A move that is asked for but cannot begin before ``gate`` is set."""
    gate = threading.Event()
    arm.start_series([lambda motion: gate.wait(60.0)])
    yield gate, arm.move(JointGoal(q=READY), wait=False)
    gate.set()


@pytest.mark.parametrize("mode", [Mode.LIMP, Mode.GUIDING])
def test_a_move_that_was_ended_takes_no_hold_of_an_arm_that_was_let_go(
    arm, clock, late_move, mode
) -> None:
    gate, move = late_move
    if mode is Mode.LIMP:
        in_time(clock, lambda: arm.set_torque(False))
    else:
        in_time(clock, lambda: arm.set_manual(True))
    gate.set()
    with pytest.raises(Interrupted, match="stop"):
        finish(clock, move)
    clock.advance(0.2)
    assert arm.state.mode is mode


def test_a_move_that_was_superseded_does_not_stop_what_superseded_it(arm, clock, late_move) -> None:
    gate, move = late_move
    retarget = arm.retarget(ASIDE)
    gate.set()
    with pytest.raises(Interrupted, match="a newer motion"):
        finish(clock, move)
    finish(clock, retarget)
    np.testing.assert_allclose(arm.state.q_ref, ASIDE)


def test_letting_go_stops_a_jaw_that_follows(rig, arm, clock):
    jaw = rig.gripper.follow()
    clock.advance(0.1)
    in_time(clock, lambda: arm.set_torque(False))
    assert arm.state.mode is Mode.LIMP
    assert jaw.future.exception(timeout=0).by == "stop"


def test_a_motion_that_is_given_up_while_it_is_prepared_holds_no_limp_arm(arm, clock, monkeypatch):
    in_time(clock, lambda: arm.set_torque(False))
    begin = Motion.begin

    def given_up(motion):
        motion.interrupt("stop")
        return begin(motion)

    monkeypatch.setattr(Motion, "begin", given_up)
    with pytest.raises(Interrupted):
        finish(clock, arm.retarget(READY))
    clock.advance(0.2)
    assert arm.state.mode is Mode.LIMP
