import numpy as np
import pytest
from harness.retarget import retarget

from so101_motion.common.errors import FollowingError, Interrupted, MotionError
from so101_motion.common.modes import Mode
from so101_motion.control.executor import Channel, Tolerances
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Trajectory

Q_GOAL = np.array([0.6, -0.4, 0.5, -0.3, 1.0])
JAW_LIMITS = MotionLimits.uniform(velocity=2.0, acceleration=10.0, jerk=100.0, n=1)


# Starting


def test_it_starts_holding_where_the_joints_are(make_sim, taped_arm, clock):
    arm = taped_arm(clock, q=Q_GOAL, q_jaw=0.3)
    sim = make_sim(arm)
    sim.executor.start()
    assert sim.state.mode is Mode.HOLDING
    np.testing.assert_array_equal(sim.state.q, Q_GOAL)
    np.testing.assert_array_equal(sim.state.q_ref, Q_GOAL)
    assert sim.state.q_jaw == sim.state.q_jaw_ref == 0.3


def test_torque_comes_on_only_after_the_goal_was_set_to_what_was_measured(
    make_sim, taped_arm, clock
):
    arm = taped_arm(clock, q=Q_GOAL)
    make_sim(arm).executor.start()
    ((on, goal),) = arm.torques
    assert on
    np.testing.assert_array_equal(goal, Q_GOAL)


def test_there_is_no_state_before_the_start(make_sim):
    sim = make_sim()
    with pytest.raises(RuntimeError, match="start the executor first"):
        _ = sim.state
    with pytest.raises(RuntimeError, match="start the executor first"):
        sim.executor.hold()


# Playing


def test_a_move_ends_where_it_should_and_says_so(sim):
    assert sim.after(5.0, sim.executor.execute(sim.to_goal(Q_GOAL))) is None
    assert sim.state.mode is Mode.HOLDING
    assert not sim.state.arm_moving
    np.testing.assert_allclose(sim.state.q, Q_GOAL, atol=1e-4)
    np.testing.assert_array_equal(sim.state.q_ref, Q_GOAL)


def test_setpoints_are_the_samples_of_the_trajectory_at_exact_multiples_of_its_period(sim):
    sim.clock.advance(1.234567)
    sim.arm.tape.clear()
    trajectory = sim.slow_move()
    t0 = sim.clock.now()
    sim.after(12.0, sim.executor.execute(trajectory))
    n = len(trajectory)
    np.testing.assert_array_equal(sim.arm.goals[:n], trajectory.q)
    np.testing.assert_array_equal(sim.arm.times[:n], t0 + np.arange(n) * sim.dt)
    assert np.all(sim.arm.goals[n:] == trajectory.q[-1])
    assert sim.state.late_ticks == 0


def test_the_first_setpoint_goes_out_at_once(sim):
    sim.clock.advance(0.01)  # in between two looks at a resting arm
    sim.arm.tape.clear()
    sim.executor.execute(sim.to_goal(Q_GOAL))
    sim.clock.advance(0.0)
    assert len(sim.arm.tape) == 1
    assert sim.state.arm_moving
    assert sim.state.mode is Mode.MOVING


def test_the_state_shows_reference_and_measurement_during_a_move(sim):
    trajectory = sim.slow_move()
    sim.executor.execute(trajectory)
    sim.clock.advance(5.0)
    state = sim.state
    assert state.t == sim.clock.now()
    np.testing.assert_array_equal(state.q_ref, trajectory.q[500])
    np.testing.assert_array_equal(state.qd_ref, trajectory.qd[500])
    # the joint is 40 ms behind, and half a period for holding each goal until the next
    assert state.q_ref[0] - state.q[0] == pytest.approx(0.045 * state.qd_ref[0], rel=0.15)


def test_a_motion_that_begins_elsewhere_is_refused(sim):
    error = sim.error_after(
        1.0, sim.executor.execute(sim.to_goal(Q_GOAL, q_start=np.array([0.0, 0.0, 0.02, 0.0, 0.0])))
    )
    assert isinstance(error, MotionError)
    assert str(error).startswith("elbow_flex would jump by 1.15 deg")
    assert not sim.state.arm_moving
    np.testing.assert_array_equal(sim.state.q, np.zeros(5))


def test_a_motion_that_begins_at_speed_is_refused(sim):
    trajectory = sim.slow_move()
    moving = Trajectory(
        dt=sim.dt,
        q=trajectory.q[300:] - trajectory.q[300],
        qd=trajectory.qd[300:],
        qdd=trajectory.qdd[300:],
        duration=7.0,
    )
    with pytest.raises(MotionError, match=r"shoulder_pan would jump by .* deg/s"):
        sim.after(1.0, sim.executor.execute(moving))


def test_a_second_motion_of_the_same_channel_is_refused_and_the_first_goes_on(sim):
    first = sim.executor.execute(sim.to_goal(Q_GOAL))
    sim.clock.advance(0.2)
    second = sim.executor.execute(sim.to_goal(Q_GOAL))
    with pytest.raises(MotionError, match="another motion of the arm is under way"):
        sim.after(0.01, second)
    sim.after(5.0, first)


def test_a_trajectory_of_another_period_or_size_is_a_mistake_of_the_caller(sim):
    coarse = online.point_to_point(np.zeros(5), Q_GOAL, sim.limits, 0.02)
    with pytest.raises(ValueError, match="period"):
        sim.executor.execute(coarse)
    with pytest.raises(ValueError, match="5 joints for the jaw"):
        sim.executor.execute(sim.to_goal(Q_GOAL), channel=Channel.JAW)


def test_arm_and_jaw_move_independently_with_one_write_a_tick(sim):
    sim.arm.tape.clear()
    arm = sim.executor.execute(sim.slow_move(2.0))
    sim.clock.advance(0.1)
    jaw = retarget(sim.executor, np.array([0.5]), JAW_LIMITS, channel=Channel.JAW)
    sim.clock.advance(0.1)
    assert sim.state.arm_moving
    assert sim.state.jaw_moving
    sim.after(1.4, jaw)
    assert sim.state.q_jaw == pytest.approx(0.5, abs=1e-4)
    assert sim.state.mode is Mode.MOVING
    sim.after(2.0, arm)
    assert sim.state.mode is Mode.HOLDING
    np.testing.assert_allclose(np.diff(sim.arm.times), sim.dt, atol=1e-9)


def test_a_future_cannot_be_cancelled_behind_the_arms_back(sim):
    future = sim.executor.execute(sim.to_goal(Q_GOAL))
    assert not future.cancel()
    sim.after(5.0, future)


# Retargeting


def test_retargeting_turns_without_stopping_and_ends_the_old_motion(sim):
    first = sim.executor.execute(sim.to_goal(Q_GOAL))
    sim.clock.advance(0.5)
    fast = sim.state.qd_ref
    second = retarget(sim.executor, -Q_GOAL, sim.limits)
    error = sim.error_after(0.01, first)
    assert isinstance(error, Interrupted)
    assert error.by == "a newer motion"
    np.testing.assert_allclose(sim.state.qd_ref, fast, atol=6.0 * sim.dt)
    sim.after(6.0, second)
    np.testing.assert_allclose(sim.state.q, -Q_GOAL, atol=1e-4)


def test_goals_that_keep_coming_are_followed_smoothly(sim):
    sim.arm.tape.clear()
    futures = []
    for k in range(100):
        goal = 0.3 * np.sin(0.05 * (k + 1)) * np.ones(5)
        futures.append(retarget(sim.executor, goal, sim.limits))
        sim.clock.advance(0.02)
    sim.clock.advance(3.0)
    assert [type(f.exception()) for f in futures] == [Interrupted] * 99 + [type(None)]
    qd = np.diff(sim.arm.goals, axis=0) / sim.dt
    qdd = np.diff(qd, axis=0) / sim.dt
    qddd = np.diff(qdd, axis=0) / sim.dt
    assert np.max(np.abs(qd)) <= sim.limits.velocity[0] * 1.001
    assert np.max(np.abs(qdd)) <= sim.limits.acceleration[0] * 1.001
    assert np.max(np.abs(qddd)) <= sim.limits.jerk[0] * 1.01


# Settling and following


def test_a_motion_is_over_only_when_the_joints_have_followed(sim):
    future = sim.executor.execute(sim.to_goal(Q_GOAL))
    while not future.done():
        sim.clock.advance(sim.dt)
    assert np.max(np.abs(sim.state.q - Q_GOAL)) <= 1e-4
    assert np.max(np.abs(sim.state.qd)) <= 0.01


def test_a_joint_that_does_not_arrive_is_named_with_its_error(sim):
    sim.arm.jam("wrist_flex")
    goal = np.array([0.3, 0.0, 0.0, 0.05, 0.0])
    error = sim.error_after(5.0, sim.executor.execute(sim.to_goal(goal)))
    assert isinstance(error, FollowingError)
    assert error.joint == "wrist_flex"
    assert error.error == pytest.approx(0.05)
    assert "wrist_flex did not settle: after 1 s it is 2.86 deg from its goal" in str(error)
    assert "then move again" in str(error)
    assert sim.state.mode is Mode.HOLDING


def test_a_joint_that_comes_no_nearer_may_stay_a_little_farther_off(make_sim):
    sim = make_sim(tolerances=Tolerances(settle_position=1e-4, late_position=0.06))
    sim.executor.start()
    sim.arm.jam("wrist_flex")
    motion = sim.to_goal(np.array([0.3, 0.0, 0.0, 0.05, 0.0]))
    begin, future = sim.clock.now(), sim.executor.execute(motion)
    while not future.done():
        sim.clock.advance(sim.dt)
    assert future.exception(timeout=0) is None
    assert sim.clock.now() - begin - motion.duration == pytest.approx(0.55, abs=0.06)


def test_a_stuck_joint_stops_the_arm_and_the_error_carries_the_last_second(sim):
    sim.clock.advance(5.0)
    sim.arm.jam("elbow_flex")
    error = sim.error_after(3.0, sim.executor.execute(sim.to_goal(Q_GOAL)))
    assert isinstance(error, FollowingError)
    assert error.joint == "elbow_flex"
    assert error.error > 0.14
    times = np.array([state.t for state in error.recent])
    assert 0.95 <= times[-1] - times[0] <= 1.0
    assert np.all(np.diff(times) > 0.0)
    assert error.recent[-1].q_ref[2] > error.recent[0].q_ref[2]
    assert "elbow_flex is" in str(error)
    assert "stopped and holds" in str(error)
    # the other joints stopped short of their goals, the stuck one does not press on
    assert np.all(np.abs(sim.state.q_ref[[0, 1, 3, 4]]) < np.abs(Q_GOAL[[0, 1, 3, 4]]))
    assert sim.state.q_ref[2] == pytest.approx(0.0, abs=1e-9)
    assert sim.state.mode is Mode.HOLDING


def test_after_a_stuck_joint_the_arm_moves_again(sim):
    sim.arm.jam("elbow_flex")
    sim.error_after(3.0, sim.executor.execute(sim.to_goal(Q_GOAL)))
    sim.arm.unjam("elbow_flex")
    sim.after(5.0, sim.executor.execute(sim.to_goal(Q_GOAL)))


def test_a_fast_healthy_joint_is_not_taken_for_a_stuck_one(sim):
    fast = MotionLimits.uniform(velocity=3.1, acceleration=9.0, jerk=200.0)
    trajectory = online.point_to_point(np.zeros(5), np.full(5, 2.0), fast, sim.dt)
    sim.after(4.0, sim.executor.execute(trajectory))


def test_a_listener_is_told_every_period_until_it_has_enough(sim):
    heard = []
    end = sim.executor.listen(lambda state: heard.append(state.t))
    sim.clock.advance(1.0)
    assert np.diff(heard) == pytest.approx(np.full(len(heard) - 1, 0.01))
    assert len(heard) >= 100
    end()
    sim.clock.advance(0.2)
    count = len(heard)
    sim.clock.advance(1.0)
    assert len(heard) == count


def test_a_listener_that_fails_harms_nobody(sim, caplog):
    def fail(state):
        raise ValueError("oh")

    sim.executor.listen(fail)
    sim.clock.advance(0.05)
    assert "a listener failed" in caplog.text
    sim.after(3.0, sim.executor.execute(sim.to_goal(np.full(5, 0.2))))
