import threading
from dataclasses import replace

import numpy as np
import pytest
from harness.retarget import retarget
from harness.setpoints import shares, swing

from so101_motion.common.compliance import Compliance
from so101_motion.common.errors import (
    BusError,
    CommandRefused,
    FollowingError,
    Interrupted,
    MotionError,
    NotHolding,
    OutsideLimits,
)
from so101_motion.common.modes import Mode
from so101_motion.control.executor import Channel, Tolerances
from so101_motion.control.following import Following
from so101_motion.control.motion_source import FORESIGHT, PlannedMotion
from so101_motion.control.streamed_trajectory import LEAD, START_GATE, Stream, TimedPoint
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point
from so101_motion.planning.timing.trajectory import Trajectory

Q_GOAL = np.array([0.6, -0.4, 0.5, -0.3, 1.0])
FAR = np.array([1.2, -0.8, 1.0, -0.6, 2.0])
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
    ((on, goal),) = arm.torques
    assert on, "only after the goal was set to what was measured"
    np.testing.assert_array_equal(goal, Q_GOAL)


def test_there_is_no_state_before_the_start(make_sim):
    sim = make_sim()
    with pytest.raises(RuntimeError, match="start the executor first"):
        _ = sim.state
    with pytest.raises(RuntimeError, match="start the executor first"):
        sim.executor.hold()
    sim.executor.close()
    assert sim.arm.is_closed, "what was never started releases the driver"


# Playing


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


@pytest.mark.parametrize(
    "begin",
    [lambda sim: sim.executor.execute(sim.to_goal(Q_GOAL)), lambda sim: sim.stream().future],
)
def test_a_second_motion_of_the_same_channel_is_refused_and_the_first_goes_on(sim, begin):
    first = sim.executor.execute(sim.to_goal(Q_GOAL))
    sim.clock.advance(0.2)
    second = begin(sim)
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


# Settling and following


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


def test_what_is_refused_as_the_arm_stops_for_a_joint_does_not_hide_that_joint(
    make_sim, taped_arm, clock
):
    """After a stall of the computer a joint is no longer where it is to stay."""

    class Gone(taped_arm):
        def write(self, q_cmd, q_jaw_cmd, qd_cmd=None, *more):
            if qd_cmd is not None and np.isnan(qd_cmd).any():
                raise CommandRefused("elbow_flex was to move by -6.3 deg", joint="elbow_flex")
            super().write(q_cmd, q_jaw_cmd, qd_cmd, *more)

    sim = make_sim(Gone(clock))
    sim.executor.start()
    sim.arm.jam("elbow_flex")
    error = sim.error_after(3.0, sim.executor.execute(sim.to_goal(Q_GOAL)))
    assert isinstance(error, FollowingError)
    assert "elbow_flex is 8." in sim.state.fault
    assert isinstance(error.__cause__, CommandRefused)


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
    sim.arm.unjam("elbow_flex")
    sim.after(5.0, sim.executor.execute(sim.to_goal(Q_GOAL, q_start=sim.state.q_ref)))


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


# Manual mode


@pytest.mark.parametrize("guided", [False, True])
def test_joints_let_go_of_or_guided_stay_where_they_are_pushed_and_are_held_there(sim, guided):
    sim.after(0.0, sim.executor.guide(Compliance()) if guided else sim.executor.release())
    assert sim.state.mode is (Mode.GUIDING if guided else Mode.LIMP)
    assert sim.arm.torque is guided
    before = sim.state.t
    sim.clock.advance(0.0101)
    assert not guided or sim.state.t == pytest.approx(before + 0.01, abs=1e-3), "in every tick"
    sim.arm.push(Q_GOAL)
    sim.clock.advance(0.5)
    np.testing.assert_array_equal([sim.state.q, sim.state.q_ref], [Q_GOAL] * 2)
    sim.after(0.0, sim.executor.hold())
    assert sim.state.mode is Mode.HOLDING
    sim.clock.advance(1.0)
    np.testing.assert_array_equal(sim.state.q, Q_GOAL)
    assert guided or np.array_equal(sim.arm.torques[-1][1], Q_GOAL)
    with pytest.raises(RuntimeError, match="driven"):
        sim.arm.push(np.zeros(5))


def looks(sim, seconds):
    """How often the arm is looked at meanwhile."""
    times = {sim.state.t}
    for _ in range(round(seconds / 0.01)):
        sim.clock.advance(0.01)
        times.add(sim.state.t)
    return len(times) - 1


def test_a_quiet_arm_is_looked_at_five_times_a_second_until_something_happens(sim):
    sim.arm.tape.clear()
    assert looks(sim, 1.0) == 20
    assert sim.arm.tape == [], "it is told nothing"
    sim.clock.advance(1.5)
    assert looks(sim, 2.0) in (9, 10)
    sim.after(0.0, sim.executor.release())
    sim.clock.advance(2.5)
    assert looks(sim, 2.0) in (9, 10)
    sim.arm.push(sim.state.q + 0.02)
    sim.clock.advance(0.2)
    assert looks(sim, 1.0) in (19, 20)


def test_a_quiet_arm_serves_a_request_at_once(sim):
    sim.clock.advance(5.05)
    begin = sim.clock.now()
    future = sim.executor.execute(sim.to_goal(Q_GOAL))
    sim.clock.advance(0.0)
    assert sim.state.t == begin
    assert sim.state.arm_moving
    stop = sim.executor.stop()
    sim.clock.advance(1.0)
    assert future.done()
    assert stop.done()


@pytest.mark.parametrize(
    ("guided", "says"),
    [
        (False, "the arm is limp; let it hold first"),
        (True, "guided by hand; leave manual mode first"),
    ],
)
def test_limp_and_guided_joints_refuse_to_move(sim, guided, says):
    sim.after(0.0, sim.executor.guide(Compliance()) if guided else sim.executor.release())
    for future in (
        sim.executor.execute(sim.to_goal(Q_GOAL)),
        retarget(sim.executor, Q_GOAL, sim.limits),
        sim.stream().future,
    ):
        with pytest.raises(NotHolding, match=says):
            sim.after(0.02, future)


def test_holding_what_is_held_changes_nothing(sim):
    sim.after(0.0, sim.executor.hold())
    move = sim.executor.execute(sim.to_goal(Q_GOAL))
    sim.after(0.1, sim.executor.hold())
    assert len(sim.arm.torques) == 1
    sim.after(5.0, move)


# Jobs on the bus


def test_a_job_runs_with_the_driver_on_the_io_thread_and_its_failure_is_no_fault(sim):
    ran = sim.after(0.0, sim.executor.call(lambda it: (it, threading.current_thread().name)))
    assert ran == (sim.arm, "so101-io-test")
    with pytest.raises(LookupError, match="no such register"):
        sim.after(0.0, sim.executor.call(lambda it: {}["no such register"]))
    assert sim.state.mode is Mode.HOLDING


@pytest.mark.parametrize(
    ("ask", "says"),
    [
        (lambda it: it.guide(Compliance()), "guided by hand while the arm is moving; stop it or"),
        (lambda it: it.release(), "torque cannot go off while the arm is moving"),
        (lambda it: it.call(lambda driver: driver.read()), "busy with a motion"),
    ],
)
def test_a_moving_arm_is_neither_guided_nor_let_go_and_does_no_jobs(sim, ask, says):
    move = sim.executor.execute(sim.to_goal(Q_GOAL))
    with pytest.raises(MotionError, match=says):
        sim.after(0.1, ask(sim.executor))
    sim.after(5.0, move)


# Ending


def test_closing_stops_smoothly_ends_the_thread_and_releases_the_driver(sim):
    future = sim.executor.execute(sim.slow_move())
    sim.clock.advance(5.0)
    sim.executor.close()
    assert future.exception(timeout=0).by == "shutdown"
    assert sim.arm.is_closed
    assert sim.arm.torque  # it goes on holding
    assert shares(sim.arm.goals[-30:], sim.dt, sim.stop_limits)[1] <= 1.01
    np.testing.assert_allclose(sim.arm.goals[-1], sim.arm.goals[-2], atol=1e-11)
    sim.executor.close()


def test_after_closing_every_request_says_that_the_arm_has_been_closed(sim):
    sim.executor.close()
    for request in (
        sim.executor.execute(sim.to_goal(Q_GOAL)),
        sim.executor.hold(),
        sim.executor.call(lambda driver: driver.read()),
    ):
        with pytest.raises(MotionError, match="has been closed; open it again"):
            request.result(timeout=0)
    assert sim.executor.stop().result(timeout=0) is None


# Streams


TRAVEL = np.array([0.9, -0.6, 0.7, 0.4, -1.1])


def batches():
    """A smooth motion from zero to ``TRAVEL``, ten points a batch."""
    every = swing(np.zeros(5), TRAVEL, 2.0)
    return [every[k : k + 10] for k in range(0, len(every), 10)]


def used(sim, limits):
    """The largest share of these limits that the arm was sent."""
    return max(shares(sim.arm.goals[1:], sim.dt, limits))


def test_an_opened_stream_holds_still_until_points_come(sim):
    stream = sim.stream()
    sim.clock.advance(1.0)
    assert sim.state.arm_moving
    np.testing.assert_array_equal(sim.state.q, np.zeros(5))
    sim.after(1.0, sim.executor.interrupt(stream.future, "cancelled"))
    with pytest.raises(Interrupted, match="cancelled"):
        stream.push(batches()[0])


def test_a_stream_that_runs_dry_slows_down_holds_and_says_so(sim):
    stream = sim.stream()
    todo = batches()
    for batch in todo[:5]:
        stream.push(batch)
    error = sim.error_after(3.0, stream.future)
    assert isinstance(error, MotionError)
    assert "the stream ran dry: its last point was for 0.980 s" in str(error)
    assert sim.state.mode is Mode.HOLDING
    assert 0.2 < sim.state.q_ref[0] / TRAVEL[0] < 0.8
    assert used(sim, sim.stop_limits) <= 1.02
    with pytest.raises(MotionError, match="ran dry"):
        stream.push(todo[5])


@pytest.mark.parametrize("by", ["stop", "a newer motion"])
def test_a_stream_can_be_stopped_and_superseded(sim, by):
    stream = sim.stream()
    for batch in batches():
        stream.push(batch)
    sim.clock.advance(1.0)
    if by == "stop":
        sim.after(2.0, sim.executor.stop())
        assert used(sim, sim.stop_limits) <= 1.02
    else:
        sim.after(4.0, retarget(sim.executor, np.zeros(5), sim.limits))
        np.testing.assert_allclose(sim.state.q, np.zeros(5), atol=1e-4)
    assert stream.future.exception(timeout=0).by == by


def test_a_stream_that_ends_at_speed_comes_to_rest_at_its_last_point(sim):
    stream = sim.stream()
    t = np.arange(0.0, 1.01, 0.02)
    q = (0.5 * np.minimum(t, 0.4) ** 2 / 0.4 + np.maximum(t - 0.4, 0.0))[:, None] * np.ones(5)
    stream.push([TimedPoint(t=float(at), q=where) for at, where in zip(t, q, strict=True)])
    sim.after(4.0, stream.finish())
    np.testing.assert_allclose(sim.state.q, q[-1], atol=1e-4)
    assert used(sim, sim.limits) <= 1.02


# Faults


def unplug(sim):
    sim.arm.disconnect(BusError("unplugged"))
    sim.clock.advance(0.1)


def set_off(sim, for_=0.8, to=FAR):
    future = sim.executor.execute(sim.to_goal(to))
    sim.clock.advance(for_)
    return future


def test_a_driver_that_raises_in_mid_motion_ends_everything_with_its_error(sim):
    move = set_off(sim, 0.4)
    stopping = sim.executor.stop()
    sim.clock.advance(0.01)
    unplugged = BusError("servo 3 does not answer")
    sim.arm.disconnect(unplugged)
    assert sim.error_after(0.01, move) is unplugged
    assert stopping.exception(timeout=0) is unplugged
    assert sim.state.mode is Mode.FAULT
    assert sim.state.fault == "servo 3 does not answer"
    assert not sim.state.arm_moving


def test_a_joint_that_fell_silent_while_it_lagged_is_not_sent_back_to_where_it_was(
    make_sim, taped_arm, clock
):
    class SilentArm(taped_arm):
        """Its first servo is not heard from the hundredth goal on."""

        heard = 0.0

        def read(self):
            reading = super().read()
            if len(self.tape) < 100:
                self.heard = reading.q[0]
                return reading
            q = np.array([self.heard, *reading.q[1:]])
            return replace(reading, q=q, unanswered=frozenset({"shoulder_pan"}))

    sim = make_sim(SilentArm(clock))
    sim.executor.start()
    error = sim.error_after(5.0, sim.executor.execute(sim.slow_move(3.0)))
    assert isinstance(error, FollowingError)
    steps = np.diff(sim.arm.goals[:, 0])
    assert steps.min() > -1e-3
    assert sim.state.mode is Mode.HOLDING


def test_a_fault_refuses_motion_and_says_why(sim):
    sim.arm.disconnect(BusError("servo 3 restarted: check it"))
    sim.clock.advance(0.1)
    with pytest.raises(NotHolding, match=r"in a fault: .*check it; clear it, then let .* hold"):
        sim.after(0.1, retarget(sim.executor, Q_GOAL, sim.limits))


def test_holding_again_leads_out_of_a_fault_without_a_jump(sim):
    set_off(sim, 0.4)
    unplug(sim)
    assert sim.state.mode is Mode.FAULT
    with pytest.raises(BusError, match="unplugged"):
        sim.after(0.0, sim.executor.hold())
    sim.arm.reconnect()
    sim.clock.advance(10.0)
    assert sim.state.mode is Mode.FAULT  # it is the user who says go on
    assert sim.clock.now() - sim.state.t <= 0.05, "and sees where it is"
    sim.after(0.0, sim.executor.hold())
    assert sim.state.mode is Mode.HOLDING
    assert sim.state.fault is None
    np.testing.assert_array_equal(sim.state.q_ref, sim.state.q)
    sim.after(5.0, set_off(sim, 0.4))


def test_a_driver_that_fails_to_let_go_is_a_fault_out_of_which_joints_can_be_released(sim, caplog):
    sim.arm.disconnect(BusError("unplugged"))
    with pytest.raises(BusError, match="unplugged"):
        sim.after(0.0, sim.executor.release())
    assert sim.state.mode is Mode.FAULT
    sim.clock.advance(1.0)
    assert caplog.messages == ["the arm is in a fault: unplugged"], "logged once"
    sim.arm.reconnect()
    sim.after(0.0, sim.executor.release())
    assert sim.state.mode is Mode.LIMP
    assert sim.state.fault is None
    unplug(sim)
    sim.executor.close()
    assert sim.arm.is_closed, "an arm in a fault can be closed"


def test_a_driver_that_fails_at_the_start_is_closed_and_the_error_reaches_the_caller(make_sim):
    sim = make_sim()
    sim.arm.disconnect(BusError("no servo answers"))
    with pytest.raises(BusError, match="no servo answers"):
        sim.executor.start()
    assert sim.arm.is_closed
    sim.executor.close()


# Time


@pytest.fixture
def pausing(make_sim, taped_arm, clock):
    """Starts an arm that pauses before and after a goal goes out, when so many have [s]."""

    def start(when, after, before=0.0):
        class Arm(taped_arm):
            def write(self, *command, **more):
                count = len(self.tape) + 1
                if before and when(count):
                    clock.wait(clock.now() + before, threading.Event())
                super().write(*command, **more)
                if after and when(count):
                    clock.wait(clock.now() + after, threading.Event())

        sim = make_sim(Arm(clock))
        sim.executor.start()
        sim.arm.tape.clear()
        return sim

    return start


def hundredth(count):
    return count == 100


def test_late_ticks_are_left_out_and_counted_and_no_two_goals_are_sent_at_once(pausing, clock):
    sim = pausing(lambda count: count % 10 == 0, 0.023)
    trajectory = sim.slow_move(3.0)
    t0 = clock.now()
    sim.after(5.0, sim.executor.execute(trajectory))
    gaps = np.diff(sim.arm.times)
    # after a long exchange two ticks are gone and the third comes 3 ms late, then all is on time
    np.testing.assert_allclose(np.unique(np.round(gaps, 6)), [0.007, 0.01, 0.023])
    assert sim.state.late_ticks == np.sum(np.isclose(gaps, 0.023))
    k = np.round((sim.arm.times - t0) / sim.dt - 0.2).astype(int)
    np.testing.assert_array_equal(sim.arm.goals, trajectory.q[np.minimum(k, 300)])


def test_after_a_pause_in_which_joints_came_to_rest_they_speed_up_again(pausing):
    sim = pausing(hundredth, 0.5)
    trajectory = sim.slow_move(3.0)
    sim.after(6.0, sim.executor.execute(trajectory))

    times, goals = sim.arm.times, sim.arm.goals
    gap = int(np.argmax(np.diff(times)))
    assert times[gap + 1] - times[gap] > 0.49
    after = goals[gap:]  # the joints stood at the last goal when the pause ended
    acceleration = np.diff(after, 2, axis=0, prepend=after[:1]) / sim.dt**2
    assert np.abs(acceleration).max() <= 1.1 * np.abs(trajectory.qdd).max()
    np.testing.assert_array_equal(after[-1], trajectory.q[-1])
    assert 3.0 + 0.5 < times[-1] - times[0] < 6.0
    path = trajectory.at(np.arange(0.0, 3.001, 1e-4))[0]
    on_path = [np.abs(path - q).max(axis=1).min() for q in after]
    assert max(on_path) < 2e-4


@pytest.mark.parametrize(("before", "after"), [(0.12, 0.0), (0.5, 0.0), (0.06, 0.06), (0.0, 0.11)])
def test_a_pause_around_a_setpoint_is_no_sudden_stop(pausing, before, after):
    sim = pausing(lambda count: count == 151, after, before)
    trajectory = sim.slow_move(3.0)
    assert np.degrees(trajectory.qd.max()) > 100.0
    sim.after(6.0, sim.executor.execute(trajectory))
    np.testing.assert_array_equal(sim.arm.goals[-1], trajectory.q[-1])


@pytest.mark.parametrize("pause", [0.15, 0.9])
def test_a_stop_under_way_in_a_pause_is_over_after_it(pausing, clock, pause):
    sim = pausing(hundredth, pause)
    moving = sim.executor.execute(sim.slow_move(3.0))
    clock.advance(0.97)
    stopping = sim.executor.stop()
    sim.after(3.0, stopping)
    assert moving.exception(timeout=0) is not None
    times, goals = sim.arm.times, sim.arm.goals
    gap = int(np.argmax(np.diff(times)))
    assert times[gap + 1] - times[gap] > pause - 0.01
    np.testing.assert_allclose(goals[gap:], goals[gap:][:1].repeat(len(goals) - gap, axis=0))


def test_a_long_standstill_ends_the_motion_without_a_jump(pausing):
    sim = pausing(hundredth, 2.0)
    future = sim.executor.execute(sim.slow_move(3.0))
    error = sim.error_after(5.0, future)
    assert isinstance(error, MotionError)
    assert "no setpoint could be sent for 2.00 s" in str(error)
    assert np.max(np.abs(np.diff(sim.arm.goals, axis=0))) < 0.03
    assert sim.state.mode is Mode.HOLDING


def test_pauses_in_a_motion_are_told_once(pausing, caplog):
    sim = pausing(lambda count: count in (60, 120), 0.3)
    sim.after(6.0, sim.executor.execute(sim.slow_move(3.0)))
    assert caplog.text.count("no setpoint was sent for 0.3") == 1


def test_joints_that_follow_targets_speed_up_again_after_a_pause(pausing):
    sim = pausing(hundredth, 0.3)
    limits = MotionLimits.uniform(velocity=1.0, acceleration=4.0, jerk=80.0)
    following = sim.executor.play(
        Following(
            q_start=np.zeros(5), lower=np.full(5, -3.0), upper=np.full(5, 3.0), limits=limits,
            stop_limits=limits, dt=sim.dt, each=lambda following: following.aim(np.full(5, 2.0)),
        )
    )  # fmt: skip
    sim.clock.advance(2.0)

    times, goals = sim.arm.times, sim.arm.goals
    gap = int(np.argmax(np.diff(times)))
    assert times[gap + 1] - times[gap] > 0.29
    acceleration = np.diff(goals[gap:], 2, axis=0, prepend=goals[gap : gap + 1]) / sim.dt**2
    assert 3.0 < np.abs(acceleration).max() < 4.2
    assert not following.future.done()
    sim.after(3.0, sim.executor.stop())


# Stopping


def test_the_next_setpoint_after_a_stop_already_slows_down(sim):
    move = set_off(sim)
    asked = sim.clock.now()
    sim.arm.tape.clear()
    before = sim.state
    stopped = sim.executor.stop()
    sim.clock.advance(2 * sim.dt)
    assert sim.state.mode is Mode.STOPPING
    speeds = np.diff(np.vstack([before.q_ref, sim.arm.goals]), axis=0) / sim.dt
    assert sim.arm.times[0] - asked <= 2 * sim.dt
    assert np.all(np.abs(speeds[0]) < np.abs(before.qd_ref))
    assert np.all(np.abs(speeds[1]) < np.abs(speeds[0]))
    sim.after(2.0, stopped)
    assert move.exception(timeout=0).by == "stop"


def test_a_stop_is_over_when_the_joints_are_at_rest(sim):
    move = set_off(sim)
    retarget(sim.executor, np.array([1.0]), JAW_LIMITS, channel=Channel.JAW)
    sim.clock.advance(0.1)
    stopped = sim.executor.stop()
    while not stopped.done():
        assert not move.done()
        sim.clock.advance(sim.dt)
    assert move.done()
    assert not sim.state.jaw_moving
    assert np.max(np.abs(sim.state.qd)) <= 0.01
    assert sim.state.mode is Mode.HOLDING
    held = sim.state.q_ref
    sim.clock.advance(1.0)
    np.testing.assert_allclose(sim.state.q, held, atol=1e-6)


@pytest.mark.parametrize("mode", [Mode.HOLDING, Mode.LIMP])
def test_stopping_what_does_not_move_is_over_at_once(sim, mode):
    if mode is Mode.LIMP:
        sim.after(0.0, sim.executor.release())
    assert sim.after(0.0, sim.executor.stop()) is None
    assert sim.state.mode is mode
    if mode is Mode.HOLDING:
        sim.after(5.0, set_off(sim))


def test_a_second_stop_joins_the_first_and_the_first_reason_counts(sim):
    move = set_off(sim)
    first = sim.executor.stop(by="cancelled")
    sim.clock.advance(0.05)
    second = sim.executor.stop()
    sim.clock.advance(2.0)
    assert first.done()
    assert second.done()
    assert move.exception(timeout=0).by == "cancelled"


def test_a_motion_asked_for_before_the_stop_never_begins(sim):
    sim.arm.tape.clear()
    entered, leave = threading.Event(), threading.Event()  # the I/O thread is busy meanwhile
    gate = sim.executor.call(lambda _: entered.set() or leave.wait(60.0))
    entered.wait(60.0)
    move = sim.executor.execute(sim.to_goal(FAR))
    stopped = sim.executor.stop()
    assert move.exception(timeout=0).by == "stop"
    leave.set()
    sim.clock.advance(1.0)
    assert gate.done()
    assert stopped.done()
    assert sim.arm.tape == []


@pytest.mark.parametrize("turns", [False, True])
def test_a_stop_cannot_be_undone_by_a_newer_motion(sim, turns):
    set_off(sim)
    stopped = sim.executor.stop()
    sim.clock.advance(0.03)
    newer = retarget(sim.executor, np.zeros(5), sim.limits) if turns else set_off(sim, 0.0)
    assert isinstance(sim.error_after(0.01, newer), MotionError)
    sim.after(2.0, stopped)


def test_the_jaw_may_set_off_while_the_arm_is_stopping(sim):
    set_off(sim)
    stopped = sim.executor.stop(Channel.ARM)
    sim.clock.advance(0.02)
    jaw = retarget(sim.executor, np.array([1.0]), JAW_LIMITS, channel=Channel.JAW)
    sim.after(3.0, jaw)
    assert stopped.done()


@pytest.mark.parametrize("for_", [0.8, None])
def test_interrupting_ends_that_motion_and_completes_at_rest(sim, for_):
    move = sim.executor.execute(sim.to_goal(FAR)) if for_ is None else set_off(sim, for_)
    sim.after(2.0, sim.executor.interrupt(move, "cancelled"))
    assert move.exception(timeout=0).by == "cancelled"
    assert not sim.state.arm_moving
    assert for_ or np.max(np.abs(sim.state.q)) < 1e-5, "before its first setpoint it stays"


def test_a_stop_while_settling_ends_the_motion_as_interrupted(sim):
    move = set_off(sim, 0.0)
    while sim.state.arm_moving and np.any(sim.state.q_ref != FAR):
        sim.clock.advance(sim.dt)
    sim.after(1.0, sim.executor.stop())
    assert move.exception(timeout=0).by == "stop"
    np.testing.assert_array_equal(sim.state.q_ref, FAR)


def test_the_outcome_is_seen_only_after_the_state_shows_it(sim):
    seen = []
    move = set_off(sim)
    move.add_done_callback(lambda _: seen.append((sim.state.arm_moving, sim.state.mode)))
    sim.executor.stop()
    sim.clock.advance(2.0)
    assert seen == [(False, Mode.HOLDING)]


# Streamed points, and planned motions, as sources of commands


DT = 0.01
LIMITS = MotionLimits.uniform(velocity=1.5, acceleration=5.0, jerk=50.0)
HOME = np.array([0.1, -0.2, 0.3, -0.4, 0.5])


def make_stream(q_start=HOME):
    return Stream(q_start=q_start, limits=LIMITS, dt=DT)


def points(t, q):
    return [TimedPoint(t=float(at), q=where) for at, where in zip(t, q, strict=True)]


AWAY = HOME + 0.8


def played(stream, until):
    """The setpoints from 0 to ``until``, and their times."""
    t = np.arange(round(until / DT) + 1) * DT
    return t, np.array([stream.at(at).q for at in t])


def test_playing_waits_for_points_enough_or_for_the_end():
    stream, short = make_stream(), make_stream()
    for point in swing(HOME, AWAY, 2.0):
        assert stream.is_primed == (point.t > LEAD)
        stream.push([point])
        if point.t > LEAD:
            break
    short.push(points([0.0, 0.1], [HOME, HOME]))
    assert not short.is_primed
    short.finish()
    assert short.is_primed


def test_dense_points_are_followed_closely_a_little_later():
    stream = make_stream()
    dense = swing(HOME, AWAY, 2.0)
    t, q_pan = zip(*((each.t, each.q[0]) for each in dense), strict=True)
    stream.push(dense)
    at, played_q = played(stream, 2.0)

    def off(delay):
        return np.max(np.abs(played_q[:, 0] - np.interp(at - delay, t, q_pan)))

    assert min(off(delay) for delay in np.arange(0.0, 0.15, 0.005)) < np.radians(0.3)


def test_coarse_points_become_a_motion_within_all_limits():
    stream = make_stream()
    t = np.arange(5) * 0.7
    q = HOME + np.array([0.0, 0.8, -0.2, -0.2, 0.8])[:, None] * np.ones(5)
    stream.push(points(t, q))
    assert max(shares(played(stream, 2.8)[1], DT, LIMITS)) <= 1.01


def test_a_start_a_little_off_fades_out_and_adds_at_most_a_tenth():
    stream = make_stream()
    off = START_GATE * np.array([0.9, -0.9, 0.5, 0.0, 0.2])
    q_first = HOME + off
    stream.push(points([0.0, 10.0], [q_first, q_first]))
    _, q = played(stream, 10.0)
    assert max(shares(q, DT, LIMITS)[:2]) <= 0.1 * 1.001
    np.testing.assert_allclose(q[-1], q_first, atol=1e-9)


def test_it_makes_no_difference_in_how_many_pieces_the_points_arrive():
    whole, pieces = make_stream(), make_stream()
    every = swing(HOME, AWAY, 6.0)
    whole.push(every)
    pieces.push(every[:25])
    next_point = 25
    for k in range(500):
        while next_point < len(every) and every[next_point].t < k * DT + 0.3:
            pieces.push([every[next_point]])
            next_point += 1
        np.testing.assert_allclose(pieces.at(k * DT).q, whole.at(k * DT).q, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("t", "q"), [(float("nan"), HOME), (0.0, HOME * np.inf)])
def test_points_must_be_finite(t, q):
    with pytest.raises(ValueError, match="must be finite"):
        TimedPoint(t=t, q=q)


def test_a_start_too_far_away_names_joint_and_figures():
    q_first = HOME.copy()
    q_first[3] += np.radians(5.5)
    with pytest.raises(OutsideLimits) as caught:
        make_stream().push(points([0.0], [q_first]))
    assert caught.value.joint == "wrist_flex"
    assert caught.value.value == pytest.approx(q_first[3])
    says = "wrist_flex: the first point of the stream is -17.4 deg, but the arm is at -22.9"
    assert says in str(caught.value)


def test_points_too_fast_name_joint_time_and_figures_and_are_not_taken():
    stream = make_stream()
    q_fast = HOME.copy()
    q_fast[1] += 0.4
    with pytest.raises(OutsideLimits) as caught:
        stream.push(points([0.0, 0.2], [HOME, q_fast]))
    assert caught.value.joint == "shoulder_lift"
    assert caught.value.value == pytest.approx(2.0)
    assert caught.value.upper == 1.5
    says = "shoulder_lift: the points ask for 114.6 deg/s at 0.000 s, the limit is 85.9 deg/s"
    assert says in str(caught.value)
    stream.push(points([0.0, 0.4], [HOME, q_fast]))
    assert stream.t_last == 0.4
    with pytest.raises(OutsideLimits, match=r"deg/s at 0\.400 s"):
        stream.push(points([0.5], [q_fast + 0.5]))  # watched across batches


def test_a_later_jolt_that_the_smoothing_cannot_take_is_refused():
    stream = make_stream()
    every = swing(HOME, AWAY, 4.0)
    stream.push(every[:100])
    last = every[99]
    back = points(last.t + np.array([0.1, 0.2]), last.q - np.array([[0.14], [0.28]]))
    with pytest.raises(OutsideLimits) as caught:
        stream.push(back)
    assert "deg/s^2" in str(caught.value)
    assert caught.value.value > LIMITS.acceleration[0]
    stream.push(every[100:])


def test_an_empty_stream_cannot_be_finished_and_a_finished_one_takes_no_more():
    stream = make_stream()
    stream.push([])
    assert not stream.is_primed
    with pytest.raises(MotionError, match="holds no points"):
        stream.finish()
    stream.push(points([0.0], [HOME]))
    stream.finish()
    assert stream.close() is stream.future, "it is over already"
    left = make_stream()
    left.close()
    np.testing.assert_allclose(left.at(5.0).q, HOME)
    for ask in (lambda: stream.push(points([1.0], [HOME])), stream.finish):
        with pytest.raises(MotionError, match="has been closed"):
            ask()


def test_a_stream_that_is_over_says_why():
    failed, done = make_stream(), make_stream()
    failed.future.set_exception(Interrupted("stop"))
    done.future.set_result(None)
    with pytest.raises(Interrupted, match="stop"):
        failed.push(points([0.0], [HOME]))
    with pytest.raises(MotionError, match="open a new one"):
        done.push(points([0.0], [HOME]))


def stopped(stream, count, limits=LIMITS, *, refused=False):
    """The last of so many setpoints, and the stop from it; the next one may have been refused."""
    for k in range(count):
        now = stream.sample(k)
    if refused:
        stream.sample(count)
    stop = stream.brake(now, limits)
    np.testing.assert_allclose(stop.q[0], now.q, atol=1e-12)
    return now, stop


@pytest.mark.parametrize("refused", [False, True])
def test_a_stop_stays_on_the_points_that_are_known(refused):
    """Joints that turn at different times would leave them if each stopped by itself."""
    stream = make_stream()
    t = np.arange(151) * 0.02
    u = np.clip((t[:, None] - np.array([0.0, 0.15, 0.3, 0.45, 0.6])) / 2.0, 0.0, 1.0)
    q = HOME + 0.8 * (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5)
    stream.push(points(t, q))
    hard = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=200.0)
    now, stop = stopped(stream, 100, hard, refused=refused)
    assert np.abs(stop.q[1] - now.q).max() < 1.5 * DT
    assert not stop.qd[-1].any()
    path = np.array([stream.at(at).q for at in np.arange(0.9, 2.0, 0.001)])
    off = [np.abs(path - each).max(axis=1).min() for each in stop.q]
    assert max(off) < 1e-3
    assert np.abs(np.diff(stop.q, 2, axis=0)).max() / DT**2 < 1.1 * 10.0


def test_a_stop_that_takes_longer_than_the_points_reach_stops_each_joint():
    stream = make_stream()
    t = np.arange(41) * 0.02
    stream.push(points(t, HOME + 0.7 * t[:, None] ** 2 * np.ones(5)))
    now, stop = stopped(stream, 79)
    assert now.qd[0] > 0.5
    assert not stop.qd[-1].any()
    assert np.abs(np.diff(stop.q, 2, axis=0)).max() / DT**2 < 1.02 * LIMITS.acceleration[0]


def test_a_stop_at_rest_stays_there_although_the_last_point_is_known():
    stream = make_stream()
    stream.push(swing(HOME, AWAY, 1.0))
    stream.finish()
    _, stop = stopped(stream, 1)
    np.testing.assert_allclose(stop.q[-1], HOME, atol=1e-3)


def test_a_stop_near_the_end_goes_on_to_the_last_point():
    stream = make_stream()
    t = np.arange(26) * 0.02
    q = HOME + 0.7 * t[:, None] ** 2 * np.ones(5)  # ends at speed
    stream.push(points(t, q))
    stream.finish()
    now, stop = stopped(stream, 50)
    assert now.qd[0] > 0.4
    np.testing.assert_allclose(stop.q[-1], q[-1], atol=1e-9)


@pytest.mark.parametrize(
    ("before", "times", "says"),
    [
        ((), (0.1,), r"must be for time 0, not 0\.1 s"),
        ((0.0,), (0.0,), "must increase"),
        ((0.0,), (-0.1,), "must increase"),
        ((0.0,), (0.2, 0.2), "must increase"),
        ((), (0.0, 80_000.0), "point for 80000 s is more than 600 s ahead"),
    ],
)
def test_points_of_wrong_times_are_refused_and_not_taken(before, times, says):
    stream = make_stream()
    stream.push(points(before, [HOME] * len(before)))
    with pytest.raises(ValueError, match=says):
        stream.push(points(times, [HOME] * len(times)))
    good = [0.1] if before else [0.0, 0.1]
    stream.push(points(good, [HOME] * len(good)))
    assert stream.t_last == pytest.approx(0.1)


# A planned motion as a source of commands


def planned(to):
    trajectory = point_to_point(np.zeros(5), np.full(5, to), LIMITS, DT)
    return trajectory, PlannedMotion(trajectory)


def test_the_stop_ahead_begins_at_the_setpoint_and_rests_on_the_path():
    trajectory, motion = planned(0.8)
    setpoint = motion.sample(40)
    q, dt = motion.stop_ahead()
    np.testing.assert_array_equal(q[0], setpoint.q)
    assert np.all(np.diff(q[:, 0]) >= 0.0)
    assert q[0, 0] < q[-1, 0] < 0.8
    assert 0.1 < dt * (len(q) - 1) < 1.0
    motion.sample(len(trajectory) + 7)  # its last ticks were missed
    q, _ = motion.stop_ahead()
    assert np.all(q == trajectory.q[-1])


def test_the_acceleration_ahead_ends_at_the_speed_that_will_be_had():
    trajectory, motion = planned(0.8)
    for k in (0, 20, len(trajectory) - 3, len(trajectory) + 7):
        now = motion.sample(k)
        later = trajectory.sample(k * 0.01 + FORESIGHT)
        np.testing.assert_allclose(now.qd + FORESIGHT * motion.acceleration, later.qd, atol=1e-12)


def test_a_setpoint_that_was_refused_is_not_skipped_by_the_stop():
    """The stop begins where the joints are, so they do not take two steps in one cycle."""
    _, motion = planned(0.8)
    now = motion.sample(40)
    motion.sample(41)
    stop = motion.brake(now, LIMITS)
    np.testing.assert_array_equal(stop.q[0], now.q)
    assert np.abs(stop.q[1] - now.q).max() <= 1.5 * 0.01


def test_a_motion_may_be_faster_for_a_moment_only_where_it_is_going_to_be_faster():
    limits = MotionLimits.uniform(velocity=0.9, acceleration=1.7, jerk=50.0)
    source = PlannedMotion(point_to_point(np.zeros(5), np.linspace(0.5, 1.0, 5), limits, 0.01))
    speeds = np.abs(source.played[0].qd)
    for k in range(len(speeds)):
        source.sample(k)
        then, soon = speeds[k + 6 : k + 13], speeds[k + 6 : k + 31]
        assert source.room >= 0.0
        assert k + 13 > len(speeds) or ((1.0 + source.room) * then <= soon.max(axis=0) + 1e-9).all()
    top = np.flatnonzero(speeds[:, 4] > 0.89)
    source.sample(top[len(top) // 2])
    assert source.room == 0.0
    source.sample(15)
    assert source.room > 0.3


def test_a_motion_that_rests_several_times_goes_on_as_gently_as_it_was_planned():
    limits = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=50.0)
    stop = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
    source = PlannedMotion(point_to_point(np.zeros(5), np.full(5, 2.0), limits, 0.01))
    for ticks in (60, 120, 5, 120):  # the third stop begins within the second
        for k in range(ticks):
            source.sample(k)
        assert source.paused(stop, 0.2) is not None
    source.sample(0)
    speed = np.abs(source.played[0].qd)
    assert np.diff(speed, axis=0).max() <= 1.03 * 2.0 * 0.01
