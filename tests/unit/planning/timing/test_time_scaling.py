import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from so101_motion.planning.timing import online, time_scaling, verify
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Trajectory

CRUISE = MotionLimits.uniform(velocity=2.0, acceleration=5.0, jerk=100.0, n=2)


def cruise(speed: float = 1.0, dt: float = 0.01) -> Trajectory:
    """Two joints at constant speed for three seconds."""
    t = np.arange(301)[:, None] * dt
    rate = np.array([speed, -0.5 * speed])
    q, qd = t * rate, np.broadcast_to(rate, (301, 2))
    return Trajectory(dt=dt, q=q, qd=qd, qdd=np.zeros_like(q), duration=3.0)


@pytest.mark.parametrize("shape", [*time_scaling.SHAPES, (0.5, 0.5), (0.05, 0.9)])
def test_a_ramp_falls_from_one_to_zero_and_its_derivatives_belong_together(shape) -> None:
    x = np.linspace(0.0, 1.0, 20001)
    ramp = time_scaling.ramp(shape, x)
    assert ramp.rate[[0, -1]] == pytest.approx([1.0, 0.0], abs=1e-12)
    assert ramp.slope[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert np.all(np.diff(ramp.rate) <= 1e-15)
    for value, derivative in ((ramp.advance, ramp.rate), (ramp.rate, ramp.slope)):
        assert np.allclose(np.gradient(value, x)[1:-1], derivative[1:-1], atol=1e-3)
    steps = np.gradient(ramp.slope, x)
    smooth = np.abs(np.diff(ramp.bend, prepend=ramp.bend[0], append=ramp.bend[-1]))
    inside = (smooth[:-1] == 0.0) & (smooth[1:] == 0.0)
    assert np.allclose(steps[inside][1:-1], ramp.bend[inside][1:-1], atol=1e-6)


def test_stopping_from_cruise_takes_little_more_than_braking_in_full() -> None:
    stopped, _ = time_scaling.shortest_slowdown(cruise(), 0.5, CRUISE, 0.01)
    shortest = 1.0 / 5.0 + 5.0 / 100.0
    assert shortest <= stopped.duration <= 1.35 * shortest


def test_near_the_end_the_motion_is_played_out() -> None:
    stopped, _ = time_scaling.shortest_slowdown(cruise(), 2.95, CRUISE, 0.01)
    assert np.allclose(stopped.q, cruise().q[295:])
    assert stopped.duration == pytest.approx(0.05)


@settings(max_examples=40)
@given(seed=st.integers(0, 2**31), share=st.floats(0.02, 0.98))
def test_a_motion_rests_on_its_path_and_goes_on(seed, share) -> None:
    rng = np.random.default_rng(seed)
    limits = MotionLimits.uniform(velocity=2.0, acceleration=5.0, jerk=100.0)
    stop = MotionLimits.uniform(velocity=2.0, acceleration=8.0, jerk=200.0)
    moved = online.point_to_point(rng.uniform(-1, 1, 5), rng.uniform(-1, 1, 5), limits, 0.01)
    k = round(share * moved.duration / moved.dt)

    paused = time_scaling.shortest_pause(moved, k * moved.dt, stop, 0.2)
    assert paused is not None
    for whole in ("q", "qd", "qdd"):
        np.testing.assert_allclose(
            getattr(paused, whole)[0], getattr(moved, whole)[k], atol=1e-9, err_msg=whole
        )
    np.testing.assert_allclose(paused.q[-1], moved.q[-1], atol=1e-12)
    at_rest = ~paused.qd.any(axis=1)
    assert at_rest.sum() * paused.dt >= 0.2
    off = np.abs(moved.q[:, None] - paused.q[at_rest][None, :1]).max(axis=2).min()
    assert off < 0.01, "it rests on the path"
    report = verify.limit_report(paused, stop)
    assert report.acceleration.max() < 1.03
    assert report.jerk.max() < 1.03
    assert report.velocity.max() < 1.001


def test_a_motion_can_rest_wherever_it_turns_or_stands() -> None:
    limits = MotionLimits.uniform(velocity=0.8, acceleration=1.74, jerk=50.0)
    stop = MotionLimits.uniform(velocity=3.0, acceleration=8.7, jerk=200.0)
    there, back = np.array([0.8, 0.1, 0.0, 0.0, 0.0]), np.array([0.0, 0.2, 0.1, 0.0, 0.0])
    ways = [online.point_to_point(a, b, limits, 0.01) for a, b in [(back, there), (there, back)]]
    q, qd, qdd = (np.concatenate([getattr(w, x) for w in ways]) for x in ("q", "qd", "qdd"))
    moved = Trajectory(dt=0.01, q=q, qd=qd, qdd=qdd, duration=0.01 * (len(q) - 1))
    for k in range(len(moved)):
        assert time_scaling.shortest_pause(moved, 0.01 * k, stop, 0.2) is not None, k


@settings(max_examples=40)
@given(seed=st.integers(0, 2**31), share=st.floats(0.1, 0.99))
def test_a_motion_goes_on_from_rest_as_gently_as_it_began(seed, share) -> None:
    rng = np.random.default_rng(seed)
    limits = MotionLimits.uniform(velocity=2.0, acceleration=5.0, jerk=100.0)
    moved = online.point_to_point(rng.uniform(-1, 1, 5), rng.uniform(-1, 1, 5), limits, 0.01)
    t = share * moved.duration

    resumed = time_scaling.shortest_speedup(moved, t)
    assert resumed is not None
    for derivative in (resumed.qd, resumed.qdd):
        assert not derivative[[0, -1]].any()
    np.testing.assert_allclose(resumed.q[0], moved.sample(t).q, atol=1e-12)
    np.testing.assert_allclose(resumed.q[-1], moved.q[-1], atol=1e-12)
    report = verify.limit_report(resumed, limits)
    assert report.acceleration.max() < 1.03
    assert report.jerk.max() < 1.03
    assert report.velocity.max() < 1.001
