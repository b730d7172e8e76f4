"""Laws of every trajectory, whichever planner made it."""

from dataclasses import dataclass

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from so101_motion.arm.joint_caps import JointCaps
from so101_motion.common.attributes import ACCELERATION_RANGE_DEG, SPEED_RANGE_DEG
from so101_motion.common.units import to_rad
from so101_motion.planning.timing import online, verify
from so101_motion.planning.timing.exact_retiming import time_exactly
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.path_geometry import JointPath, blended_path, spline_path
from so101_motion.planning.timing.retime import retime
from so101_motion.planning.timing.trajectory import Trajectory

FINE = 1e-3


def vectors(n: int, low: float, high: float) -> st.SearchStrategy[np.ndarray]:
    return st.lists(st.floats(low, high), min_size=n, max_size=n).map(np.array)


@st.composite
def limits_for(draw, n: int) -> MotionLimits:
    """Limits from a sleepy to a lively arm, equal for all joints or not."""
    ranges = {"velocity": (0.3, 6.0), "acceleration": (1.0, 40.0), "jerk": (20.0, 2000.0)}
    if draw(st.booleans()):
        return MotionLimits.uniform(n=n, **{k: draw(st.floats(*v)) for k, v in ranges.items()})
    return MotionLimits(**{k: draw(vectors(n, *v)) for k, v in ranges.items()})


@dataclass(frozen=True)
class Request:
    """A path, its ends, and the limits for it."""

    path: JointPath
    start: np.ndarray
    goal: np.ndarray
    limits: MotionLimits


@st.composite
def requests(draw) -> Request:
    n = draw(st.sampled_from([1, 2, 5]))
    points = np.array(draw(st.lists(vectors(n, -2.0, 2.0), min_size=2, max_size=6)))
    assume(np.abs(points - points[0]).max() > 1e-3)
    assume(np.abs(np.diff(points, axis=0)).max(axis=1).min() > 1e-3)  # nearer ones count as one
    tolerance = draw(st.floats(1e-3, 0.1))
    make = draw(st.sampled_from([spline_path, lambda p: blended_path(p, tolerance)]))
    return Request(make(points), points[0], points[-1], draw(limits_for(n)))


@dataclass(frozen=True)
class Moving:
    """A state inside its limits, from which they can be kept."""

    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    limits: MotionLimits


@st.composite
def states(draw) -> Moving:
    n = draw(st.sampled_from([1, 5]))
    limits = draw(limits_for(n))
    q, share_v, share_a = (draw(vectors(n, -1.0, 1.0)) for _ in range(3))
    qd, qdd = share_v * limits.velocity, share_a * limits.acceleration
    # Taking an acceleration back takes time, in which the speed still grows.
    peak = qd + qdd * np.abs(qdd) / (2.0 * limits.jerk)
    return Moving(q, qd, np.where(np.abs(peak) > limits.velocity, 0.0, qdd), limits)


def assert_at_rest_at(trajectory: Trajectory, q: np.ndarray) -> None:
    assert np.allclose(trajectory.q[-1], q, rtol=0.0, atol=1e-12)
    assert not trajectory.qd[-1].any()
    assert not trajectory.qdd[-1].any()


def assert_within(trajectory: Trajectory, limits: MotionLimits) -> None:
    report = verify.limit_report(trajectory, limits)
    assert report.velocity.max() <= 1.0 + 1e-6
    assert report.worst <= 1.0 + verify.TOLERANCE


def assert_continuous(trajectory: Trajectory) -> None:
    """No jump across a sample: both sides of it agree to what an instant of motion explains."""
    inner = trajectory.t[1:-1]
    before, after = trajectory.at(inner - 1e-7), trajectory.at(inner + 1e-7)
    for left, right, rate in zip(before, after, (50.0, 500.0, 1e5), strict=True):
        assert np.allclose(left, right, rtol=0.0, atol=1e-7 * rate)


@settings(max_examples=14)
@given(requests())
def test_a_timed_path_goes_from_end_to_end_at_rest_within_every_limit(request: Request) -> None:
    trajectory = retime(request.path, request.limits, FINE)
    assert np.allclose(trajectory.q[0], request.start, rtol=0.0, atol=1e-12)
    assert not trajectory.qd[0].any()
    assert_at_rest_at(trajectory, request.goal)
    assert_within(trajectory, request.limits)
    assert_continuous(trajectory)


@settings(max_examples=12)
@given(requests(), st.floats(1.05, 3.0), st.sampled_from([retime, time_exactly]))
def test_a_timed_path_is_never_longer_when_limits_are_loosened(
    request: Request, factor: float, timed
) -> None:
    limits = request.limits
    tighter = MotionLimits(
        velocity=limits.velocity / factor,
        acceleration=limits.acceleration / factor,
        jerk=limits.jerk / factor,
    )
    strict, loose = (timed(request.path, these, 0.01).duration for these in (tighter, limits))
    assert loose <= 1.01 * strict


@settings(max_examples=10)
@given(requests())
def test_a_timed_path_leaves_its_path_by_no_more_than_the_deviation(request: Request) -> None:
    trajectory = retime(request.path, request.limits, 0.02, deviation=0.01)
    dense = request.path.evaluate(np.linspace(0.0, request.path.length, 4000)).q
    gap = request.path.length / 4000
    for q in trajectory.q[:: max(1, len(trajectory) // 50)]:
        assert np.abs(dense - q).max(axis=1).min() <= 0.01 + 2.0 * gap


@st.composite
def motions_of_an_arm(draw) -> tuple[Trajectory, MotionLimits, float]:
    """A motion under an arm's own caps, and the share of jerk claimed between its setpoints."""
    speed = draw(st.floats(*map(to_rad, SPEED_RANGE_DEG)))
    acceleration = draw(st.floats(*map(to_rad, ACCELERATION_RANGE_DEG)))
    limits = JointCaps(speed=speed, acceleration=acceleration).limits
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    points = random.uniform(-1.5, 1.5, (random.integers(2, 7), 5))
    kind = draw(st.sampled_from(["straight", "spline", "rounded", "exact"]))
    if kind == "straight":
        return online.point_to_point(points[0], points[-1], limits, 0.01), limits, 1.35
    if kind == "exact":
        near = random.uniform(-0.05, 0.05, (30, 5)).cumsum(axis=0)
        return time_exactly(spline_path(near), limits, 0.01), limits, 1.35
    path = spline_path(points) if kind == "spline" else blended_path(points, 0.1)
    return retime(path, limits, 0.01), limits, 1.25


@settings(max_examples=20)
@given(motions_of_an_arm())
def test_between_the_setpoints_of_an_arm_the_caps_are_kept_as_far_as_is_claimed(made) -> None:
    trajectory, limits, jerk = made
    assert_within(trajectory, limits)
    q, qd, qdd = trajectory.at(np.arange(10 * (len(trajectory) - 1) + 1) * FINE)
    assert np.all(np.abs(qd) <= 1.001 * limits.velocity)
    assert np.all(np.abs(qdd) <= 1.02 * limits.acceleration)
    at_rest = np.concatenate([q[:1], q[:1], q[:1], q, q[-1:], q[-1:], q[-1:]])
    assert np.all(np.abs(np.diff(at_rest, 3, axis=0)) <= jerk * limits.jerk * FINE**3)


@settings(max_examples=16)
@given(states(), st.data())
def test_point_to_point_keeps_every_limit_and_to_the_line(moving: Moving, data) -> None:
    goal = data.draw(vectors(len(moving.q), -1.0, 1.0))
    trajectory = online.point_to_point(moving.q, goal, moving.limits, FINE)
    assert_at_rest_at(trajectory, goal)
    assert_within(trajectory, moving.limits)
    way = goal - moving.q
    i = int(np.argmax(np.abs(way)))
    if way[i] != 0.0:
        done = (trajectory.q[:, i] - moving.q[i]) / way[i]
        assert np.allclose(trajectory.q, moving.q + np.outer(done, way), rtol=0.0, atol=1e-9)
        assert np.all(np.diff(done) >= -1e-9)


@settings(max_examples=10)
@given(states(), st.data())
def test_a_new_goal_is_reached_from_any_state_within_every_limit(moving: Moving, data) -> None:
    goal = data.draw(vectors(len(moving.q), -1.0, 1.0))
    trajectory = online.from_state(moving.q, moving.qd, moving.qdd, goal, moving.limits, FINE)
    assert np.allclose(trajectory.q[0], moving.q, rtol=0.0, atol=1e-12)
    assert np.allclose(trajectory.qd[0], moving.qd, rtol=0.0, atol=1e-9)
    assert_at_rest_at(trajectory, goal)
    assert_within(trajectory, moving.limits)
    assert_continuous(trajectory)


@settings(max_examples=20)
@given(states())
def test_a_stop_comes_to_rest_from_any_state_within_every_limit(moving: Moving) -> None:
    trajectory = online.stop(moving.q, moving.qd, moving.qdd, moving.limits, FINE)
    assert np.allclose(trajectory.qd[0], moving.qd, rtol=0.0, atol=1e-9)
    assert_at_rest_at(trajectory, trajectory.q[-1])
    assert_within(trajectory, moving.limits)


@settings(max_examples=15)
@given(requests(), st.floats(0.0, 1.05))
def test_a_stop_on_the_path_visits_only_what_the_motion_would_have(
    request: Request, share: float
) -> None:
    motion = retime(request.path, request.limits, 0.01)
    harder = MotionLimits(
        velocity=request.limits.velocity,
        acceleration=1.2 * request.limits.acceleration,
        jerk=1.5 * request.limits.jerk,
    )
    t = share * motion.duration
    stopped = online.stop_on_path(motion, t, harder, 0.01)
    assert_at_rest_at(stopped, stopped.q[-1])
    now = motion.sample(t)
    assert np.allclose(stopped.q[0], now.q, rtol=0.0, atol=1e-9)
    assert np.allclose(stopped.qd[0], now.qd, rtol=0.0, atol=1e-9)
    assert np.allclose(stopped.qdd[0], now.qdd, rtol=0.0, atol=1e-6)
    report = verify.limit_report(stopped, harder)
    assert report.velocity.max() <= 1.001
    assert report.acceleration.max() <= 1.01
    assert report.jerk.max() <= 1.02
    # Follow the motion's own clock along: it never runs backwards and never faster than true.
    tau = t
    for q in stopped.q:
        ahead = tau + np.linspace(0.0, 0.0101, 400)
        distances = np.abs(motion.at(ahead)[0] - q).max(axis=1)
        assert distances.min() <= 6.0 * 0.0101 / 400
        tau = float(ahead[np.argmin(distances)])
