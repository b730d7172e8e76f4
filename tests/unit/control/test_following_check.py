import numpy as np
import pytest

from so101_motion.control.following_check import FollowingCheck
from so101_motion.control.joint_group import Tolerances

DT = 0.01
TOLERANCES = Tolerances(following_lag=0.15, contact_distance=np.radians(1.4))


def seen(setpoints, joints, tolerances=TOLERANCES):
    """At which tick a joint that goes through ``joints`` [deg] is held up; None if never."""
    check = FollowingCheck(tolerances, DT)
    check.begin(np.radians(setpoints[:1]))
    for k, (setpoint, joint) in enumerate(zip(setpoints, joints, strict=True)):
        check.want(np.radians([setpoint]))
        if check.held_up(np.radians([joint]))[0]:
            return k
    return None


@pytest.mark.parametrize("speed", [25.0, -25.0, 90.0, 180.0])
def test_a_joint_that_meets_something_is_held_up_within_90_ms(speed):
    way = speed * DT * np.arange(100.0)
    met = 50
    assert met < seen(way, np.where(np.arange(100) < met, way, way[met])) <= met + 9


@pytest.mark.parametrize("lag", [0, 5, 10, 14])
def test_a_joint_that_lags_by_a_constant_time_is_not_held_up(lag):
    t = DT * np.arange(400.0)
    way = 60.0 * np.cos(2.5 * t)  # up to 150 deg/s
    late = np.concatenate([np.full(lag, way[0]), way[: len(way) - lag]])
    assert seen(way, late) is None


def test_play_and_friction_at_a_turn_are_no_contact():
    way = np.abs(np.linspace(-30.0, 30.0, 120))
    lost = np.maximum(way - 1.3, 0.0)
    assert seen(way, np.where(np.arange(120) < 60, way, lost)) is None


def test_a_joint_that_ran_ahead_may_wait_for_its_setpoints():
    way = 50.0 * DT * np.arange(60.0)
    ahead = np.minimum(way + 4.0, np.maximum(way, 20.0))
    assert seen(way, ahead) is None


def test_one_that_falls_back_has_met_nothing():
    way = 15.0 * DT * np.arange(60.0)
    assert seen(way, way - np.linspace(0.0, 1.0, 60) * 1.2) is None


def test_a_joint_that_shall_be_stopped_by_what_it_meets_is_left_to_press():
    way = 90.0 * DT * np.arange(100.0)
    soft = Tolerances(following_lag=0.15)
    assert seen(way, np.minimum(way, 40.0), soft) is None
