import math
from dataclasses import replace

import numpy as np
import pytest
from harness.emulated_joints import MAPS

from so101_motion.drivers.bus.ticks import RAD_PER_TICK
from so101_motion.drivers.feetech.goal_compensation import GoalCompensation
from so101_motion.drivers.feetech.servo_model import ServoModel
from so101_motion.drivers.goal_limiter import GoalLimiter
from so101_motion.drivers.servo_types import ServoFigures

NAMES = tuple(MAPS)
LIFT = NAMES.index("shoulder_lift")


def followed(*, behind_deg, seconds):
    """What the trim has learnt after a lift at 50 deg/s behind a target, late by so much [deg]."""
    limiter = GoalLimiter(NAMES, speed=math.pi, acceleration=10.0)
    weight = np.eye(6)[LIFT]  # [N m]
    compensation = GoalCompensation(
        dict(enumerate(MAPS.values())), lambda q: weight, limiter, None, {}
    )
    speed, q = math.radians(50.0), [0.0] * 6
    compensation.begin(q, q, 0.0, ())
    for k in range(1, round(seconds / 0.01)):
        t, qd = 0.01 * k, min(10.0 * 0.01 * k, speed)
        q = [*q]
        q[LIFT] += 0.01 * qd
        rates = [0.0] * 5
        rates[LIFT] = qd
        compensation.point(q, rates, t, lambda i: math.nan, ())
        compensation.goals(t)
        at = [*q]
        at[LIFT] -= math.radians(behind_deg) * min(t / 0.1, 1.0)
        compensation.trim.measure(at, [*rates, 0.0], range(6), t)
    return math.degrees(compensation.trim.rest[LIFT])


def test_the_lag_of_a_joint_that_follows_a_target_is_not_taken_for_weight():
    assert abs(followed(behind_deg=3.0, seconds=1.0)) < 0.3  # as emulated servos lag


def test_what_a_joint_that_follows_a_target_lacks_beyond_its_lag_is_weight():
    assert followed(behind_deg=4.5, seconds=0.5) > 1.0


def ahead_deg(
    speed_deg, *, follows_target=True, told_from=0.0, told=0.0, slows=False, told_until=9.9
):
    """How far ahead the goal of a joint is that has come up to this speed [deg].

    Its acceleration is known from ``told_from`` to ``told_until`` [s], and is said to be ``told``
    [rad/s^2] once it is at that speed. One that ``slows`` has done so for the last 0.15 s.
    """
    limiter = GoalLimiter(NAMES, speed=math.pi, acceleration=10.0)
    servos = dict(enumerate(MAPS.values()))
    compensation = GoalCompensation(servos, lambda q: np.zeros(6), limiter, None, {})
    speed, qd, q = math.radians(speed_deg), 0.0, [-1.5] * 6
    compensation.begin(q, q, 0.0, ())
    for k in range(1, 101):
        qdd = [0.0] * 5
        qdd[LIFT] = -6.0 if slows and k > 85 else 5.0 if qd < speed else told
        rates = [0.0] * 5
        rates[LIFT] = qd
        q = [*q]
        q[LIFT] += 0.01 * qd
        known = qdd if told_from < 0.01 * k < told_until else None
        compensation.point(
            q, rates, 0.01 * k, lambda i: math.nan, (), known, follows_target=follows_target
        )
        goals = compensation.goals(0.01 * k)
        qd = max(min(qd + 0.01 * qdd[LIFT], speed), 0.0)
    servo = servos[LIFT]
    return math.degrees(servo.to_rad(goals[servo.servo_id]) - q[LIFT])


def test_a_slow_joint_that_follows_a_target_is_driven_less_far_ahead_than_a_planned_one():
    assert ahead_deg(20.0) < ahead_deg(20.0, follows_target=False) - 0.15
    assert abs(ahead_deg(80.0) - ahead_deg(80.0, follows_target=False)) < 0.1


def test_no_acceleration_drives_a_joint_further_ahead_than_its_top_speed_asks_for():
    assert ahead_deg(175.0, follows_target=False, told=8.0) > 45.0
    assert ahead_deg(175.0, told=8.0) < 40.1


def test_one_that_follows_a_target_at_speed_is_not_driven_further_ahead_when_more_is_known():
    assert ahead_deg(80.0, told_from=0.5) == pytest.approx(ahead_deg(80.0, told_from=math.inf))
    assert ahead_deg(80.0, told_from=0.5) < ahead_deg(80.0) - 3.0


def test_one_that_was_driven_ahead_does_not_run_on_when_it_slows_and_nobody_says_so():
    known = ahead_deg(120.0, slows=True)
    assert ahead_deg(120.0, slows=True, told_until=0.855) < known + 0.2


def test_what_the_firmware_drops_of_its_set_point_is_added_towards_higher_ticks():
    limiter = GoalLimiter(NAMES, speed=math.pi, acceleration=10.0)
    for direction in (1, -1):
        servos = {i: replace(each, direction=direction) for i, each in enumerate(MAPS.values())}
        beyond = 0.0
        for way in (1.0, -1.0):
            compensation = GoalCompensation(servos, lambda q: np.zeros(6), limiter, None, {})
            q, qd = [0.0] * 6, [0.0] * 5
            compensation.begin(q, q, 0.0, ())
            for k in range(1, 101):
                qdd = [0.0] * 5
                qdd[LIFT] = way * (5.0 if k <= 20 else 0.0)
                qd[LIFT] += 0.01 * qdd[LIFT]
                q = [each + 0.01 * v for each, v in zip(q, [*qd, 0.0], strict=True)]
                compensation.point(q, [*qd], 0.01 * k, lambda i: math.nan, (), qdd)
                goal = compensation.goals(0.01 * k)[servos[LIFT].servo_id]
                beyond += (servos[LIFT].to_rad(goal) - q[LIFT]) * (k > 30) / 140.0
        # Ahead by the same both ways, but for what is dropped.
        assert direction * beyond == pytest.approx(0.5 * RAD_PER_TICK, rel=0.2)


def test_a_joint_whose_motor_is_driven_through_the_play_may_stand():
    """Its weight changes sides so fast that no unknown load is needed to take it through."""
    limiter = GoalLimiter(NAMES, speed=math.pi, acceleration=10.0)
    compensation = GoalCompensation(
        dict(enumerate(MAPS.values())),
        lambda q: math.copysign(0.5, q[LIFT] - 0.1) * np.eye(6)[LIFT],
        limiter,
        None,
        {},
    )
    compensation.trim.models[LIFT] = ServoModel(figures=ServoFigures(play=math.radians(0.8)))
    q, qd = [0.0] * 6, 0.0
    compensation.begin(q, q, 0.0, ())
    may_stand, kept = [], []
    for k in range(1, 100):
        qdd = 2.0 if qd < 0.3 else 0.0
        qd, q = qd + 0.01 * qdd, [*q]
        q[LIFT] += 0.01 * qd
        rates, changes = [0.0] * 5, [0.0] * 5
        rates[LIFT], changes[LIFT] = qd, qdd
        compensation.point(q, rates, 0.01 * k, lambda i: math.nan, (), changes)
        compensation.goals(0.01 * k)
        may_stand.append(LIFT in compensation.in_play())
        kept.append(LIFT not in compensation.trim.in_play())
    assert all(kept)
    assert 5 <= sum(may_stand[20:]) <= 8, "while its motor crosses the play, and not after"
