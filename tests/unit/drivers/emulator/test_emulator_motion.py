import math
from dataclasses import replace

import pytest

from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.motion import DT, SLOWEST, Gains, Loop, Profile

GAINS = Gains(
    p=16, d=0, i=0, startup=16, i_limit=0, cw_dead_zone=1, ccw_dead_zone=1, window=20, still=2,
    limit=1000,
)  # fmt: skip


@pytest.fixture
def profile():
    profile = Profile(2048.0)
    profile.acceleration, profile.speed, profile.floor = 5000.0, 1000.0, 1.0
    return profile


def run(profile, seconds=10.0):
    """The set-points until the profile ends."""
    points = [profile.position]
    while profile.running and len(points) < seconds / DT:
        profile.step()
        points.append(profile.position)
    return points


def test_profile_takes_distance_over_speed_plus_speed_over_acceleration(profile):
    # Feetech's own rule for how long to wait.
    profile.target = 2048.0 + 2000.0
    points = run(profile)
    assert points[-1] == profile.target
    assert len(points) * DT == pytest.approx(2000 / 1000 + 1000 / 5000, abs=0.015)


def test_short_profile_is_a_triangle(profile):
    profile.target = 2048.0 + 100.0
    assert len(run(profile)) * DT == pytest.approx(2 * math.sqrt(100 / 5000), abs=0.02)


def test_goal_behind_is_reached_by_braking_first(profile):
    profile.target = 4000.0
    for _ in range(300):
        profile.step()
    turned_at = profile.position
    profile.target = 2048.0
    points = run(profile)
    assert max(points) == pytest.approx(turned_at + 1000**2 / (2 * 5000), rel=0.02)
    assert points[-1] == 2048.0


def test_same_goal_again_changes_nothing(bench):
    bench.write(1, reg.GOAL_VELOCITY, 500)
    bench.write(1, reg.GOAL_POSITION, 3000)
    once = []
    for _ in range(20):
        bench.advance(0.01)
        once.append(bench.read(1, reg.SETPOINT))
        bench.write(1, reg.GOAL_POSITION, 3000)
    assert once[-1] - once[-11] == pytest.approx(50, abs=1)  # 500 tick/s, undisturbed


@pytest.mark.parametrize(
    ("phase", "speed", "per_second"),
    [
        (reg.PHASE_SPEED_IN_TICKS | reg.PHASE_ZERO_IS_MAX, 600, 600),
        (reg.PHASE_ZERO_IS_MAX, 12, 600),  # in units of 50 tick/s
        (reg.PHASE_SPEED_IN_TICKS, 0, 0),  # zero means stand still
        (reg.PHASE_SPEED_IN_TICKS | reg.PHASE_ZERO_IS_MAX, 5, SLOWEST),
    ],
)
def test_phase_bits_decide_what_speed_means_and_none_is_below_the_slowest(
    bench, phase, speed, per_second
):
    bench.write(1, reg.PHASE, phase)
    bench.write(1, reg.GOAL_VELOCITY, speed)
    bench.write(1, reg.GOAL_POSITION, 3400)
    bench.advance(0.5)
    early = bench.read(1, reg.SETPOINT)
    bench.advance(1.0)
    assert bench.read(1, reg.SETPOINT) - early == pytest.approx(per_second, abs=2)


@pytest.mark.parametrize(
    ("servo_id", "limit", "units", "acceleration"),
    [
        (1, 100, 20, 127.6 * 20 + 533),
        (2, 100, 20, 89.3 * 20 + 329),
        (3, 100, 20, 108.2 * 20 + 296),
        (1, 100, 52, 7099),  # the knees
        (2, 100, 56, 5282),
        (3, 100, 64, 7140),
        (1, 100, 100, 7099),  # and flat beyond
        (1, 200, 200, 2 * 7099),  # a raised limit raises the knee
    ],
)
def test_acceleration_has_the_measured_slopes_and_knees(
    bench, servo_id, limit, units, acceleration
):
    bench.write(servo_id, reg.MAX_ACCELERATION, limit)
    bench.write(servo_id, reg.ACCELERATION, units)
    bench.write(servo_id, reg.GOAL_POSITION, 3000)
    bench.advance(0.05)
    early = bench.read(servo_id, reg.PROFILE_SPEED)
    bench.advance(0.1)
    gained = bench.read(servo_id, reg.PROFILE_SPEED) - early
    assert gained == pytest.approx(acceleration * 0.1, rel=0.01)


def test_without_an_acceleration_the_set_point_reaches_its_speed_at_once(bench):
    bench.write(1, reg.GOAL_VELOCITY, 1000)
    bench.write(1, reg.GOAL_POSITION, 3000)
    bench.advance(0.03)
    assert bench.read(1, reg.PROFILE_SPEED) == 1000


@pytest.mark.parametrize(("lower", "upper", "reached"), [(0, 2300, 2300), (0, 0, 3000)])
def test_goal_is_clamped_without_a_word_unless_the_limits_are_equal(bench, lower, upper, reached):
    bench.write(1, reg.MIN_POSITION, lower)
    bench.write(1, reg.MAX_POSITION, upper)
    assert bench.write(1, reg.GOAL_POSITION, 3000) == 0
    bench.advance(2.0)
    assert bench.read(1, reg.PRESENT_POSITION) == pytest.approx(reached, abs=3)
    assert bench.read(1, reg.GOAL_POSITION) == 3000


def test_loop_is_proportional_beyond_the_dead_zone_and_damps_what_changed_in_the_last_window():
    loop = Loop(GAINS)
    assert [loop.step(e, integrate=True) for e in (0, 1, -1, 2, -2, 26, 300)] == [
        0, 0, 0, 4 + 16, -4 - 16, 100 + 16, 1000,
    ]  # fmt: skip
    loop = Loop(replace(GAINS, p=0, d=32, startup=0))
    outputs = [loop.step(11 if step else 0, integrate=True) for step in range(21)]
    assert outputs[:20] == [0] * 20
    assert outputs[20] == 10 * 32 // 8


def test_integral_grows_with_the_error_and_stops_at_full_output():
    loop = Loop(replace(GAINS, p=0, i=5, startup=0))
    for _ in range(100):
        loop.step(11, integrate=True)
    assert loop.output == 10 * 100 * 5 // 500
    for _ in range(20_000):
        loop.step(11, integrate=True)
    assert loop.output == 1000
    for _ in range(30):
        loop.step(-101, integrate=True)
    assert loop.output < 1000  # not wound up: it comes back at once


@pytest.mark.parametrize(("limit", "integrate", "output"), [(40, True, 40), (0, False, 0)])
def test_integral_share_can_be_limited_and_waits_while_it_must_not_grow(limit, integrate, output):
    loop = Loop(replace(GAINS, p=0, i=5, i_limit=limit, startup=0))
    for _ in range(5000):
        loop.step(11, integrate=integrate)
    assert loop.output == output
