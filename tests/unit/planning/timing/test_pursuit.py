"""Joints that follow targets that move."""

import numpy as np
import pytest

from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.pursuit import Pursuit
from so101_motion.planning.timing.trajectory import Setpoint

CAPS = [
    MotionLimits.uniform(velocity=2.0, acceleration=8.0, jerk=150.0),
    MotionLimits.uniform(velocity=1.0, acceleration=3.0, jerk=40.0),
]


def test_what_was_asked_before_changes_nothing():
    rng, kept = np.random.default_rng(3), Pursuit(5, 0.01)
    for _ in range(300):
        q, qd, qdd, target = rng.normal(0.0, 0.5, (4, 5))
        rate = rng.choice([0.0, 0.3], 5) if rng.random() < 0.5 else np.zeros(5)
        arrival = str(rng.choice(["each", "together", "straight"]))
        args = Setpoint(q=q, qd=qd, qdd=qdd), target, rate, CAPS[rng.integers(len(CAPS))]
        here = kept.towards(*args, arrival=arrival)
        there = Pursuit(5, 0.01).towards(*args, arrival=arrival)
        for name in ("q", "qd", "qdd"):
            assert np.array_equal(getattr(here, name), getattr(there, name)), name


def test_limits_of_another_number_of_joints_are_refused():
    with pytest.raises(ValueError, match="expected 3 joints"):
        Pursuit(3, 0.01).towards(Setpoint.at_rest(np.zeros(5)), np.ones(5), np.zeros(5), CAPS[0])


# Beside a target whose acceleration is known


def swaying(t):
    """A joint that sways by 0.25 rad at 1 Hz, and others that stay; at ``t`` [s]."""
    w, way = 2.0 * np.pi, np.array([0.25, 0.0, 0.0])
    s, c = np.sin(w * t), np.cos(w * t)
    return Setpoint(q=way * s, qd=w * way * c, qdd=-w * w * way * s)


def followed(now, caps, seconds, noise=0.0):
    """The setpoints of joints that follow ``swaying``."""
    rng, setpoints, pursuit = np.random.default_rng(1), [now], Pursuit(3, 0.01)
    for k in range(1, round(seconds / 0.01)):
        there = swaying(0.01 * k)
        there = Setpoint(q=there.q + noise * rng.standard_normal(3), qd=there.qd, qdd=there.qdd)
        setpoints.append(pursuit.alongside(setpoints[-1], there, caps)[0])
    return setpoints


def test_a_joint_beside_its_target_accelerates_as_it_does():
    caps = MotionLimits.uniform(velocity=4.0, acceleration=25.0, jerk=500.0, n=3)
    setpoints = followed(swaying(0.0), caps, 2.0)
    for k, now in enumerate(setpoints):
        assert now.q == pytest.approx(swaying(0.01 * k).q, abs=2e-3)
        assert now.qdd == pytest.approx(swaying(0.01 * k).qdd, abs=2.0)


def test_that_a_joint_will_brake_is_known_before_it_does():
    caps = MotionLimits.uniform(velocity=5.0, acceleration=25.0, jerk=500.0, n=1)
    now, told, true = Setpoint.at_rest(np.zeros(1)), [], []
    there = Setpoint.at_rest(np.array([1.0]))
    pursuit = Pursuit(1, 0.01)
    for _ in range(25):
        now, soon = pursuit.alongside(now, there, caps)
        told.append(soon[0])
        true.append(now.qdd[0])
    mean = np.convolve(true, np.full(5, 0.2), "valid")[1:]
    assert told[: len(mean)] == pytest.approx(mean, abs=4.0)
    assert np.argmax(np.array(told) < 0.0) <= np.argmax(np.array(true) < 0.0) - 2


def test_what_is_off_dies_down_without_the_jerk_of_the_fastest_motion():
    caps = MotionLimits.uniform(velocity=4.0, acceleration=25.0, jerk=500.0, n=3)
    setpoints = followed(swaying(0.0), caps, 2.0, noise=5e-4)
    jerk = np.diff([now.qdd for now in setpoints], axis=0) / 0.01
    assert np.sqrt(np.mean(np.square(jerk))) < 150.0


def test_a_joint_that_is_far_keeps_its_caps_and_comes_beside_its_target():
    caps = MotionLimits.uniform(velocity=5.0, acceleration=25.0, jerk=500.0, n=3)
    setpoints = followed(Setpoint.at_rest(np.array([-1.0, 0.6, 0.01])), caps, 2.0)
    q = np.array([now.q for now in setpoints])
    qd, qdd = np.diff(q, axis=0) / 0.01, np.diff(q, 2, axis=0) / 0.01**2
    assert np.abs(qd).max() <= 5.0 + 1e-9
    assert np.abs(qdd).max() <= 25.0 + 1e-6
    assert np.abs(np.diff(qdd, axis=0)).max() / 0.01 <= 500.0 + 1e-3
    assert setpoints[-1].q == pytest.approx(swaying(1.99).q, abs=2e-3)
