import math
import time
from dataclasses import replace

import numpy as np
import pytest
from harness.servo_stand import ELBOW, MAPS, heavy

from so101_motion.common.compliance import Compliance
from so101_motion.common.errors import NoReply
from so101_motion.control.motion_source import rooms
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.stale_replies import OVERDUE
from so101_motion.drivers.bus.ticks import RAD_PER_TICK, JointMap, Ticks
from so101_motion.drivers.feetech.gravity_compensation import SETTLE_POSITION, SETTLE_VELOCITY
from so101_motion.drivers.servo_types import STS3215_7V4, STS3215_12V

# Beginning


def test_connecting_caps_speed_and_acceleration_in_every_servo(make_stand):
    stand = make_stand()
    stand.connect(speed=math.radians(90.0), acceleration=math.radians(300.0))
    for servo_id in range(1, 7):
        assert stand.memory(servo_id, reg.GOAL_VELOCITY) == 1024
        assert stand.memory(servo_id, reg.ACCELERATION) == 28


def test_a_goal_is_only_remembered_while_the_joints_are_limp_and_torque_needs_one(stand):
    with pytest.raises(RuntimeError, match="goal"):
        stand.arm.set_torque(True)
    before = len(stand.port.sent)
    stand.arm.write(np.full(5, 0.02), 0.02)
    assert len(stand.port.sent) == before
    assert stand.torque() == [0] * 6


def test_torque_comes_on_where_the_joints_are(stand):
    shaft = stand.port.world.servos[1].drive.shaft
    shaft.put(shaft.output + 300.0)
    stand.clock.advance(0.1)
    stand.follow(0.1)
    stand.hold()
    assert stand.torque() == [1] * 6
    assert stand.memory(2, reg.GOAL_POSITION) == 2348
    stand.follow(1.0)
    assert stand.q[1] == pytest.approx(300 * RAD_PER_TICK, abs=0.01)  # the gears' play


def test_a_servo_in_the_wrong_mode_or_counting_turns_is_put_right_until_power_off(make_stand):
    stand = make_stand()
    servo = stand.port.world.servo(ELBOW)
    for row, value in ((reg.LOCK, 0), (reg.OPERATING_MODE, 1), (reg.PHASE, 28), (reg.LOCK, 1)):
        servo.write(bytes((row.address, *row.encode(value))))
    stand.connect()
    assert stand.memory(ELBOW, reg.OPERATING_MODE) == 0
    assert stand.memory(ELBOW, reg.PHASE) == 12
    assert stand.memory(ELBOW, reg.LOCK) == 1
    servo.boot()
    assert stand.memory(ELBOW, reg.OPERATING_MODE) == 1, "nothing is stored for good unasked"
    assert stand.memory(ELBOW, reg.PHASE) == 28


def test_without_a_calibration_the_servos_own_is_left_alone_and_each_must_acknowledge(make_stand):
    stand = make_stand()
    before = [stand.memory(i, reg.MAX_POSITION) for i in range(1, 7)]
    stand.port.world.servo(2).write(bytes((reg.STATUS_LEVEL.address, 0)))
    stand.connect()
    assert stand.memory(2, reg.STATUS_LEVEL) == 1
    assert [stand.memory(i, reg.MAX_POSITION) for i in range(1, 7)] == before


def test_the_calibration_is_the_truth_and_is_not_stored_in_the_servo(make_stand):
    stand = make_stand()
    maps = MAPS | {
        "elbow_flex": JointMap(
            servo_id=ELBOW,
            homing_offset=-100,
            zero_ticks=2150.0,
            lower_ticks=Ticks(1000),
            upper_ticks=Ticks(3300),
        )
    }
    flash = stand.port.world.servo(ELBOW).memory.flash
    arm = stand.connect(maps)
    assert stand.port.world.servo(ELBOW).memory.flash == flash
    assert stand.memory(ELBOW, reg.HOMING_OFFSET) == -100
    assert stand.memory(ELBOW, reg.MIN_POSITION) == 1000
    assert stand.memory(ELBOW, reg.MAX_POSITION) == 3300
    assert arm.read().q[2] == pytest.approx((2148 - 2150) * RAD_PER_TICK)


def test_a_missing_servo_is_an_error_that_says_where_to_look(make_stand):
    stand = make_stand(ids={1: 1, 2: 2, 3: 3})
    with pytest.raises(NoReply, match=r"wrist_flex.*wrist_roll.*gripper.*between servos 3 and 4"):
        stand.connect()
    assert stand.port.closed


@pytest.mark.parametrize(
    "wrong",
    [{"elbow_flex": MAPS["gripper"], "gripper": MAPS["gripper"]}, {"knee": MAPS["gripper"]}],
)
def test_impossible_maps_are_refused(make_stand, wrong):
    with pytest.raises(ValueError, match="servo of its own"):
        make_stand().connect(wrong)


# Cycles


def test_joints_go_where_they_are_sent_by_their_own_maps(make_stand):
    stand = make_stand()
    maps = MAPS | {
        "shoulder_pan": JointMap(servo_id=1, zero_ticks=2000.0, direction=-1),
        "wrist_roll": JointMap(servo_id=5, lower_ticks=Ticks(1900), upper_ticks=Ticks(2200)),
    }
    stand.connect(maps)
    stand.hold()
    reading = stand.follow(2.0, [0.3, 0.3, -0.3, 0.1, 1.0], 0.7)
    away = 152 * RAD_PER_TICK  # the limit of wrist_roll
    np.testing.assert_allclose(reading.q, [0.3, 0.3, -0.3, 0.1, away], atol=0.005)
    assert reading.q_jaw == pytest.approx(0.7, abs=0.005)
    zero = (2000 - 2048) * RAD_PER_TICK
    np.testing.assert_allclose(stand.q[:2], [zero - 0.3, 0.3], atol=0.005)


def test_a_cycle_is_two_transactions_and_near_the_least_the_wire_can_carry(stand):
    stand.hold()
    settled = time.monotonic() + OVERDUE  # until then an answer to the set-up may be on its way
    while time.monotonic() < settled:
        stand.follow(0.2, np.zeros(5))
    stand.port.sent.clear()
    stand.follow(1.0, np.zeros(5))
    packets = stand.port.sent[: -1 or None]
    cycles = 100
    assert len(packets) <= 2 * cycles + 1
    # Slots as in the servo's firmware: data and six more bytes, and a gap of three.
    wire = 0
    for packet in packets:
        wire += len(packet)
        if packet[4] == 0x82:
            wire += 6 * (packet[6] + 9)
    least = cycles * (26 + 14 + 6 * (2 + 9))
    assert wire / least <= 1.1


def test_velocities_are_those_of_the_joints(stand):
    stand.hold()
    for k in range(100):
        stand.write(np.full(5, 0.004 * k), 0.002 * k)
        stand.arm.read()
        stand.clock.advance(0.01)
    reading = stand.arm.read()
    np.testing.assert_allclose(reading.qd, 0.4, atol=0.03)
    assert reading.qd_jaw == pytest.approx(0.2, abs=0.03)
    assert np.max(np.abs(stand.follow(1.0, np.full(5, 0.4)).qd)) < SETTLE_VELOCITY


def test_a_lost_last_setpoint_is_sent_again_while_holding(stand):
    stand.hold()
    stand.port.faults.request_loss = 1.0
    stand.arm.write(np.full(5, 0.03), 0.0)
    stand.port.faults.request_loss = 0.0
    np.testing.assert_allclose(stand.follow(1.0).q, 0.03, atol=SETTLE_POSITION)


def test_under_load_the_joints_rest_where_they_were_sent(make_stand):
    stand = make_stand(gravity=heavy)
    stand.connect(gravity=lambda q: 0.7 * heavy(q))
    stand.hold()
    stand.follow(2.0)
    np.testing.assert_allclose(stand.q[:5], 0.0, atol=math.radians(0.3))
    stand.follow(2.5, [0.0, 0.4, -0.3, 0.0, 0.0])
    np.testing.assert_allclose(stand.q[:5], [0.0, 0.4, -0.3, 0.0, 0.0], atol=math.radians(0.3))


def test_goals_that_make_up_for_weight_are_shown_beside_the_bare_command(make_stand, clock):
    stand, seen = make_stand(), []
    arm = stand.connect(gravity=lambda q: np.array([0.0, -0.9, 0.0, 0.0, 0.0, 0.0]))
    arm.on_command = seen.append
    reading = arm.read()
    arm.write(reading.q, reading.q_jaw)
    arm.set_torque(True)
    assert [(one.is_seed, list(one.goals)) for one in seen] == [(True, [i]) for i in range(1, 7)]
    clock.advance(0.01)
    arm.write(np.full(5, 0.002), 0.0)
    last = seen[-1]
    assert (last.t, last.q_cmd, last.q_jaw_cmd) == (clock.now(), (0.002,) * 5, 0.0)
    assert last.goals == {i: stand.port.memory(i, reg.GOAL_POSITION) for i in range(1, 7)}
    assert last.goals[2] < last.goals[1] == 2049
    assert not last.is_seed
    assert not last.is_guided


@pytest.mark.parametrize("is_guided", [False, True])
def test_no_goal_is_sent_to_a_joint_outside_its_limits(make_stand, is_guided):
    stand = make_stand()
    outside = JointMap(servo_id=ELBOW, lower_ticks=Ticks(2130), upper_ticks=Ticks(3000))
    stand.connect(MAPS | {"elbow_flex": outside})
    stand.hold()
    if is_guided:
        stand.arm.guide(Compliance())
    stand.follow(0.3, np.zeros(5))
    assert stand.torque() == [1, 1, 0, 1, 1, 1]
    assert stand.memory(ELBOW, reg.GOAL_POSITION) == 0


# Health


@pytest.mark.parametrize(
    ("kind", "volts"),
    [
        (STS3215_12V, 12.0),
        (STS3215_12V, 7.4),
        (replace(STS3215_7V4, max_voltage_raw=140), 12.0),
    ],
)
def test_servos_taken_for_the_other_type_follow_the_second_motion(make_stand, kind, volts):
    """Not the first: what makes up for it acts only where joints are going to be faster anyway."""
    stand = make_stand(kind=kind, volts=volts)
    stand.connect()
    stand.hold()
    stand.follow(1.0)
    turn, mean, errors = math.tau / 1.2, math.radians(43.0), []
    sides, angles = np.array([1.0, -1.0, 1.0, 1.0, -1.0]), turn * 0.01 * np.arange(120)
    room = rooms(np.outer(1.0 - np.cos(angles), sides), 0.01)
    for k in range(480):  # to and fro, at most 86 deg/s and 225 deg/s^2
        angle = angles[k % 120]
        way, begin = (1.0, 0.0) if k // 120 % 2 == 0 else (-1.0, 1.2 * mean)
        q = sides * (begin + way * mean / turn * (angle - math.sin(angle)))
        qd, qdd = mean * (1.0 - math.cos(angle)), mean * turn * math.sin(angle)
        stand.arm.write(q, 0.0, sides * way * qd, sides * way * qdd, False, room[k % 120])
        stand.arm.read()
        stand.clock.advance(0.01)
        errors.append(np.abs(stand.q[:5] - q).max())
    assert math.degrees(max(errors[:120])) < 2.0, "4 deg if it came gently only"
    assert math.degrees(max(errors[120:])) < 1.5
