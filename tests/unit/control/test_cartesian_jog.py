"""Leading the tool by hand, through the executor on a clock the test drives."""

import logging

import numpy as np
import pytest
from harness.retarget import retarget

from so101_motion.common.attributes import LoadConfig
from so101_motion.common.errors import ConfigError, Interrupted, MotionError, NotHolding, Overloaded
from so101_motion.common.geometry import SE3
from so101_motion.common.modes import Mode
from so101_motion.control.cartesian_jog import Jog
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.differential.servo import Servo
from so101_motion.planning.goals import PoseGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.simulated_rig import open_simulated

MODEL = RobotModel.load()
READY = np.radians([0.0, -30.0, 30.0, 35.0, 0.0])
LIMITS = MotionLimits.uniform(velocity=1.5, acceleration=3.0, jerk=100.0)


@pytest.fixture
def sim(make_sim, taped_arm, clock):
    sim = make_sim(taped_arm(clock, q=READY))
    sim.executor.start()
    return sim


def servo_of(sim) -> Servo:
    return Servo(MODEL, CollisionModel(MODEL), LIMITS, sim.dt, sim.state.q_ref)


def lead(sim, servo: Servo | None = None) -> Jog:
    return sim.executor.play(Jog(servo or servo_of(sim), sim.dt, lambda: 0.0))


def repeat(sim, jog: Jog, seconds: float, linear, **more) -> None:
    for _ in range(round(seconds / 0.1)):
        jog.twist(linear, **more)
        sim.clock.advance(0.1)


def tool(q) -> SE3:
    return MODEL.frame(q)


def assert_within_limits(goals: np.ndarray, dt: float, acceleration: float) -> None:
    assert np.abs(np.diff(goals, axis=0)).max() / dt <= LIMITS.velocity[0] * 1.001
    assert np.abs(np.diff(goals, 2, axis=0)).max() / dt**2 <= acceleration * 1.02


def test_a_repeated_velocity_moves_the_tool_until_it_is_not_repeated(sim) -> None:
    start, jog = tool(READY).p, lead(sim)
    sim.clock.advance(0.05)
    assert sim.state.arm_moving
    repeat(sim, jog, 1.0, [0.05, 0.0, 0.0])
    assert tool(sim.state.q).p[0] > start[0] + 0.03
    sim.clock.advance(1.0)
    where = sim.state.q
    sim.clock.advance(0.5)
    np.testing.assert_allclose(sim.state.q, where, atol=1e-6)
    assert sim.state.mode is Mode.MOVING
    assert tool(where).p[0] < start[0] + 0.05 * (1.0 + 0.25) + 0.01


def test_repeating_the_same_velocity_keeps_the_tool_on_one_line(sim) -> None:
    start, jog = tool(READY).p, lead(sim)
    repeat(sim, jog, 2.0, [0.0, 0.06, 0.0])
    offset = tool(sim.state.q_ref).p - start
    assert offset[1] > 0.09
    assert np.linalg.norm(offset[[0, 2]]) < 1e-3


def test_closing_brings_the_arm_to_rest_and_ends_the_jog(sim) -> None:
    jog = lead(sim)
    repeat(sim, jog, 0.5, [0.0, 0.1, 0.0])
    sim.after(2.0, jog.close())
    assert sim.state.mode is Mode.HOLDING
    assert not sim.state.arm_moving
    assert_within_limits(sim.arm.goals, sim.dt, LIMITS.acceleration[0])
    with pytest.raises(MotionError, match="open a new one"):
        jog.twist([0.1, 0.0, 0.0])


def test_a_pose_or_point_is_reached_and_held_without_being_repeated(sim) -> None:
    goal = tool(READY + np.array([0.3, 0.15, -0.1, 0.1, 0.2]))
    jog, p = lead(sim), tool(READY).p + np.array([-0.04, 0.06, 0.02])
    jog.to_pose(goal)
    sim.clock.advance(3.0)
    assert np.linalg.norm(tool(sim.state.q).p - goal.p) < 2e-4
    np.testing.assert_allclose(tool(sim.state.q).R, goal.R, atol=2e-3)
    jog.to_point(p.tolist())
    sim.clock.advance(3.0)
    assert np.linalg.norm(tool(sim.state.q).p - p) < 2e-4
    sim.after(1.0, jog.close())


def test_stop_ends_a_jog_along_its_path_and_harder_than_it_would(sim) -> None:
    servo = servo_of(sim)
    jog = lead(sim, servo=servo)
    repeat(sim, jog, 0.6, [0.0, 0.15, 0.05])
    ahead = servo.path_to_rest()[1:]
    stopped = sim.executor.stop()
    sim.after(2.0, stopped)
    assert isinstance(jog.future.exception(), Interrupted)
    rest = sim.state.q_ref
    assert np.abs(ahead - rest).max(axis=1).min() < 1e-3
    assert np.abs(rest - ahead[0]).max() < np.abs(ahead[-1] - ahead[0]).max()
    assert_within_limits(sim.arm.goals, sim.dt, sim.stop_limits.acceleration[0])
    with pytest.raises(Interrupted):
        jog.twist([0.1, 0.0, 0.0])


def test_what_holds_the_tool_is_reported(sim) -> None:
    jog = lead(sim)
    assert jog.held_by == ()
    repeat(sim, jog, 4.0, [0.0, 0.0, -0.1])
    assert any("the floor" in word for word in jog.held_by)
    assert CollisionModel(MODEL).clearance(sim.state.q_ref).distance > 0.003
    repeat(sim, jog, 0.5, [0.0, 0.0, 0.05])
    assert jog.held_by == ()


def test_a_goal_may_turn_a_jog_aside(sim) -> None:
    jog = lead(sim)
    repeat(sim, jog, 0.4, [0.05, 0.0, 0.0])
    sim.after(3.0, retarget(sim.executor, READY, sim.limits))
    np.testing.assert_allclose(sim.state.q, READY, atol=1e-4)
    assert isinstance(jog.future.exception(), Interrupted)


def test_a_limp_arm_is_not_jogged(sim) -> None:
    sim.after(0.1, sim.executor.release())
    jog = lead(sim)
    sim.clock.advance(0.1)
    with pytest.raises(NotHolding):
        jog.twist([0.1, 0.0, 0.0])


@pytest.mark.parametrize(
    ("what", "bad"),
    [("twist", bad) for bad in ([0.1, 0.2], [np.nan, 0.0, 0.0], "fast", None)]
    + [("point", bad) for bad in ([100.0, 200.0, 300.0], [np.nan, 0.0, 0.0], [0.1, 0.2], "there")],
)
def test_what_is_no_velocity_or_no_point_is_refused(sim, what, bad) -> None:
    jog = lead(sim)
    with pytest.raises(ConfigError, match=what):
        (jog.twist if what == "twist" else jog.to_point)(bad)


def test_the_arm_is_jogged_past_nothing_in_its_scene(clock) -> None:
    with open_simulated(clock=clock, q_start=READY) as rig:
        arm = rig.arm
        jog = arm.jog()
        for _ in range(60):
            jog.twist([0.0, 0.0, -0.08])
            clock.advance(0.05)
        assert arm.is_moving
        assert CollisionModel(arm.model, arm.scene).clearance(arm.state.q_ref).distance > 0.003
        assert "the floor" in " ".join(jog.held_by)
        with pytest.raises(ConfigError, match="not fixed to the gripper"):
            arm.jog(frame="elbow")


def test_the_arm_is_jogged_no_further_than_it_can_hold_what_it_carries(clock) -> None:
    with open_simulated(clock=clock, q_start=READY) as rig:
        arm = rig.arm
        arm.set_load(LoadConfig(mass=0.2))
        jog = arm.jog()
        for _ in range(40):
            jog.twist([0.1, 0.0, 0.0])
            clock.advance(0.1)
        assert jog.held_by == ("shoulder_lift bearing all that it may",)
        further = arm.T_base().p + np.array([0.03, 0.0, 0.0])
        with pytest.raises(Overloaded, match="at the goal"):
            arm.plan(PoseGoal.at_point(further))


class Unbraked(Jog):
    """A jog whose way to rest cannot be computed."""

    def brake(self, now, limits):
        raise ArithmeticError("no way to rest")


def test_a_stop_that_fails_leaves_nobody_waiting_and_nothing_moving(sim, caplog) -> None:
    jog = sim.executor.play(Unbraked(servo_of(sim), sim.dt, lambda: 0.0))
    repeat(sim, jog, 0.5, [0.05, 0.0, 0.0])
    caplog.set_level(logging.CRITICAL, logger="so101_motion.control.joint_controller")
    here = sim.state.q_ref
    asked = [sim.executor.stop(), sim.executor.call(lambda driver: 1), sim.executor.stop()]
    sim.clock.advance(0.05)
    assert all(future.done() for future in asked)
    assert isinstance(asked[0].exception(), ArithmeticError)
    assert isinstance(jog.future.exception(), ArithmeticError)
    assert sim.state.mode is Mode.FAULT
    sim.clock.advance(0.5)
    np.testing.assert_array_equal(sim.state.q_ref, here)


def test_a_jog_that_makes_way_says_for_what(clock) -> None:
    with open_simulated(clock=clock, q_start=READY) as rig:
        jog = rig.arm.jog()
        for _ in range(5):
            jog.twist([0.05, 0.0, 0.0])
            clock.advance(0.05)
        motion = rig.arm.retarget(READY)
        while not motion.future.done():
            clock.advance(0.05)
        assert jog.future.exception().by == "a newer motion"
