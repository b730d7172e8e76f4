import numpy as np
import pytest

from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.exact_retiming import time_exactly
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point
from so101_motion.planning.timing.path_geometry import blended_path, spline_path
from so101_motion.planning.timing.verify import check, limit_report

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
LAZY = MotionLimits.uniform(velocity=0.7, acceleration=1.0, jerk=15.0)


@pytest.fixture(scope="module")
def tool():
    return ArmChain(RobotModel.load())


def winding(seed, count=6, reach=0.5):
    return spline_path(reach * np.random.default_rng(seed).standard_normal((count, 5)))


def distance_from(path, q):
    s = np.linspace(0.0, path.length, 20001)
    points = path.evaluate(s).q
    return max(np.linalg.norm(points - each, axis=1).min() for each in q)


@pytest.mark.parametrize("limits", [LIMITS, LAZY], ids=["swift", "lazy"])
@pytest.mark.parametrize("seed", range(6))
def test_the_motion_keeps_every_limit_and_the_path(limits, seed):
    path = winding(seed)
    motion = time_exactly(path, limits, 0.01)
    check(motion, limits)
    assert limit_report(motion, limits).worst > 0.9  # and uses them somewhere
    assert motion.q[0] == pytest.approx(path.evaluate([0.0]).q[0], abs=1e-12)
    assert motion.q[-1] == pytest.approx(path.evaluate([path.length]).q[0], abs=1e-12)
    assert not np.any(motion.qd[[0, -1]])
    assert distance_from(path, motion.q[::7]) < 1e-3  # as fine as the points compared with


@pytest.mark.parametrize("dt", [0.001, 0.004, 0.02])
def test_stated_velocities_are_those_of_the_positions(dt):
    motion = time_exactly(winding(1), LIMITS, dt)
    middle = (motion.q[2:] - motion.q[:-2]) / (2.0 * dt)
    assert np.abs(middle - motion.qd[1:-1]).max() < 500.0 * dt**2
    middle = (motion.qd[2:] - motion.qd[:-2]) / (2.0 * dt)
    assert np.abs(middle - motion.qdd[1:-1]).max() < 500.0 * dt + 1e-6


def test_a_straight_path_is_nearly_as_fast_as_can_be():
    ends = np.array([[0.0] * 5, [0.8, -0.3, 0.5, 0.1, 0.0]])
    motion = time_exactly(spline_path(ends), LIMITS, 0.01)
    shortest = point_to_point(*ends, LIMITS, 0.01)
    assert motion.duration < 1.05 * shortest.duration


def test_a_longer_time_is_never_needed_for_looser_limits():
    path = winding(3)
    durations = [
        time_exactly(
            path, MotionLimits.uniform(velocity=v, acceleration=4.0 * v, jerk=100.0 * v), 0.01
        ).duration
        for v in (0.5, 1.0, 2.0)
    ]
    assert durations == sorted(durations, reverse=True)


def test_the_tool_keeps_its_cap_and_moves_at_it(tool):
    path = winding(2, reach=0.3)
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=0.05)
    motion = time_exactly(path, limits, 0.01, tool_speed_fn=tool.speeds)
    speed = tool.speeds(motion.q, motion.qd)
    assert speed.max() <= 0.05 * 1.001
    assert np.median(speed) > 0.05 * 0.97


def test_a_cap_on_the_tool_needs_to_know_its_speed():
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=0.05)
    with pytest.raises(ValueError, match="needs tool_speed_fn"):
        time_exactly(winding(0), limits, 0.01)


@pytest.mark.parametrize("length", [1e-5, 1e-3, 0.02])
def test_short_motions_keep_their_limits_too(length):
    path = spline_path(np.array([[0.0] * 5, [length, 0.0, 0.0, -length, 0.0]]))
    motion = time_exactly(path, LIMITS, 0.01)
    check(motion, LIMITS)
    assert motion.q[-1] == pytest.approx([length, 0.0, 0.0, -length, 0.0], abs=1e-12)


def test_jumps_of_curvature_are_passed_within_the_jerk_limit_of_the_samples():
    corners = np.array([[0.0] * 5, [0.5, 0.2, 0.0, 0.0, 0.0], [0.6, 0.8, -0.3, 0.0, 0.1]])
    motion = time_exactly(blended_path(corners, 0.1), LIMITS, 0.01)
    check(motion, LIMITS)
