import subprocess
import sys

import numpy as np
import pytest

from so101_motion.common.errors import PlanningError
from so101_motion.planning.timing import online, verify
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.path_geometry import blended_path
from so101_motion.planning.timing.retime import retime
from so101_motion.planning.timing.trajectory import Trajectory

LIMITS = MotionLimits.uniform(velocity=1.5, acceleration=5.0, jerk=100.0)
HARD = MotionLimits.uniform(velocity=1.5, acceleration=7.5, jerk=200.0)
START = np.array([0.1, -0.4, 0.3, 0.0, 1.0])
GOAL = np.array([0.9, -0.6, 0.3, 0.25, -0.2])
DT = 0.01


@pytest.fixture(scope="module")
def tour() -> Trajectory:
    points = np.random.default_rng(3).uniform(-1.0, 1.0, size=(6, 5))
    return retime(blended_path(points, 0.03), LIMITS, DT)


def test_point_to_point_stays_straight_when_joints_have_different_limits() -> None:
    # Velocity binds one joint, acceleration another, jerk a third.
    limits = MotionLimits(
        velocity=np.array([0.3, 9.0, 9.0]),
        acceleration=np.array([50.0, 0.8, 50.0]),
        jerk=np.array([900.0, 900.0, 8.0]),
    )
    trajectory = online.point_to_point(np.zeros(3), np.ones(3), limits, 1e-3)
    assert np.allclose(trajectory.q, trajectory.q[:, :1], atol=1e-13)
    report = verify.check(trajectory, limits)
    assert report.velocity[0] == pytest.approx(1.0, abs=1e-3)
    assert report.jerk[2] == pytest.approx(1.0, abs=1e-3)


def test_a_path_of_no_length_is_one_sample_at_the_goal() -> None:
    for start in (GOAL, GOAL + 1e-12):
        trajectory = online.point_to_point(start, GOAL, LIMITS, DT)
        assert len(trajectory) == 1
        assert trajectory.duration == 0.0
        assert np.array_equal(trajectory.sample(0.0).q, GOAL)


@pytest.mark.parametrize("step", [1e-8, 1e-6, 1e-4])
def test_a_tiny_path_is_short_and_within_limits(step: float) -> None:
    trajectory = online.point_to_point(GOAL, GOAL + step, LIMITS, 1e-3)
    assert np.array_equal(trajectory.q[-1], GOAL + step)
    assert 0.0 < trajectory.duration < 0.1
    assert verify.limit_report(trajectory, LIMITS).worst <= 1.001


def test_the_last_sample_is_at_most_one_step_after_the_end() -> None:
    for trajectory in (
        online.point_to_point(START, GOAL, LIMITS, DT),
        online.from_state(START, 0.5 * np.ones(5), np.zeros(5), GOAL, LIMITS, DT),
        online.stop(START, np.ones(5), np.zeros(5), LIMITS, DT),
    ):
        last = (len(trajectory) - 1) * DT
        assert last - DT < trajectory.duration <= last + 1e-9


def test_too_fast_a_state_brakes_first() -> None:
    qd = np.array([3.0, -2.0, 0.0, 0.0, 1.6])
    trajectory = online.from_state(START, qd, np.zeros(5), GOAL, LIMITS, 1e-3)
    report = verify.limit_report(trajectory, LIMITS)
    assert report.acceleration.max() <= 1.001
    assert report.jerk.max() <= 1.001
    late = np.abs(trajectory.qd[600:])
    assert late.max() <= 1.5 + 1e-9
    assert np.array_equal(trajectory.q[-1], GOAL)


def test_a_stop_takes_as_long_as_its_slowest_joint() -> None:
    qd = np.array([1.5, 0.5, 0.0, -1.0, 0.02])
    trajectory = online.stop(START, qd, np.zeros(5), LIMITS, 1e-3)
    assert trajectory.duration == pytest.approx(1.5 / 5.0 + 5.0 / 100.0)
    assert not trajectory.qd[-1].any()
    assert not trajectory.qdd[-1].any()
    assert np.allclose(trajectory.q[:, 2], START[2])
    slow = trajectory.qd[int(2.0 * np.sqrt(0.02 / 100.0) * 1e3) + 2 :, 4]
    assert np.allclose(slow, 0.0, atol=1e-9)
    assert verify.limit_report(trajectory, LIMITS).worst <= 1.001


def test_a_stop_on_the_path_is_not_much_longer_than_the_shortest(tour: Trajectory) -> None:
    ratios = []
    for t in np.linspace(0.2, tour.duration - 0.2, 60):
        now = tour.sample(t)
        shortest = online.stop(now.q, now.qd, now.qdd, HARD, DT).duration
        ratios.append(online.stop_on_path(tour, t, HARD, DT).duration / shortest)
    assert np.median(ratios) < 1.5
    assert np.max(ratios) < 4.0


def test_a_stop_after_the_end_stays_there(tour: Trajectory) -> None:
    stopped = online.stop_on_path(tour, tour.duration + 1.0, HARD, DT)
    assert len(stopped) == 1
    assert np.array_equal(stopped.q[0], tour.q[-1])


def test_where_the_path_cannot_be_kept_each_joint_stops_for_itself() -> None:
    t = np.arange(301)[:, None] * DT
    weaving = Trajectory(
        dt=DT, q=np.sin(5 * t), qd=5 * np.cos(5 * t), qdd=-25 * np.sin(5 * t), duration=3.0
    )
    feeble = MotionLimits.uniform(velocity=10.0, acceleration=20.0, jerk=500.0, n=1)
    stopped = online.stop_on_path(weaving, 0.3, feeble, DT)
    now = weaving.sample(0.3)
    assert stopped.duration == online.stop(now.q, now.qd, now.qdd, feeble, DT).duration
    assert not stopped.qd[-1].any()


@pytest.mark.parametrize(
    "call",
    [
        lambda bad, dt: online.point_to_point(START, bad, LIMITS, dt),
        lambda bad, dt: online.from_state(START, bad, START, GOAL, LIMITS, dt),
        lambda bad, dt: online.stop(START, START, bad, LIMITS, dt),
    ],
)
@pytest.mark.parametrize(
    ("bad", "dt", "complaint"),
    [
        (np.zeros(4), DT, "5 finite numbers"),
        (np.array([0.0, 0.0, np.nan, 0.0, 0.0]), DT, "5 finite numbers"),
        (np.zeros((5, 1)), DT, "5 finite numbers"),
        (np.zeros(5), 0.0, "dt must be positive"),
        (np.zeros(5), np.inf, "dt must be positive"),
    ],
)
def test_mistakes_are_named(call, bad: np.ndarray, dt: float, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        call(bad, dt)


def test_a_stop_of_other_joints_or_at_no_time_is_a_mistake(tour: Trajectory) -> None:
    fewer = MotionLimits.uniform(velocity=1.0, acceleration=5.0, jerk=50.0, n=4)
    for t, limits, says in ((0.1, fewer, "4 finite numbers"), (np.nan, HARD, "t must be finite")):
        with pytest.raises(ValueError, match=says):
            online.stop_on_path(tour, t, limits, DT)


@pytest.mark.parametrize("acceleration", [50.0, 100.0, 200.0])
def test_a_joint_that_just_reaches_its_largest_acceleration_may_be_anywhere(
    acceleration: float,
) -> None:
    caps = np.radians([90.0, acceleration, 10.0 * acceleration])
    limits = MotionLimits.uniform(velocity=caps[0], acceleration=caps[1], jerk=caps[2])
    step = np.radians(acceleration / 50.0)
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = np.radians(np.round(rng.uniform(-40.0, 40.0, 5)))
        q_goal = q + step * rng.choice([-1.0, 1.0], 5)
        for motion in (
            online.point_to_point(q, q_goal, limits, 0.01),
            online.from_state(q, np.zeros(5), np.zeros(5), q_goal, limits, 0.01),
        ):
            assert motion.duration == pytest.approx(0.4)
            np.testing.assert_array_equal(motion.q[-1], q_goal)


def test_what_ruckig_refuses_is_a_planning_error() -> None:
    absurd = MotionLimits.uniform(velocity=1e-300, acceleration=1e-300, jerk=1e-300, n=1)
    with pytest.raises(PlanningError, match="no motion from this state"):
        online.point_to_point([0.0], [1.0], absurd, DT)


def test_the_control_thread_loads_neither_toppra_nor_scipy() -> None:
    code = """
import sys
import so101_motion.planning.timing.online
print([name for name in ("toppra", "scipy", "matplotlib", "pinocchio") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
