"""When joints of a plan turn round: where friction changes sign and motors cross their play."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from so101_motion.drivers.feetech.goal_compensation import Reversals
from so101_motion.drivers.feetech.lag_compensation import DELAY
from so101_motion.drivers.feetech.servo_model import ServoModel
from so101_motion.drivers.servo_types import STS3215_7V4, STS3215_12V, ServoFigures

DT, PLAY = 0.01, math.radians(0.85)
TURNS = np.radians(200.0) * (0.5 - DT * np.arange(120))
"""Speeds of a joint that turns round at 0.5 s [rad/s]."""


def turned(speeds, *, play=PLAY, weights=None, kind=STS3215_12V):
    """The ways of friction, and how fast the motor goes through the play, of joint 0 at times."""
    model = ServoModel(kind, figures=ServoFigures(play=play))
    trim = SimpleNamespace(models=[model] * 5, ways=[0.0] * 5, weights=[0.0] * 5)
    reversals, ways, crossing = Reversals(trim), [], []
    for k, speed in enumerate(speeds[:-6]):
        if weights is not None:
            trim.weights[0] = weights[k]
        change = (speeds[k + 6] - speed) / (6 * DT)
        foreseen = reversals.foresee([speed, 0.0, 0.0, 0.0, 0.0], [change, 0, 0, 0, 0], DT)
        trim.ways = [
            was if way is None else way for was, way in zip(trim.ways, foreseen, strict=True)
        ]
        ways.append(trim.ways[0])
        crossing.append(reversals.crossing[0])
    return np.array(ways), np.array(crossing)


def test_friction_changes_sides_before_the_joint_turns_and_is_done_soon_after():
    ways, _ = turned(TURNS)
    felt = ways[: round((0.5 - DELAY - 0.022) / DT)]
    assert felt[-6] == 1.0
    assert felt[-1] < 0.5
    assert ways[50] == -1.0


def test_friction_changes_sides_earlier_the_farther_the_goal_has_to_step():
    def begins(kind, weight):  # [s] before the turn, beyond the delay of a goal
        ways, _ = turned(TURNS, weights=np.full(120, weight), kind=kind)
        return 0.5 - kind.goal_delay - DT * np.argmax(ways[20:] < 1.0) - 20 * DT

    assert begins(STS3215_7V4, 1.0) > begins(STS3215_12V, 1.0) + 0.015
    assert begins(STS3215_12V, 1.0) > begins(STS3215_12V, 0.0) + 0.015


def test_the_motor_goes_through_all_of_the_play_and_no_further():
    _, crossing = turned(TURNS)
    assert DT * crossing[crossing < 0.0].sum() == pytest.approx(-PLAY)
    assert DT * crossing[crossing > 0.0].sum() == pytest.approx(0.5 * PLAY), "from the middle"


def test_a_joint_that_comes_to_rest_keeps_its_friction_where_it_is():
    t = DT * np.arange(150)
    smooth = 3.0 * np.minimum(t, 0.1) - np.minimum(t, 0.1) ** 2  # it has speeded up
    speeds = np.where(t < 0.5, smooth, 0.29 * np.maximum(1.0 - (t - 0.5) / 0.4, 0.0) ** 2)
    ways, _ = turned(speeds)
    assert ways[20:].min() == 1.0


def test_nothing_crosses_a_play_that_nobody_knows():
    assert not turned(TURNS, play=None)[1].any()


def test_a_joint_under_load_does_not_cross_its_play_when_it_turns():
    _, crossing = turned(TURNS, weights=np.full(120, 0.5))
    assert not crossing[10:].any()


def test_a_load_that_changes_sides_has_the_motor_bring_the_joint_back():
    speeds = np.full(120, 0.5)
    _, crossing = turned(-speeds, weights=np.linspace(-0.5, 0.5, 120))
    assert DT * crossing[20:].sum() == pytest.approx(PLAY)
    assert crossing.max() < math.radians(4.0), "or it would stand if the load were another"


def test_of_a_joint_that_creeps_nothing_is_foreseen():
    trim = SimpleNamespace(models=[ServoModel()] * 5, ways=[1.0] * 5, weights=[0.0] * 5)
    slow = [-math.radians(0.5)] * 5
    assert Reversals(trim).foresee(slow, [0.0] * 5, DT) == [None] * 5


def test_a_second_command_at_the_same_time_drives_no_motor_through_its_play():
    trim = SimpleNamespace(
        models=[ServoModel(figures=ServoFigures(play=PLAY))] * 5, ways=[0.0] * 5, weights=[0.0] * 5
    )
    reversals = Reversals(trim)
    reversals.foresee([0.5] * 5, [0.0] * 5, DT)
    reversals.foresee([0.5] * 5, [0.0] * 5, 0.0)
    assert reversals.crossing == [0.0] * 5
