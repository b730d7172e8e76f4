import math

import numpy as np
from harness.emulated_joints import MAPS

from so101_motion.drivers.feetech.goal_compensation import GoalCompensation
from so101_motion.drivers.goal_limiter import GoalLimiter

NAMES = tuple(MAPS)
LIFT = NAMES.index("shoulder_lift")


def followed(*, behind_deg, seconds):
    """What the trim has learnt after a lift at 50 deg/s that is led, behind by so much [deg]."""
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


def test_the_lag_of_a_joint_that_is_led_is_not_taken_for_weight():
    assert abs(followed(behind_deg=3.0, seconds=1.0)) < 0.3  # as emulated servos lag


def test_what_a_led_joint_lacks_beyond_its_lag_is_weight():
    assert followed(behind_deg=4.5, seconds=0.5) > 1.0
