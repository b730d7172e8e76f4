"""The fit of a servo's parameters finds those of the servo that made the data."""

import math
from dataclasses import replace

import numpy as np
import pytest

from so101_motion.calib.procedure.servo_fit import (
    JointRecord,
    TwinFit,
    identify,
    replayed,
    setpoints,
)
from so101_motion.drivers.servo_types import STS3215_12V, ServoFigures

TICK = 2.0 * math.pi / 4096.0
LEVER = 0.2


def gravity_of(mass, place):
    """A pendulum of 0.6 N m as joint 1, and its load at ``LEVER``."""

    def torques(q):
        found = np.zeros_like(q)
        found[:, 1] = (0.6 + 9.81 * mass * (LEVER + place[0])) * np.cos(q[:, 1])
        return found

    return torques


def to_and_fro(speeds=(15.0, 45.0), reach=25.0):
    """Where a joint is wanted, every 10 ms, [rad]."""
    legs = [np.full(50, -reach)]
    for speed in speeds:
        way = np.arange(-reach, reach, 0.01 * speed)
        legs += [way, way[::-1]]
    return np.radians(np.concatenate(legs))


def record_of(figures, index=1, mass=0.0):
    """What a joint with such a servo does when its setpoints go to and fro."""
    wanted = to_and_fro()
    t = 0.01 * np.arange(len(wanted))
    q = np.zeros((len(t), 5))
    q[:, index] = wanted
    record = JointRecord(
        index=index, kind=STS3215_12V, p_gain=32, acceleration=math.radians(600.0),
        zero_ticks=2048.0, direction=1, t=t, ticks=2048.0 + np.round(wanted / TICK), q=q,
        qd_ref=np.gradient(wanted, t), volts=np.full(len(t), 12.0), t_goals=t.copy(),
        goals=np.round(2048.0 + wanted / TICK + 6.0 * np.sign(np.gradient(wanted))),
    )  # fmt: skip
    return replayed(record, figures, gravity_of(mass, np.zeros(3))(q)[:, index])


def test_a_joint_that_bears_weight_tells_torque_and_friction():
    torque, friction = 0.85, 1.2
    true = ServoFigures(torque=torque, friction=friction, dead_time=0.9, play=0.0)
    found = identify({"shoulder_lift": record_of(true)}, gravity_of, hand=None).servos[
        "shoulder_lift"
    ]
    assert found.torque == pytest.approx(torque, rel=0.04)
    assert found.friction == pytest.approx(friction, rel=0.1)
    assert found.dead_time == pytest.approx(0.9, abs=0.12)


def test_a_joint_without_weight_tells_torque_where_it_speeds_up():
    torque, friction = 0.85, 0.9
    true = ServoFigures(torque=torque, friction=friction, play=math.radians(0.9))
    found = identify({"shoulder_pan": record_of(true, index=0)}, gravity_of, hand=None)
    assert found.deviations["shoulder_pan"].torque > 0.1, "steady motion does not know"
    assert found.servos["shoulder_pan"].torque == pytest.approx(torque, rel=0.05)
    assert found.servos["shoulder_pan"].friction == pytest.approx(friction, rel=0.05)
    assert found.servos["shoulder_pan"].play == pytest.approx(true.play, rel=0.05)


def test_a_load_is_weighed_by_a_servo_that_is_known():
    true = ServoFigures(torque=0.9, friction=1.1, dead_time=1.0, play=0.0)
    record = record_of(true, mass=0.2)
    hand = np.zeros(3)
    found = identify(
        {"shoulder_lift": record}, gravity_of, hand=hand, known={"shoulder_lift": true}
    )
    assert found.load is not None
    assert found.load.mass * (LEVER + found.load.com[0]) == pytest.approx(0.2 * LEVER, abs=0.006)


def test_a_play_that_nobody_has_seen_is_not_made_up_and_set_points_arrive_where_they_were_sent():
    record = record_of(ServoFigures(torque=1.1), index=0)
    assert setpoints(replace(record, goals=np.full(len(record.goals), 2100.0)))[-1] == 2100.0
    found = TwinFit(record, np.zeros(len(record.t))).best(ServoFigures(), torque_is_open=True)
    assert found.play is None
