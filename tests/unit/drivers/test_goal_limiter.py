import math
from contextlib import suppress

import pytest

from so101_motion.common.errors import CommandRefused
from so101_motion.drivers.goal_limiter import (
    CATCH_UP,
    OFFSET_SPEED,
    PAUSE,
    SEED,
    SLACK,
    GoalLimiter,
)

DT = 0.01
SPEED, ACCELERATION = math.radians(220.0), math.radians(1000.0)
NONE, NOWHERE = [0.0] * 6, [math.nan] * 6


def six(first):
    return [first, 0.0, 0.0, 0.0, 0.0, 0.0]


@pytest.fixture
def limiter():
    """Six joints held at 0 since 0 s."""
    limiter = GoalLimiter(
        ("pan", "lift", "elbow", "flex", "roll", "jaw"), speed=SPEED, acceleration=ACCELERATION
    )
    limiter.begin(NONE, NONE, 0.0)
    limiter.goals(NONE, [1.0] * 6, NONE, 0.0)
    return limiter


def test_a_motion_below_the_caps_passes_unchanged(limiter):
    q, qd = 0.0, 0.0
    for k in range(1, 50):
        qd = min(qd + ACCELERATION * DT, math.radians(180.0))
        q += qd * DT
        limiter.follow(six(q), [qd, 0.0, 0.0, 0.0, 0.0], k * DT, NOWHERE)
        assert limiter.goals(NONE, [1.0] * 6, NONE, k * DT)[0] == q


def test_a_setpoint_further_off_than_its_own_speed_allows_is_refused_and_the_last_one_stays(
    limiter,
):
    slow = [math.radians(30.0), 0.0, 0.0, 0.0, 0.0]
    limiter.follow(six(0.0), [0.5 * qd for qd in slow], DT, NOWHERE)
    limiter.follow(six(0.003), slow, 2 * DT, NOWHERE)
    with pytest.raises(
        CommandRefused, match=r"pan was to move by 44\.8 deg within 10 ms"
    ) as caught:
        limiter.follow(six(0.003 + math.radians(44.8)), slow, 3 * DT, NOWHERE)
    assert caught.value.joint == "pan"
    with pytest.raises(CommandRefused, match=r"pan was to move by 1\.5 deg"):
        limiter.follow(six(0.003 + math.radians(1.5)), slow, 3 * DT, NOWHERE)
    assert limiter.goals(NONE, [1.0] * 6, NONE, 3 * DT)[0] == 0.003


def test_a_command_without_a_speed_is_held_to_the_hard_cap(limiter):
    most = SPEED * (DT + CATCH_UP)
    limiter.follow(six(most), None, DT, NOWHERE)
    with pytest.raises(CommandRefused):
        limiter.follow(six(most + 1.01 * SPEED * DT), None, 2 * DT, NOWHERE)
    limiter.follow(six(most + SPEED * DT), None, 2 * DT, NOWHERE)


def test_a_command_after_a_late_one_and_one_left_out_is_no_jump(limiter):
    qd = math.radians(90.0)
    moving = [qd, 0.0, 0.0, 0.0, 0.0]
    for k in range(1, 11):
        limiter.follow(
            six(0.05 * qd * k**2 * DT), [0.1 * k * qd, 0.0, 0.0, 0.0, 0.0], k * DT, NOWHERE
        )
    q, t = 5.0 * qd * DT, 10 * DT
    for _ in range(20):  # one 14 ms late, the next left out, the third in time
        limiter.follow(six(q + qd * DT), moving, t + DT + 0.014, NOWHERE)
        limiter.follow(six(q + 3.0 * qd * DT), moving, t + 3 * DT, NOWHERE)
        q, t = q + 3.0 * qd * DT, t + 3 * DT


def test_no_command_goes_on_faster_than_the_speed_it_came_with(limiter):
    slow = [math.radians(30.0), 0.0, 0.0, 0.0, 0.0]
    sent = 0
    with suppress(CommandRefused):
        for k in range(1, 40):
            limiter.follow(six(2.0 * slow[0] * k * DT), slow, k * DT, NOWHERE)
            sent = k
    assert 0 < sent < 10


@pytest.mark.parametrize("after", [PAUSE, 0.5 * PAUSE, DT])
def test_after_a_pause_a_joint_goes_on_from_rest_or_at_its_speed(limiter, after):
    qd = math.radians(180.0)
    for k in range(1, 19):
        limiter.follow(NONE, [0.1 * qd * min(k, 10), 0.0, 0.0, 0.0, 0.0], k * DT, NOWHERE)
    with pytest.raises(CommandRefused, match="from 180 to 0 deg/s at once"):
        limiter.follow(NONE, NONE[:5], 19 * DT, NOWHERE)
    t = 18 * DT + PAUSE - after + DT
    limiter.follow(NONE, [qd, 0.0, 0.0, 0.0, 0.0], t, NOWHERE)
    with pytest.raises(CommandRefused, match="from 180 to -180 deg/s"):
        limiter.follow(NONE, [-qd, 0.0, 0.0, 0.0, 0.0], t + after, NOWHERE)
    limiter.follow(NONE, NONE[:5], t + after, NOWHERE)


@pytest.mark.parametrize("qd", [math.radians(230.0), math.inf, -math.inf])
def test_a_speed_above_the_hard_cap_or_none_at_all_is_refused(limiter, qd):
    with pytest.raises(CommandRefused, match="pan was to change its speed"):
        limiter.follow(NONE, [qd, 0.0, 0.0, 0.0, 0.0], 10.0, NOWHERE)


@pytest.mark.parametrize("q", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_no_number_is_refused(limiter, q):
    with pytest.raises(CommandRefused):
        limiter.follow(six(q), None, DT, NOWHERE)
    with pytest.raises(CommandRefused):
        limiter.begin(six(q), NONE, DT)


def test_a_command_begins_where_its_joint_is(limiter):
    limiter.begin(six(0.9 * SEED), NONE, DT)
    with pytest.raises(CommandRefused, match=r"pan is at 0\.0 deg and was to be held at"):
        limiter.begin(six(1.1 * SEED), NONE, DT)
    limiter.begin(six(1.1 * SEED), NONE, DT, free=(0,))


def test_a_joint_that_did_not_follow_may_be_told_to_stay_where_it_surely_is(limiter):
    unknown = [math.nan] * 5
    limiter.follow(six(0.4), unknown, DT, six(0.41))
    with pytest.raises(CommandRefused):
        limiter.follow(six(0.9), unknown, 2 * DT, six(0.8))
    with pytest.raises(CommandRefused):  # one that says how fast it goes does not jump
        limiter.follow(six(0.9), NONE[:5], 3 * DT, six(0.9))


def test_what_is_added_for_the_weight_keeps_its_bound_and_comes_no_faster_than_its_own_speed(
    limiter,
):
    goals = [limiter.goals(six(0.5), six(0.05), NONE, k * DT)[0] for k in range(1, 20)]
    steps = [b - a for a, b in zip([0.0, *goals], goals, strict=False)]
    assert max(steps) <= OFFSET_SPEED * (DT + SLACK) + 1e-12
    assert goals[-1] == 0.05
    limiter.begin(NONE, NONE, 20 * DT)
    begun = limiter.goals(six(-0.5), six(0.05), NONE, 20 * DT)[0]
    assert begun == -0.05, "with a new command it begins at once"


def test_goals_follow_a_hand_no_faster_than_the_hard_cap(limiter):
    assert limiter.yielded(six(1.0), DT)[0] == pytest.approx(SPEED * (DT + SLACK))
    travelled = [limiter.yielded(six(1e9), k * DT)[0] for k in range(2, 30)][-1]
    assert travelled == pytest.approx(SPEED * (29 * DT + SLACK))


@pytest.mark.parametrize("rest", [0.2, 1.0, 60.0])
def test_a_motion_after_a_rest_begins_where_the_joint_rests(limiter, rest):
    with pytest.raises(CommandRefused, match="pan was to move by 2"):
        limiter.follow(six(math.radians(2.0)), NONE[:5], rest, NOWHERE)
    limiter.follow(six(0.5 * ACCELERATION * DT**2), [ACCELERATION * DT, *NONE[1:5]], rest, NOWHERE)
