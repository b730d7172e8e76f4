import threading

import numpy as np
import pytest

from so101_motion.common.clock import MonotonicClock
from so101_motion.common.errors import MotionError
from so101_motion.common.modes import Mode
from so101_motion.control.executor import Executor
from so101_motion.control.following import Following
from so101_motion.drivers.simulated import SimArm
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits

Q_GOAL = np.array([0.6, -0.4, 0.5, -0.3, 1.0])


def test_a_resting_arm_is_looked_at_twenty_times_a_second_and_told_nothing(sim):
    sim.arm.tape.clear()
    seen = {sim.state.t}
    for _ in range(100):
        sim.clock.advance(0.01)
        seen.add(sim.state.t)
    assert len(seen) == 1 + 20
    assert sim.arm.tape == []


def test_late_ticks_are_left_out_and_counted_and_no_two_goals_are_sent_at_once(
    make_sim, taped_arm, clock
):
    class SlowArm(taped_arm):
        """Every tenth exchange takes 23 ms on the wire."""

        count = 0

        def write(self, q_cmd, q_jaw_cmd, qd_cmd=None, qdd_cmd=None, follows_target=False):
            super().write(q_cmd, q_jaw_cmd, qd_cmd, qdd_cmd, follows_target)
            self.count += 1
            if self.count % 10 == 0:
                clock.wait(clock.now() + 0.023, threading.Event())

    sim = make_sim(SlowArm(clock))
    sim.executor.start()
    sim.arm.tape.clear()
    trajectory = sim.slow_move(3.0)
    t0 = clock.now()
    sim.after(5.0, sim.executor.execute(trajectory))
    gaps = np.diff(sim.arm.times)
    # after a long exchange two ticks are gone and the third comes 3 ms late, then all is on time
    np.testing.assert_allclose(np.unique(np.round(gaps, 6)), [0.007, 0.01, 0.023])
    assert sim.state.late_ticks == np.sum(np.isclose(gaps, 0.023))
    k = np.round((sim.arm.times - t0) / sim.dt - 0.2).astype(int)
    np.testing.assert_array_equal(sim.arm.goals, trajectory.q[np.minimum(k, 300)])


def freezing(taped_arm, clock, pause):
    class FreezingArm(taped_arm):
        """The hundredth exchange takes ``pause`` seconds."""

        def write(self, q_cmd, q_jaw_cmd, qd_cmd=None, qdd_cmd=None, follows_target=False):
            super().write(q_cmd, q_jaw_cmd, qd_cmd, qdd_cmd, follows_target)
            if len(self.tape) == 100:
                clock.wait(clock.now() + pause, threading.Event())

    return FreezingArm(clock)


def test_a_short_pause_is_made_up_for_by_arriving_later(make_sim, taped_arm, clock):
    sim = make_sim(freezing(taped_arm, clock, 0.1))
    sim.executor.start()
    trajectory = sim.slow_move(3.0)
    sim.after(5.0, sim.executor.execute(trajectory))
    goals, expected = np.unique(sim.arm.goals, axis=0), np.unique(trajectory.q, axis=0)
    np.testing.assert_array_equal(goals, expected)  # each setpoint, none twice
    assert sim.state.late_ticks == 9  # 10 periods, and the tick after them comes


def test_after_a_pause_in_which_joints_came_to_rest_they_speed_up_again(make_sim, taped_arm, clock):
    sim = make_sim(freezing(taped_arm, clock, 0.5))
    sim.executor.start()
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
def test_a_pause_around_a_setpoint_is_no_sudden_stop(make_sim, taped_arm, clock, before, after):
    class BusyArm(taped_arm):
        """Somebody else has the processor in mid-motion, just before a goal goes out and after."""

        def write(self, q_cmd, q_jaw_cmd, qd_cmd=None, qdd_cmd=None, follows_target=False):
            is_now = len(self.tape) == 150
            if is_now and before:
                clock.wait(clock.now() + before, threading.Event())
            super().write(q_cmd, q_jaw_cmd, qd_cmd, qdd_cmd, follows_target)
            if is_now and after:
                clock.wait(clock.now() + after, threading.Event())

    sim = make_sim(BusyArm(clock))
    sim.executor.start()
    trajectory = sim.slow_move(3.0)
    assert np.degrees(trajectory.qd.max()) > 100.0
    sim.after(6.0, sim.executor.execute(trajectory))
    np.testing.assert_array_equal(sim.arm.goals[-1], trajectory.q[-1])


@pytest.mark.parametrize("pause", [0.15, 0.9])
def test_a_stop_under_way_in_a_pause_is_over_after_it(make_sim, taped_arm, clock, pause):
    sim = make_sim(freezing(taped_arm, clock, pause))
    sim.executor.start()
    moving = sim.executor.execute(sim.slow_move(3.0))
    clock.advance(0.97)
    stopping = sim.executor.stop()
    sim.after(3.0, stopping)
    assert moving.exception(timeout=0) is not None
    times, goals = sim.arm.times, sim.arm.goals
    gap = int(np.argmax(np.diff(times)))
    assert times[gap + 1] - times[gap] > pause - 0.01
    np.testing.assert_allclose(goals[gap:], goals[gap:][:1].repeat(len(goals) - gap, axis=0))


def test_a_long_standstill_ends_the_motion_without_a_jump(make_sim, taped_arm, clock):
    sim = make_sim(freezing(taped_arm, clock, 2.0))
    sim.executor.start()
    future = sim.executor.execute(sim.slow_move(3.0))
    error = sim.error_after(5.0, future)
    assert isinstance(error, MotionError)
    assert "no setpoint could be sent for 2.00 s" in str(error)
    assert np.max(np.abs(np.diff(sim.arm.goals, axis=0))) < 0.03
    assert sim.state.mode is Mode.HOLDING


def test_a_short_move_in_real_time_arrives():
    clock = MonotonicClock()
    limits = MotionLimits.uniform(velocity=3.0, acceleration=30.0, jerk=600.0)
    q_goal = np.full(5, 0.05)
    with Executor(SimArm(clock), clock, dt=0.01, stop_limits=limits) as executor:
        trajectory = online.point_to_point(np.zeros(5), q_goal, limits, 0.01)
        executor.execute(trajectory).result(timeout=30.0)
        np.testing.assert_allclose(executor.state.q, q_goal, atol=1e-3)


def test_joints_that_follow_targets_speed_up_again_after_a_pause(make_sim, taped_arm, clock):
    sim = make_sim(freezing(taped_arm, clock, 0.3))
    sim.executor.start()
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
