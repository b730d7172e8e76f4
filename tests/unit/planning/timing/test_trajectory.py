import pickle

import numpy as np
import pytest

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
