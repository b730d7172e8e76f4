import pickle

import numpy as np
import pytest

from so101_motion.common.errors import OutsideLimits
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Trajectory

DT = 0.01
COEFFICIENTS = np.array(
    [[0.1, -0.3], [0.5, 0.2], [-0.7, 0.9], [2.0, -3.0], [1.5, 4.0], [-2.0, 1.0]]
)


def quintic(t: np.ndarray) -> list[np.ndarray]:
    """Position, velocity and acceleration of one polynomial of fifth degree in each joint."""
    rows = [np.polynomial.polynomial.polyder(COEFFICIENTS, order) for order in range(3)]
    return [np.polynomial.polynomial.polyval(t, row).T for row in rows]


@pytest.fixture
def trajectory() -> Trajectory:
    q, qd, qdd = quintic(np.arange(41) * DT)
    return Trajectory(dt=DT, q=q, qd=qd, qdd=qdd, duration=0.4)


def test_a_sample_time_gives_exactly_the_stored_sample(trajectory: Trajectory) -> None:
    for k in (0, 7, 40):
        setpoint = trajectory.sample(k * DT)
        assert np.array_equal(setpoint.q, trajectory.q[k])
        assert np.array_equal(setpoint.qd, trajectory.qd[k])
        assert np.array_equal(setpoint.qdd, trajectory.qdd[k])


def test_times_outside_give_the_first_and_the_last_sample(trajectory: Trajectory) -> None:
    assert np.array_equal(trajectory.sample(-3.0).q, trajectory.q[0])
    assert np.array_equal(trajectory.sample(3.0).qd, trajectory.qd[-1])
    q, qd, qdd = trajectory.at([-1.0, 9.0])
    assert np.allclose(q, trajectory.q[[0, -1]], atol=1e-15)
    assert np.allclose(qd, trajectory.qd[[0, -1]], atol=1e-12)
    assert np.allclose(qdd, trajectory.qdd[[0, -1]], atol=1e-10)


def test_between_samples_a_quintic_motion_is_reproduced(trajectory: Trajectory) -> None:
    t = np.random.default_rng(1).uniform(0.0, 0.4, 200)
    for found, true, tolerance in zip(
        trajectory.at(t), quintic(t), (1e-13, 1e-11, 1e-9), strict=True
    ):
        assert np.allclose(found, true, rtol=0.0, atol=tolerance)


def test_a_single_sample_stands_still() -> None:
    zero = np.zeros((1, 3))
    trajectory = Trajectory(dt=DT, q=zero + 0.5, qd=zero, qdd=zero, duration=0.0)
    for t in (-1.0, 0.0, 0.004, 2.0):
        assert np.array_equal(trajectory.sample(t).q, [0.5, 0.5, 0.5])
        assert not trajectory.sample(t).qd.any()
    assert trajectory.at([0.0, 1.0])[0].shape == (2, 3)


def test_its_arrays_cannot_be_changed_and_must_have_one_shape(trajectory: Trajectory) -> None:
    with pytest.raises(ValueError, match="read-only"):
        trajectory.q[0] = 0.0
    with pytest.raises(ValueError, match="shape"):
        Trajectory(dt=DT, q=np.zeros((3, 2)), qd=np.zeros((2, 2)), qdd=np.zeros((3, 2)), duration=0)


def test_it_crosses_a_process_boundary(trajectory: Trajectory) -> None:
    copy = pickle.loads(pickle.dumps(trajectory))
    assert np.array_equal(copy.q, trajectory.q)
    assert (copy.dt, copy.duration, copy.n, len(copy)) == (DT, 0.4, 2, 41)
    assert copy.t[-1] == pytest.approx(0.4)


# Verifying


LIMITS = MotionLimits(
    velocity=np.array([1.0, 2.0, 3.0, 4.0, 5.0]),
    acceleration=np.full(5, 20.0),
    jerk=np.full(5, 400.0),
)


def swing(amplitude: np.ndarray, rate: float, dt: float = 1e-3) -> Trajectory:
    """``amplitude (1 - cos(rate t))`` over one period: peak speed ``amplitude rate`` and so on."""
    t = np.arange(round(2.0 * np.pi / rate / dt) + 1)[:, None] * dt
    return Trajectory(
        dt=dt,
        q=amplitude * (1.0 - np.cos(rate * t)),
        qd=amplitude * rate * np.sin(rate * t),
        qdd=amplitude * rate**2 * np.cos(rate * t),
        duration=float(t[-1, 0]),
    )


def test_shares_of_the_limits_are_those_of_the_known_motion() -> None:
    amplitude = np.array([0.1, 0.2, -0.3, 0.0, 0.05])
    report = verify.limit_report(swing(amplitude, 6.0), LIMITS)
    size = np.abs(amplitude)
    assert np.allclose(report.velocity, size * 6.0 / LIMITS.velocity, rtol=1e-4)
    # It starts and ends with a jump of acceleration, so only those two are known.
    assert np.allclose(report.acceleration, size * 36.0 / LIMITS.acceleration, rtol=1e-2)
    assert report.worst == max(report.velocity.max(), report.acceleration.max(), report.jerk.max())


def test_stated_velocities_and_those_of_the_positions_both_count() -> None:
    q = np.linspace(0.0, 0.1, 101)[:, None]
    zero = np.zeros_like(q)
    limits = MotionLimits.uniform(velocity=0.05, acceleration=1e6, jerk=1e9, n=1)
    lying = Trajectory(dt=0.01, q=q, qd=zero, qdd=zero, duration=1.0)
    assert verify.limit_report(lying, limits).velocity[0] == pytest.approx(2.0)
    boasting = Trajectory(dt=0.01, q=zero, qd=zero + 0.2, qdd=zero, duration=1.0)
    assert verify.limit_report(boasting, limits).velocity[0] == pytest.approx(4.0)


def test_a_start_in_motion_is_not_taken_for_a_jump() -> None:
    t = np.arange(101)[:, None] * 0.01
    limits = MotionLimits.uniform(velocity=2.0, acceleration=1.0, jerk=1.0, n=1)
    q, qd, qdd = t - t**3 / 3.0, 1.0 - t**2, -2.0 * t
    report = verify.limit_report(Trajectory(dt=0.01, q=q, qd=qd, qdd=qdd, duration=1.0), limits)
    assert report.velocity[0] == pytest.approx(0.5, rel=1e-2)


def test_position_limits_are_measured_on_both_sides() -> None:
    trajectory = swing(np.array([0.1, -0.1, 0.0, 0.0, 0.0]), 6.0)
    report = verify.limit_report(
        trajectory, LIMITS, lower=np.full(5, -0.15), upper=np.full(5, 0.15)
    )
    assert np.allclose(report.outside, [0.05, 0.05, 0.0, 0.0, 0.0], atol=1e-6)


def test_a_joint_that_is_too_fast_is_named() -> None:
    with pytest.raises(OutsideLimits, match=r"elbow_flex would need 206.*deg/s of speed") as caught:
        verify.check(swing(np.array([0.0, 0.0, 0.3, 0.0, 0.0]), 12.0), LIMITS)
    assert caught.value.joint == "elbow_flex"
    assert caught.value.value == pytest.approx(3.6, rel=1e-4)
    assert (caught.value.lower, caught.value.upper) == (-3.0, 3.0)
    assert "20 % over" in str(caught.value)


def test_a_joint_that_leaves_its_range_is_named() -> None:
    trajectory = swing(np.array([0.0, 0.0, 0.0, -0.01, 0.0]), 6.0)
    with pytest.raises(OutsideLimits, match=r"wrist_flex would go to -1\.15 deg") as caught:
        verify.check(trajectory, LIMITS, lower=np.full(5, -0.015), upper=np.full(5, 0.5))
    assert caught.value.value == pytest.approx(-0.02, rel=1e-4)


@pytest.mark.parametrize("quantity", ["acceleration", "jerk"])
def test_too_much_acceleration_or_jerk_is_refused(quantity: str) -> None:
    generous = {"velocity": 1e3, "acceleration": 1e6, "jerk": 1e9}
    limits = MotionLimits.uniform(**{**generous, quantity: 0.01}, n=2)
    with pytest.raises(OutsideLimits, match=f"joint 2 would need .* of {quantity}"):
        verify.check(swing(np.array([0.0, 0.1]), 6.0), limits)


def test_a_single_sample_uses_nothing() -> None:
    zero = np.zeros((1, 5))
    report = verify.check(Trajectory(dt=0.01, q=zero, qd=zero, qdd=zero, duration=0.0), LIMITS)
    assert report.worst == 0.0
    assert report.stretch == 0.0


@pytest.mark.parametrize("amplitude", [0.05, 0.5, 5.0])
def test_stretch_says_how_much_slower_the_same_motion_must_be(amplitude: float) -> None:
    def reach(duration: float) -> Trajectory:
        x = np.linspace(0.0, 1.0, 20001)[:, None]
        q = amplitude * x**3 * (10.0 + x * (6.0 * x - 15.0))
        dt = duration / 20000
        still = np.zeros_like(q)
        return Trajectory(dt=dt, q=q, qd=still, qdd=still, duration=duration)

    limits = MotionLimits.uniform(velocity=2.0, acceleration=10.0, jerk=200.0, n=1)
    report = verify.limit_report(reach(0.3), limits)
    slower = verify.limit_report(reach(0.3 * report.stretch), limits)
    assert slower.worst == pytest.approx(1.0, rel=1e-3)


def test_limits_for_other_joints_are_a_mistake() -> None:
    with pytest.raises(ValueError, match="5 joints, a motion of 2"):
        verify.limit_report(swing(np.array([0.0, 0.1]), 6.0), LIMITS)
