"""The fit of a servo's parameters finds those of the servo that made the data."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.servo_model import Parameters, load, simulate
from so101_motion.calib.procedure.servo_fit import (
    JointRecord,
    TwinFit,
    identify,
    play,
    replayed,
    setpoints,
    unrounded,
)
from so101_motion.drivers.feetech.lag_compensation import braking
from so101_motion.drivers.servo_types import STS3215_12V, ServoFigures
from so101_motion.planning.kinematics.model import RobotModel

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


@pytest.mark.parametrize("degrees", [0.7, 0.95])
def test_play_shows_when_a_joint_without_load_turns_round(degrees):
    true = ServoFigures(play=math.radians(degrees))
    record = record_of(true, index=0)
    weightless = np.zeros(len(record.t))
    assert play(record, true, weightless) == pytest.approx(true.play, rel=0.05)
    off = ServoFigures(friction=0.95, torque=0.95)
    assert play(record, off, weightless) == pytest.approx(true.play, rel=0.1)


def test_figures_that_are_somewhat_off_are_put_right_by_the_whole_record():
    true = ServoFigures(torque=1.1, friction=0.9, dead_time=1.1, play=math.radians(0.95))
    record = record_of(true, index=0)
    off = ServoFigures(torque=1.0, friction=0.85, dead_time=1.0, play=0.8 * true.play)
    found = TwinFit(record, np.zeros(len(record.t))).best(off, torque_is_open=True)
    assert found.torque == pytest.approx(true.torque, rel=0.04)
    assert found.friction == pytest.approx(true.friction, rel=0.04)
    assert found.dead_time == pytest.approx(true.dead_time, abs=0.03)
    assert found.play == pytest.approx(true.play, rel=0.04)


def test_torque_and_friction_that_are_off_by_the_same_share_are_told_from_the_right_ones():
    """While such a joint turns steadily, nothing tells them."""
    true = ServoFigures(torque=0.9, friction=1.1, play=math.radians(0.85))
    record = record_of(true, index=4)
    off = replace(true, torque=0.8 * true.torque, friction=0.8 * true.friction)
    found = TwinFit(record, np.zeros(len(record.t))).best(off, torque_is_open=True)
    assert found.torque == pytest.approx(true.torque, rel=0.06)
    assert found.friction == pytest.approx(true.friction, rel=0.06)


def test_a_play_that_nobody_has_seen_is_not_made_up_and_set_points_arrive_where_they_were_sent():
    record = record_of(ServoFigures(torque=1.1), index=0)
    assert setpoints(replace(record, goals=np.full(len(record.goals), 2100.0)))[-1] == 2100.0
    found = TwinFit(record, np.zeros(len(record.t))).best(ServoFigures(), torque_is_open=True)
    assert found.play is None


def test_a_report_of_an_arm_is_read_by_the_program_that_fits_the_emulator(tmp_path):
    """One joint that bears weight and one that does not, recorded for different times."""
    gravity, motions = RobotModel.load().holding_torques, {}
    lift, pan = (
        replayed(
            replace(record, acceleration=braking(i, 0)), ServoFigures(), gravity(record.q)[:, i]
        )
        for i, record in ((1, record_of(ServoFigures())), (0, record_of(ServoFigures(), index=0)))
    )
    for joint, record, n in (("shoulder_lift", lift, len(lift.t)), ("shoulder_pan", pan, 500)):
        command = np.zeros((len(record.t), 6))
        command[:, record.index] = (record.goals - 2048.0) * TICK
        motions[joint] = {
            "t_cmd_s": record.t.tolist(), "command": command.tolist(),
            "t_s": record.t[:n].tolist(), "volts": [12.0] * n,
            "position": np.column_stack([record.q, np.zeros(len(record.t))])[:n].tolist(),
        }  # fmt: skip
    registers = {"p_gain": 32, "max_acceleration": 0}
    file = tmp_path / "arm.json"
    file.write_text(json.dumps({"servos": dict.fromkeys(motions, registers), "motions": motions}))
    recordings = load(file)
    assert recordings.kind.tolist() == ["sweep of shoulder_lift", "sweep of shoulder_pan"]
    assert recordings.valid.sum() == len(lift.t) + 500
    torques = np.array([0.8, 1.0, 1.2]) * Parameters().torque_per_volt
    errors = recordings.error(simulate(recordings, Parameters(torque_per_volt=torques), dt=2e-3))
    assert np.argmin(errors) == 1, "the servo that made them"
    assert errors[1] < 0.0015


@pytest.mark.parametrize("readings", [1, 2])
def test_failed_readings_do_not_count(tmp_path, readings):
    """The recorder of the pendulum wrote -3.14 for them, once twice in a row."""
    record = record_of(ServoFigures())
    position = record.ticks - 2048.0
    position[100 : 100 + readings] = -2048.0
    rows = {"t_s": record.t, "goal_rad": (record.goals - 2048.0) * TICK, "position_tick": position}
    rows |= {"volts": record.volts, "torque_enable": np.ones(len(record.t))}
    of_one = {"kp": 32, "mass_kg": 0.5, "length_m": 0.1, "trajectory": "lift"}
    arrays = {name: np.array([each]) for name, each in (rows | of_one).items()}
    np.savez(tmp_path / "a.npz", **arrays)
    left_out = np.flatnonzero(~load(tmp_path).valid[0])
    assert left_out.tolist() == list(range(100, 100 + readings))


def test_a_weight_that_changes_sides_is_met_half_way_between_two_readings():
    """Held back by a reading, the output falls through its play late and seems to have less."""
    record = record_of(ServoFigures(play=math.radians(0.9)))
    rising = np.linspace(-0.6, 0.6, len(record.t))
    fine = replace(record, t=np.repeat(record.t, 2) + np.tile([0.0, 0.005], len(record.t)))
    fine = replace(
        fine, q=np.repeat(record.q, 2, axis=0), ticks=np.repeat(record.ticks, 2),
        qd_ref=np.repeat(record.qd_ref, 2), volts=np.repeat(record.volts, 2),
    )  # fmt: skip
    figures = ServoFigures(play=math.radians(0.9))
    coarse = unrounded(record, figures, rising)
    finer = unrounded(fine, figures, np.interp(fine.t, record.t, rising))[::2]
    assert np.mean(np.abs(coarse - finer)) < 0.02
