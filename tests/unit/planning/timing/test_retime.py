import numpy as np
import pytest

from so101_motion.common.errors import PlanningError
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.path_geometry import JointPath, blended_path, spline_path
from so101_motion.planning.timing.retime import retime

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
POINTS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [0.4, -0.3, 0.2, 0.5, 0.0],
        [0.9, -0.2, -0.4, 0.2, 0.8],
        [0.2, 0.3, -0.6, -0.5, 0.3],
        [-0.5, 0.1, 0.3, 0.0, -0.4],
    ]
)


def measured(trajectory, limits: MotionLimits = LIMITS) -> np.ndarray:
    """Largest share of the velocity, acceleration and jerk limits, from differences at 1 kHz."""
    rest = np.repeat(trajectory.q[:1], 3, 0), np.repeat(trajectory.q[-1:], 3, 0)
    q = np.concatenate((rest[0], trajectory.q, rest[1]))
    caps = limits.velocity, limits.acceleration, limits.jerk
    return np.array(
        [
            (np.abs(np.diff(q, order, axis=0)) / trajectory.dt**order / cap).max()
            for order, cap in enumerate(caps, start=1)
        ]
    )


@pytest.mark.parametrize("path", [spline_path(POINTS), blended_path(POINTS, 0.03)])
@pytest.mark.parametrize("jerk", [60.0, 500.0])
def test_limits_are_kept_and_used_at_1_khz(path: JointPath, jerk: float) -> None:
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=jerk)
    velocity, acceleration, jerk_share = measured(retime(path, limits, 1e-3), limits)
    assert velocity <= 1.0
    assert acceleration <= 1.001
    assert jerk_share <= 1.001
    assert max(velocity, acceleration, jerk_share) > 0.95


def test_samples_belong_to_one_motion_whatever_their_spacing() -> None:
    path = spline_path(POINTS)
    coarse, fine = retime(path, LIMITS, 0.01), retime(path, LIMITS, 0.001)
    assert coarse.duration == pytest.approx(fine.duration, rel=1e-6)
    inner = slice(0, len(coarse) - 1)
    for name, tolerance in (("q", 1e-6), ("qd", 1e-4), ("qdd", 1e-2)):
        every_tenth = getattr(fine, name)[::10][inner]
        assert np.allclose(getattr(coarse, name)[inner], every_tenth, atol=tolerance)


@pytest.mark.parametrize("cap", [0.05, 0.3, 1.5])
def test_the_tool_never_exceeds_its_speed_cap(cap: float) -> None:
    # A planar arm of two links: joints 0 and 1, 0.2 m each.
    def tool_speed(q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        first, second = q[:, 0], q[:, 0] + q[:, 1]
        turn = qd[:, 0] + qd[:, 1]
        x = -0.2 * np.sin(first) * qd[:, 0] - 0.2 * np.sin(second) * turn
        y = 0.2 * np.cos(first) * qd[:, 0] + 0.2 * np.cos(second) * turn
        return np.hypot(x, y)

    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=cap)
    trajectory = retime(spline_path(POINTS), limits, 1e-3, tool_speed_fn=tool_speed)
    speeds = tool_speed(trajectory.q, trajectory.qd)
    assert speeds.max() <= cap
    if cap < 1.0:
        assert speeds.max() > 0.98 * cap
    assert measured(trajectory, limits).max() <= 1.001


@pytest.mark.parametrize("scale", [1e-7, 1e-5, 1e-3])
def test_a_tiny_path_is_timed_like_any_other(scale: float) -> None:
    trajectory = retime(blended_path(scale * POINTS, 0.01 * scale), LIMITS, 0.01)
    assert np.allclose(trajectory.q[-1], scale * POINTS[-1], atol=1e-15)
    assert trajectory.duration < 0.5
    assert verify.limit_report(trajectory, LIMITS).worst <= 1.001


def test_turning_back_on_the_spot_does_not_stall() -> None:
    path = blended_path([np.zeros(5), POINTS[1], np.zeros(5)], 1e-4)
    assert retime(path, LIMITS, 0.01).duration < 1.2


def test_where_no_speed_is_allowed_there_is_no_motion() -> None:
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=0.1)
    with pytest.raises(PlanningError, match="no speed along this path"):
        retime(
            spline_path(POINTS),
            limits,
            0.01,
            tool_speed_fn=lambda q, qd: np.full(len(q), np.inf),
        )


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"dt": 0.0}, "dt = 0.0"),
        ({"dt": float("nan")}, "positive and finite"),
        ({"deviation": -1.0}, "deviation = -1.0"),
        ({"limits": MotionLimits.uniform(velocity=1, acceleration=1, jerk=1, n=4)}, "4 joints"),
        (
            {"limits": MotionLimits.uniform(velocity=1, acceleration=1, jerk=1, tool_speed=0.1)},
            "needs tool_speed_fn",
        ),
    ],
)
def test_mistakes_are_named(change: dict[str, object], complaint: str) -> None:
    arguments = {"path": spline_path(POINTS), "limits": LIMITS, "dt": 0.01, **change}
    with pytest.raises(ValueError, match=complaint):
        retime(**arguments)


@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_velocity_and_acceleration_are_the_derivatives_of_the_positions(scale: float) -> None:
    h = 1e-5
    motion = retime(spline_path(scale * POINTS), LIMITS, h)
    q, qd, qdd = (each[1:-2] for each in (motion.q, motion.qd, motion.qdd))
    assert np.allclose((q[2:] - q[:-2]) / (2.0 * h), qd[1:-1], atol=1e-5)
    assert np.allclose((qd[2:] - qd[:-2]) / (2.0 * h), qdd[1:-1], atol=2e-2)


def test_half_the_width_is_taken_at_the_ends_where_it_keeps_the_limits() -> None:
    # One joint: full acceleration, top speed if there is room, full braking.
    def lengthened_by(way: float, bang_bang: float, top: float) -> float:
        limits = MotionLimits.uniform(velocity=top, acceleration=10.0, jerk=502.0, n=1)
        motion = retime(blended_path([[0.0], [way]], 0.01), limits, 0.01)
        return (motion.duration - bang_bang) / 0.04

    assert 0.5 <= lengthened_by(2.0, 2.1, top=1.0) < 0.6  # a little slower near the ends
    # Too short for a change of width.
    assert lengthened_by(0.1, 0.2, top=4.0) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("tiny", [2.6e-308, 1e-173, 1e-20])
def test_next_to_nothing_may_be_anywhere_along_a_path(tiny):
    path = spline_path(np.array([[tiny, 0.0], [0.0, 1.0], [0.0, 0.0]]))
    limits = MotionLimits.uniform(velocity=1.0, acceleration=1.0, jerk=20.0, n=2)
    assert verify.limit_report(retime(path, limits, 0.01), limits).worst <= 1.0 + verify.TOLERANCE
