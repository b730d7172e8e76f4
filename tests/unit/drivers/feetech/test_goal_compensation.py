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


class Driven:
    """Six joints that start at ``q``; the second is commanded, every 10 ms."""

    def __init__(self, gravity=lambda q: np.zeros(6), q=0.0, servos=MAPS):
        limiter = GoalLimiter(NAMES, speed=math.pi, acceleration=10.0)
        self.servo = dict(servos)[NAMES[LIFT]]
        self.joint = GoalCompensation(dict(enumerate(servos.values())), gravity, limiter, None, {})
        self.k, self.q = 0, [q] * 6
        self.joint.begin(self.q, self.q, 0.0, ())

    def send(self, qd, qdd=None, **how):
        """Go on at ``qd`` [rad/s]; how far the goal is beyond the command [rad]."""
        self.k += 1
        self.q = [*self.q]
        self.q[LIFT] += 0.01 * qd
        rates, changes = [0.0] * 5, [0.0] * 5
        rates[LIFT], changes[LIFT] = qd, qdd or 0.0
        told = None if qdd is None else changes
        t = 0.01 * self.k
        self.joint.point(self.q, rates, t, lambda i: math.nan, (), told, **how)
        goals = self.joint.goals(t)
        return self.servo.to_rad(goals[self.servo.servo_id]) - self.q[LIFT]


def followed(*, behind_deg, seconds):
    """What the trim has learnt after a lift at 50 deg/s behind a target, late by so much [deg]."""
    arm, speed = Driven(lambda q: np.eye(6)[LIFT]), math.radians(50.0)  # [N m]
    for k in range(1, round(seconds / 0.01)):
        qd = min(10.0 * 0.01 * k, speed)
        arm.send(qd)
        at, rates = [*arm.q], [0.0] * 6
        at[LIFT] -= math.radians(behind_deg) * min(0.01 * k / 0.1, 1.0)
        rates[LIFT] = qd
        arm.joint.trim.measure(at, rates, range(6), 0.01 * k)
    return math.degrees(arm.joint.trim.rest[LIFT])


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
    arm, speed, qd = Driven(q=-1.5), math.radians(speed_deg), 0.0
    for k in range(1, 101):
        qdd = -6.0 if slows and k > 85 else 5.0 if qd < speed else told
        known = qdd if told_from < 0.01 * k < told_until else None
        ahead = arm.send(qd, known, follows_target=follows_target)
        qd = max(min(qd + 0.01 * qdd, speed), 0.0)
    return math.degrees(ahead)


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
    for direction in (1, -1):
        beyond = 0.0
        for way in (1.0, -1.0):
            arm, qd = (
                Driven(servos={n: replace(m, direction=direction) for n, m in MAPS.items()}),
                0.0,
            )
            for k in range(1, 101):
                qdd = way * (5.0 if k <= 20 else 0.0)
                qd += 0.01 * qdd
                beyond += arm.send(qd, qdd) * (k > 30) / 140.0
        # Ahead by the same both ways, but for what is dropped.
        assert direction * beyond == pytest.approx(0.5 * RAD_PER_TICK, rel=0.2)


def test_a_joint_whose_motor_is_driven_through_the_play_may_stand():
    """Its weight changes sides so fast that no unknown load is needed to take it through."""
    arm, qd = Driven(lambda q: math.copysign(0.5, q[LIFT] - 0.1) * np.eye(6)[LIFT]), 0.0
    joint = arm.joint
    joint.trim.models[LIFT] = ServoModel(figures=ServoFigures(play=math.radians(0.8)))
    may_stand, kept = [], []
    for _ in range(1, 100):
        qdd = 2.0 if qd < 0.3 else 0.0
        qd += 0.01 * qdd
        arm.send(qd, qdd)
        may_stand.append(LIFT in joint.in_play())
        kept.append(LIFT not in joint.trim.in_play())
    assert all(kept)
    assert 5 <= sum(may_stand[20:]) <= 8, "while its motor crosses the play, and not after"
