import subprocess
import sys
import threading
from concurrent.futures import wait

import numpy as np
import pytest
from harness.retarget import retarget

from so101_motion.common.compliance import Compliance
from so101_motion.common.errors import Interrupted, MotionError, NotHolding
from so101_motion.common.modes import Mode

Q_GOAL = np.array([0.6, -0.4, 0.5, -0.3, 1.0])


# Manual mode


def test_released_joints_can_be_pushed_and_are_held_where_they_are(sim):
    sim.after(0.0, sim.executor.release())
    assert sim.state.mode is Mode.LIMP
    assert not sim.arm.torque
    sim.arm.push(Q_GOAL, 0.7)
    sim.clock.advance(0.05)
    np.testing.assert_array_equal(sim.state.q, Q_GOAL)
    np.testing.assert_array_equal(sim.state.q_ref, Q_GOAL)
    sim.after(0.0, sim.executor.hold())
    assert sim.state.mode is Mode.HOLDING
    sim.clock.advance(1.0)
    np.testing.assert_array_equal(sim.state.q, Q_GOAL)
    np.testing.assert_array_equal(sim.arm.torques[-1][1], Q_GOAL)


def looks(sim, seconds):
    """How often the arm is looked at meanwhile."""
    times = {sim.state.t}
    for _ in range(round(seconds / 0.01)):
        sim.clock.advance(0.01)
        times.add(sim.state.t)
    return len(times) - 1


def test_a_quiet_arm_is_looked_at_five_times_a_second_until_something_happens(sim):
    assert looks(sim, 1.0) in (19, 20)
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


def test_a_guided_arm_stays_where_it_is_pushed_and_is_held_there(sim):
    sim.after(0.0, sim.executor.guide(Compliance()))
    assert sim.state.mode is Mode.GUIDING
    assert sim.arm.torque
    sim.arm.push(Q_GOAL)
    sim.clock.advance(0.5)
    np.testing.assert_array_equal(sim.state.q, Q_GOAL)
    np.testing.assert_array_equal(sim.state.q_ref, Q_GOAL)
    sim.after(0.0, sim.executor.hold())
    assert sim.state.mode is Mode.HOLDING
    with pytest.raises(RuntimeError, match="driven"):
        sim.arm.push(np.zeros(5))
    sim.after(0.0, sim.executor.guide(Compliance()))
    sim.after(0.0, sim.executor.stop())
    assert sim.state.mode is Mode.HOLDING
    sim.after(5.0, sim.executor.execute(sim.to_goal(np.zeros(5))))


def test_a_limp_arm_is_held_before_it_is_guided_and_can_be_let_go_again(sim):
    sim.after(0.0, sim.executor.release())
    sim.after(0.0, sim.executor.guide(Compliance()))
    assert sim.arm.torque
    sim.after(0.0, sim.executor.release())
    assert sim.state.mode is Mode.LIMP
    assert not sim.arm.torque


def test_a_guided_arm_is_looked_at_in_every_tick(sim):
    sim.after(0.0, sim.executor.guide(Compliance()))
    before = sim.state.t
    sim.clock.advance(0.0101)
    assert sim.state.t == pytest.approx(before + 0.01, abs=1e-3)


def test_what_fails_while_it_is_guided_is_a_fault_and_it_yields_no_more(sim):
    sim.after(0.0, sim.executor.guide(Compliance()))
    sim.arm.disconnect(ConnectionError("the cable"))
    sim.clock.advance(0.1)
    assert sim.state.mode is Mode.FAULT
    sim.arm.reconnect()
    sim.after(0.1, sim.executor.hold())
    assert sim.state.mode is Mode.HOLDING
    with pytest.raises(RuntimeError, match="driven"):
        sim.arm.push(Q_GOAL)


def test_holding_what_is_held_changes_nothing(sim):
    sim.after(0.0, sim.executor.hold())
    move = sim.executor.execute(sim.to_goal(Q_GOAL))
    sim.after(0.1, sim.executor.hold())
    assert len(sim.arm.torques) == 1
    sim.after(5.0, move)


# Jobs on the bus


def test_a_job_runs_with_the_driver_on_the_io_thread(sim):
    def job(driver):
        return driver, threading.current_thread().name

    assert sim.after(0.0, sim.executor.call(job)) == (sim.arm, "so101-io-test")


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


def test_a_failed_job_is_not_a_fault_of_the_arm(sim):
    def job(driver):
        raise LookupError("no such register")

    with pytest.raises(LookupError, match="no such register"):
        sim.after(0.0, sim.executor.call(job))
    assert sim.state.mode is Mode.HOLDING


# Ending


def test_closing_stops_smoothly_ends_the_thread_and_releases_the_driver(sim):
    future = sim.executor.execute(sim.slow_move())
    sim.clock.advance(5.0)
    sim.executor.close()
    assert future.exception(timeout=0).by == "shutdown"
    assert sim.arm.is_closed
    assert sim.arm.torque  # it goes on holding
    qd = np.diff(sim.arm.goals[-30:], axis=0) / sim.dt
    assert np.max(np.abs(np.diff(qd, axis=0))) / sim.dt <= sim.stop_limits.acceleration[0] * 1.01
    np.testing.assert_allclose(qd[-1], 0.0, atol=1e-9)
    sim.executor.close()


def test_after_closing_every_request_ends_with_shutdown(sim):
    sim.executor.close()
    for request in (
        sim.executor.execute(sim.to_goal(Q_GOAL)),
        sim.executor.hold(),
        sim.executor.call(lambda driver: driver.read()),
    ):
        with pytest.raises(Interrupted, match="shutdown"):
            request.result(timeout=0)
    assert sim.executor.stop().result(timeout=0) is None


def test_closing_what_was_never_started_releases_the_driver(make_sim):
    sim = make_sim()
    sim.executor.close()
    assert sim.arm.is_closed


def test_many_threads_may_ask_at_once(sim):
    futures = []

    def ask():
        for _ in range(20):
            futures.append(retarget(sim.executor, Q_GOAL, sim.limits))
            futures.append(sim.executor.hold())
            futures.append(sim.executor.stop())
            _ = sim.state

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    sim.clock.advance(20.0)
    assert not wait(futures, timeout=0).not_done
    assert sim.state.mode is Mode.HOLDING


def test_importing_the_executor_is_cheap():
    script = (
        "import sys, so101_motion.control.executor;"
        "print([m for m in ('pinocchio', 'toppra', 'viam', 'scipy', 'matplotlib')"
        " if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
