import numpy as np
import pytest
from harness.retarget import retarget

from so101_motion.common.errors import Interrupted, MotionError
from so101_motion.common.modes import Mode
from so101_motion.control.streamed_trajectory import TimedPoint

TRAVEL = np.array([0.9, -0.6, 0.7, 0.4, -1.1])


def batches(duration=2.0, period=0.02, size=10):
    """A smooth motion from zero to ``TRAVEL``, ten points a batch."""
    t = np.arange(round(duration / period) + 1) * period
    u = t / duration
    q = (10 * u**3 - 15 * u**4 + 6 * u**5)[:, None] * TRAVEL
    all_points = [TimedPoint(t=float(at), q=where) for at, where in zip(t, q, strict=True)]
    return [all_points[k : k + size] for k in range(0, len(all_points), size)]


def assert_within_limits(sim, limits):
    q = sim.arm.goals[1:]
    for limit, order in (("velocity", 1), ("acceleration", 2), ("jerk", 3)):
        figure = np.max(np.abs(np.diff(q, order, axis=0))) / sim.dt**order
        assert figure <= getattr(limits, limit)[0] * 1.02, limit


def test_points_arriving_while_the_arm_moves_are_followed_to_the_end(sim):
    stream = sim.stream()
    todo = batches()
    stream.push(todo[0])
    for batch in todo[1:]:
        stream.push(batch)  # one batch ahead of what is played
        sim.clock.advance(0.2)
        assert sim.state.mode is Mode.MOVING
    sim.after(2.0, stream.finish())
    np.testing.assert_allclose(sim.state.q, TRAVEL, atol=1e-4)
    assert sim.state.mode is Mode.HOLDING
    assert_within_limits(sim, sim.limits)


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
    assert_within_limits(sim, sim.stop_limits)
    with pytest.raises(MotionError, match="ran dry"):
        stream.push(todo[5])


def test_a_stream_can_be_stopped(sim):
    stream = sim.stream()
    for batch in batches():
        stream.push(batch)
    sim.clock.advance(1.0)
    sim.after(2.0, sim.executor.stop())
    assert stream.future.exception(timeout=0).by == "stop"
    assert_within_limits(sim, sim.stop_limits)


def test_a_stream_can_be_superseded_without_stopping(sim):
    stream = sim.stream()
    for batch in batches():
        stream.push(batch)
    sim.clock.advance(1.0)
    sim.after(4.0, retarget(sim.executor, np.zeros(5), sim.limits))
    assert stream.future.exception(timeout=0).by == "a newer motion"
    np.testing.assert_allclose(sim.state.q, np.zeros(5), atol=1e-4)


def test_a_stream_that_ends_at_speed_comes_to_rest_at_its_last_point(sim):
    stream = sim.stream()
    t = np.arange(0.0, 1.01, 0.02)
    q = (0.5 * np.minimum(t, 0.4) ** 2 / 0.4 + np.maximum(t - 0.4, 0.0))[:, None] * np.ones(5)
    stream.push([TimedPoint(t=float(at), q=where) for at, where in zip(t, q, strict=True)])
    sim.after(4.0, stream.finish())
    np.testing.assert_allclose(sim.state.q, q[-1], atol=1e-4)
    assert_within_limits(sim, sim.limits)
