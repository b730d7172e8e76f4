import math
import pickle

import numpy as np
import pytest
from harness.setpoints import shares
from hypothesis import given, settings
from hypothesis import strategies as st

from so101_motion.common.errors import OutsideLimits, PlanningError
from so101_motion.planning.timing import online, time_scaling, verify
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.path_geometry import blended_path
from so101_motion.planning.timing.pursuit import Pursuit
from so101_motion.planning.timing.retime import retime
from so101_motion.planning.timing.stop_paths import StopPaths
from so101_motion.planning.timing.trajectory import Setpoint, Trajectory

LIMITS = MotionLimits.uniform(velocity=1.5, acceleration=5.0, jerk=100.0)
HARD = MotionLimits.uniform(velocity=1.5, acceleration=7.5, jerk=200.0)
START = np.array([0.1, -0.4, 0.3, 0.0, 1.0])
GOAL = np.array([0.9, -0.6, 0.3, 0.25, -0.2])
DT = 0.01


@pytest.fixture(scope="module")
def tour() -> Trajectory:
    points = np.random.default_rng(3).uniform(-1.0, 1.0, size=(6, 5))
    return retime(blended_path(points, 0.03), LIMITS, DT)


UNEQUAL = MotionLimits(
    velocity=[1.0, 2.0, 3.0], acceleration=[10.0, 20.0, 30.0], jerk=[300.0, 100.0, 200.0],
    tool_speed=0.5,
)  # fmt: skip


def caps_of(limits: MotionLimits) -> list[list[float] | float | None]:
    found = [getattr(limits, name).tolist() for name in ("velocity", "acceleration", "jerk")]
    return [*found, limits.tool_speed]


def test_limits_are_lowered_and_eased_joint_by_joint_and_never_raised() -> None:
    lowered = UNEQUAL.lowered_to(2.0, [5.0, 50.0, 25.0])
    assert caps_of(lowered) == [[1, 2, 2], [5, 20, 25], [300, 100, 200], 0.5]
    assert caps_of(UNEQUAL.eased(0.5)) == [[0.5, 1, 1.5], [5, 10, 15], [300, 100, 200], 0.5]
    assert UNEQUAL.eased(1.0) is UNEQUAL.eased(1.5) is UNEQUAL
    assert caps_of(UNEQUAL.for_one()) == [[1], [10], [100], None]


def test_limits_ease_over_to_others_and_stay_there() -> None:
    faster = MotionLimits.uniform(velocity=5.0, acceleration=50.0, jerk=500.0, n=3)
    assert caps_of(UNEQUAL.eased_to(faster, -1.0))[:3] == caps_of(UNEQUAL)[:3]
    half = [[3, 3.5, 4], [30, 35, 40], [400, 300, 350], None]
    assert caps_of(UNEQUAL.eased_to(faster, 0.5)) == half
    assert UNEQUAL.eased_to(faster, 1.0) is UNEQUAL.eased_to(faster, 2.0) is faster


@pytest.mark.parametrize("kind", ["velocity", "acceleration", "jerk", "tool_speed"])
@pytest.mark.parametrize("bad", [0.0, -1.0, math.inf, math.nan])
def test_a_cap_that_is_not_positive_and_finite_is_refused_by_name(kind: str, bad: float) -> None:
    given = {"velocity": 1.0, "acceleration": 1.0, "jerk": 1.0, "tool_speed": 1.0}
    with pytest.raises(ValueError, match=f'"{kind}" = .* number of more than 0'):
        MotionLimits.uniform(**given | {kind: bad})
    with pytest.raises(ValueError, match=r"jerk.* must be 1, as many as velocities"):
        MotionLimits(velocity=[1.0], acceleration=[1.0], jerk=[1.0, 1.0])


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
    fewer = MotionLimits.uniform(velocity=1.0, acceleration=5.0, jerk=50.0, n=4)
    for t, limits, says in ((0.1, fewer, "4 finite numbers"), (np.nan, HARD, "t must be finite")):
        with pytest.raises(ValueError, match=says):
            online.stop_on_path(tour, t, limits, DT)


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


# The compiled path to rest is ruckig's


UNEVEN = MotionLimits(
    velocity=np.full(5, 3.0),
    acceleration=np.array([6.0, 7.0, 8.0, 5.0, 10.0]),
    jerk=np.array([60.0, 150.0, 90.0, 400.0, 200.0]),
)


def drawn(random):
    """A state, some joints of it at rest, at a constant speed, or beyond their caps."""
    qd, qdd = random.normal(0.0, 1.5, 5), random.normal(0.0, 6.0, 5)
    qd[random.random(5) < 0.2] = 0.0
    qdd[random.random(5) < 0.3] = 0.0
    return Setpoint(q=random.normal(0.0, 1.0, 5), qd=qd, qdd=qdd)


def by_ruckig(now, period):
    return online.stop(now.q, now.qd, now.qdd, UNEVEN, period)


@pytest.mark.parametrize("every", [0.02, 0.003, math.inf])
def test_it_is_ruckigs(every):
    random, paths, counts = np.random.default_rng(7), StopPaths(UNEVEN, DT, every), set()
    for _ in range(300):
        now = drawn(random)
        found = paths.to_rest(now)
        assert found.step <= every
        expected = by_ruckig(now, found.step)
        along = expected.q[[*range(len(found.path) - 1), -1]]
        assert np.abs(found.path - along).max() <= 1e-9
        assert found.step * (len(found.path) - 1) == pytest.approx(expected.duration, abs=1e-9)
        expected = by_ruckig(now, DT).sample(DT)
        for name in ("q", "qd", "qdd"):
            mine, others = getattr(found.after, name), getattr(expected, name)
            assert mine == pytest.approx(others, abs=1e-6), name
        counts.add(len(found.path))
    assert len(counts) > 20 or every == math.inf


def test_step_by_step_it_ends_at_rest_where_it_was_announced():
    random, paths = np.random.default_rng(8), StopPaths(UNEVEN, DT, 0.02)
    for _ in range(200):
        now = drawn(random)
        end, steps = paths.to_rest(now).path[-1], 0
        while now.qd.any() or now.qdd.any():
            now, steps = paths.to_rest(now).after, steps + 1
            assert steps < 300
        assert now.q == pytest.approx(end, abs=1e-9)


def test_joints_at_rest_stay():
    paths, now = StopPaths(UNEVEN, DT, 0.02), Setpoint.at_rest(np.arange(5.0))
    for found in (paths.to_rest(now), paths._by_ruckig(now)):  # where the library finds none
        assert np.array_equal(found.path, [now.q, now.q])
        assert np.array_equal(found.after.q, now.q)
        assert not found.after.qd.any()
    limits = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=20.0, n=1)
    state = {"q": np.zeros(1), "qd": np.ones(1), "qdd": np.zeros(1)}  # one joint is enough
    found = StopPaths(limits, DT, 0.05).to_rest(Setpoint(**state))
    assert found.path[-1, 0] == pytest.approx(online.stop(*state.values(), limits, DT).q[-1, 0])


def test_the_answer_stays_as_it_was_when_the_next_is_asked_for():
    paths, random = StopPaths(UNEVEN, DT, 0.02), np.random.default_rng(9)
    first = paths.to_rest(drawn(random))
    path, q = first.path.copy(), first.after.q.copy()
    paths.to_rest(drawn(random))
    assert np.array_equal(first.path, path)
    assert np.array_equal(first.after.q, q)


@pytest.mark.parametrize("qd", [np.full(5, math.nan), np.zeros(4), np.zeros(1)])
def test_what_is_no_state_of_these_joints_is_refused(qd):
    with pytest.raises(ValueError, match="qd must be 5 finite numbers"):
        StopPaths(UNEVEN, DT, 0.02).to_rest(Setpoint(q=np.zeros(5), qd=qd, qdd=np.zeros(5)))


# Slower and faster along a path


@settings(max_examples=20)
@given(seed=st.integers(0, 2**31), share=st.floats(0.02, 0.98))
def test_a_motion_rests_on_its_path_and_goes_on(seed, share) -> None:
    rng = np.random.default_rng(seed)
    limits = MotionLimits.uniform(velocity=2.0, acceleration=5.0, jerk=100.0)
    stop = MotionLimits.uniform(velocity=2.0, acceleration=8.0, jerk=200.0)
    moved = online.point_to_point(rng.uniform(-1, 1, 5), rng.uniform(-1, 1, 5), limits, 0.01)
    k = round(share * moved.duration / moved.dt)

    paused = time_scaling.shortest_pause(moved, k * moved.dt, stop, 0.2, limits)
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
    for k in range(0, len(moved), 3):
        assert time_scaling.shortest_pause(moved, 0.01 * k, stop, 0.2, limits) is not None, k


@settings(max_examples=20)
@given(
    seed=st.integers(0, 2**31), share=st.sampled_from([0.005, 0.01, 0.02]) | st.floats(0.02, 0.99)
)
def test_a_motion_goes_on_from_rest_as_gently_as_it_began(seed, share) -> None:
    rng = np.random.default_rng(seed)
    limits = MotionLimits.uniform(velocity=2.0, acceleration=5.0, jerk=100.0)
    moved = online.point_to_point(rng.uniform(-1, 1, 5), rng.uniform(-1, 1, 5), limits, 0.01)
    t = share * moved.duration

    resumed = time_scaling.shortest_speedup(moved, t, time_scaling.own_limits(moved))
    assert resumed is not None
    for derivative in (resumed.qd, resumed.qdd):
        assert not derivative[[0, -1]].any()
    np.testing.assert_allclose(resumed.q[0], moved.sample(t).q, atol=1e-12)
    np.testing.assert_allclose(resumed.q[-1], moved.q[-1], atol=1e-12)
    report = verify.limit_report(resumed, limits)
    assert report.acceleration.max() < 1.03
    assert report.jerk.max() < 1.03
    assert report.velocity.max() < 1.001


# Joints that follow targets that move


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
    with pytest.raises(ValueError, match="expected 3 joints"):
        Pursuit(3, 0.01).towards(*args)


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
    assert max(shares([now.q for now in setpoints], 0.01, caps)) <= 1.0 + 1e-5
    assert setpoints[-1].q == pytest.approx(swaying(1.99).q, abs=2e-3)


# Sampled trajectories


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
    zero = np.zeros((1, 3))
    single = Trajectory(dt=DT, q=zero + 0.5, qd=zero, qdd=zero, duration=0.0)
    for t in (-1.0, 0.0, 0.004, 2.0):
        assert np.array_equal(single.sample(t).q, [0.5, 0.5, 0.5])
        assert not single.sample(t).qd.any()
    assert single.at([0.0, 1.0])[0].shape == (2, 3)


def test_between_samples_a_quintic_motion_is_reproduced(trajectory: Trajectory) -> None:
    t = np.random.default_rng(1).uniform(0.0, 0.4, 200)
    for found, true, tolerance in zip(
        trajectory.at(t), quintic(t), (1e-13, 1e-11, 1e-9), strict=True
    ):
        assert np.allclose(found, true, rtol=0.0, atol=tolerance)


def test_its_arrays_cannot_be_changed_have_one_shape_and_cross_a_process_boundary(
    trajectory: Trajectory,
) -> None:
    with pytest.raises(ValueError, match="read-only"):
        trajectory.q[0] = 0.0
    with pytest.raises(ValueError, match="shape"):
        Trajectory(dt=DT, q=np.zeros((3, 2)), qd=np.zeros((2, 2)), qdd=np.zeros((3, 2)), duration=0)
    copy = pickle.loads(pickle.dumps(trajectory))
    assert np.array_equal(copy.q, trajectory.q)
    assert (copy.dt, copy.duration, copy.n, len(copy)) == (DT, 0.4, 2, 41)
    assert copy.t[-1] == pytest.approx(0.4)


# Verifying


VERIFIED = MotionLimits(
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
    bounds = {"lower": np.full(5, -0.55), "upper": np.full(5, 0.35)}
    report = verify.limit_report(swing(amplitude, 6.0), VERIFIED, **bounds)
    assert np.allclose(report.outside, [0.0, 0.05, 0.05, 0.0, 0.0], atol=1e-6)
    size = np.abs(amplitude)
    assert np.allclose(report.velocity, size * 6.0 / VERIFIED.velocity, rtol=1e-4)
    # It starts and ends with a jump of acceleration, so only those two are known.
    assert np.allclose(report.acceleration, size * 36.0 / VERIFIED.acceleration, rtol=1e-2)
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


def test_a_joint_that_is_too_fast_is_named() -> None:
    with pytest.raises(OutsideLimits, match=r"elbow_flex would need 206.*deg/s of speed") as caught:
        verify.check(swing(np.array([0.0, 0.0, 0.3, 0.0, 0.0]), 12.0), VERIFIED)
    assert caught.value.joint == "elbow_flex"
    assert caught.value.value == pytest.approx(3.6, rel=1e-4)
    assert (caught.value.lower, caught.value.upper) == (-3.0, 3.0)
    assert "20 % over" in str(caught.value)


def test_a_joint_that_leaves_its_range_is_named() -> None:
    trajectory = swing(np.array([0.0, 0.0, 0.0, -0.01, 0.0]), 6.0)
    with pytest.raises(OutsideLimits, match=r"wrist_flex would go to -1\.15 deg") as caught:
        verify.check(trajectory, VERIFIED, lower=np.full(5, -0.015), upper=np.full(5, 0.5))
    assert caught.value.value == pytest.approx(-0.02, rel=1e-4)


@pytest.mark.parametrize("quantity", ["acceleration", "jerk"])
def test_too_much_acceleration_or_jerk_is_refused(quantity: str) -> None:
    generous = {"velocity": 1e3, "acceleration": 1e6, "jerk": 1e9}
    limits = MotionLimits.uniform(**{**generous, quantity: 0.01}, n=2)
    with pytest.raises(OutsideLimits, match=f"joint 2 would need .* of {quantity}"):
        verify.check(swing(np.array([0.0, 0.1]), 6.0), limits)


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
    zero = np.zeros((1, 5))
    report = verify.check(Trajectory(dt=0.01, q=zero, qd=zero, qdd=zero, duration=0.0), VERIFIED)
    assert report.worst == report.stretch == 0.0, "a single sample uses nothing"
    with pytest.raises(ValueError, match="5 joints, a motion of 2"):
        verify.limit_report(swing(np.array([0.0, 0.1]), 6.0), VERIFIED)
