"""Doctor over arms whose servos somebody has spoilt: what it says is what the arm then does.

Most are tried at the elbow with 12 V servos, those of ``ELSEWHERE`` where it makes a difference;
``campaign/spoilt_arms.py`` tries all joints, both types and random pairs.
"""

import math

import numpy as np
import pytest
from campaign import spoilt_arms
from harness.spoilt_arm import WEIGHT, doctor_lets_it_move, spoilt, trouble_with_moving, truth

from so101_motion.calib.motors.arm_identification import ServoFacts
from so101_motion.calib.record.record import SERVO_IDS
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.ticks import JointMap, Ticks
from so101_motion.drivers.feetech.feetech_arm import FeetechArm
from so101_motion.drivers.feetech.servo_setup import prepare
from so101_motion.rig.servo_driver import ACCELERATION_CAP, SPEED_CAP

SINGLE = [
    (), ("RETURN_DELAY", 254), ("PHASE", 0), ("PHASE", 28), ("PHASE", 13), ("PHASE", 140),
    ("P_GAIN", 0), ("P_GAIN", 64), ("D_GAIN", 100), ("I_GAIN", 10), ("STARTUP_FORCE", 254),
    ("CW_DEAD_ZONE", 32), ("RESOLUTION", 3), ("MODE", 1), ("MAX_TEMPERATURE", 20),
    ("MAX_VOLTAGE", 80), ("MIN_VOLTAGE", 130), ("MAX_TORQUE", 300), ("UNLOADING", 0),
    ("PROTECTION_CURRENT", 250), ("OVERLOAD_TORQUE", 0), ("PROTECTION_TIME", 0),
    ("PROTECTIVE_TORQUE", 0), ("SPEED_UNIT", 1), ("MIN_SPEED", 254), ("MAX_SPEED", 20),
    ("MAX_ACCELERATION", 1), ("BAUD", 1), ("ID", 9),
]  # fmt: skip

PAIRS = [
    (("PHASE", 0), ("MIN_SPEED", 254)), (("P_GAIN", 4), ("STATUS_LEVEL", 0)),
    (("RESOLUTION", 3), ("PHASE", 28)), (("OVERLOAD_TORQUE", 0), ("PROTECTIVE_TORQUE", 0)),
    (("MIN_POSITION", 3000), ("MAX_POSITION", 1000)), (("MAX_TORQUE", 20), ("UNLOADING", 0)),
]  # fmt: skip


@pytest.mark.parametrize("changes", [*[(one,) for one in SINGLE], *PAIRS], ids=str)
def test_what_doctor_says_of_a_spoilt_arm_is_what_it_does(changes):
    changes = [(3, *one) for one in changes if one]
    trouble = truth(*changes)
    assert doctor_lets_it_move(spoilt(*changes)) == (not trouble), trouble


V12, V7 = spoilt_arms.KINDS
ELSEWHERE = [
    (V12, 2, "MAX_TORQUE", 250), (V12, 2, "MAX_TORQUE", 275),
    (V7, 2, "MAX_TORQUE", 425), (V7, 2, "MAX_TORQUE", 450),
    (V7, 6, "ID", 7), (V7, 2, "MIN_VOLTAGE", 74), (V7, 3, "PROTECTION_CURRENT", 12),
    (V7, 3, "OVERLOAD_TORQUE", 27), (V7, 3, "OVERLOAD_TORQUE", 28), (V7, 2, "OVERLOAD_TORQUE", 0),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "joint", "name", "value"), ELSEWHERE)
def test_it_is_told_truly_of_other_joints_and_of_7v4_servos_too(kind, joint, name, value):
    ready, trouble = spoilt_arms.judge([(joint, name, value)], kind)
    assert ready == (not trouble), trouble


def test_an_arm_whose_ids_run_the_other_way_is_refused_and_one_reversed_as_calibrated_is_not():
    assert ServoFacts(servo_id=3, held={"phase": 141}, counts_down=True).odd_settings == ()
    bus = spoilt(ids={place: 7 - place for place in range(1, 7)})
    assert not doctor_lets_it_move(bus)
    assert "6 to 1" in trouble_with_moving(bus)


@pytest.mark.parametrize("one", [
    ("P_GAIN", 0), ("P_GAIN", 1), ("I_GAIN", 254), ("CW_DEAD_ZONE", 32), ("MODE", 1),
    ("STATUS_LEVEL", 0),
], ids=str)  # fmt: skip
@pytest.mark.parametrize("kind", spoilt_arms.KINDS, ids=lambda kind: kind.name)
def test_a_joint_that_is_held_stays_where_it_is_while_its_settings_are_set_right(one, kind):
    bus = spoilt((2, *one), kind=kind)
    wire = Bus(bus.wire, reply_timeout=0.0)
    for servo_id in SERVO_IDS.values():
        wire.post(servo_id, reg.GOAL_POSITION, wire.read(servo_id, reg.PRESENT_POSITION))
        wire.post(servo_id, reg.TORQUE_ENABLE, 1)
    bus.settle()
    held = bus.world.q.copy()
    assert prepare(wire, JointMap(servo_id=2), {}).torque
    bus.settle()
    assert bus.world.servo("2").drive.torque == 1
    assert np.degrees(np.abs(bus.world.q - held)).max() < 2.5  # with the I gain it swings


@pytest.mark.parametrize("kind", spoilt_arms.KINDS, ids=lambda kind: kind.name)
def test_the_type_follows_from_the_supply_and_not_from_a_limit_that_was_written(kind):
    for limit in (80, 140):
        bus = spoilt((2, "MAX_VOLTAGE", limit), kind=kind)
        found = prepare(Bus(bus.wire, reply_timeout=0.0), JointMap(servo_id=2), {})
        assert found.kind is kind


def test_a_joint_that_is_held_outside_its_servos_limits_is_not_thrown_in():
    bus = spoilt((5, "P_GAIN", 1))
    wire = Bus(bus.wire, reply_timeout=0.0)
    wire.post(5, reg.GOAL_POSITION, wire.read(5, reg.PRESENT_POSITION))
    bus.settle()
    wire.post(5, reg.MIN_POSITION, 2600)
    prepare(wire, JointMap(servo_id=5), {})
    fastest, was = 0.0, bus.world.q[4]
    for _ in range(100):
        bus.clock.advance(0.01)
        bus.world.advance(bus.clock.now())
        fastest, was = max(fastest, abs(bus.world.q[4] - was) / 0.01), bus.world.q[4]
    assert bus.world.servo("5").drive.torque == 1
    assert math.degrees(fastest) < 20.0


@pytest.mark.parametrize("one", [
    ("PHASE", 141), ("PHASE", 13), ("MAX_TORQUE", 0), ("OVERLOAD_TORQUE", 27),
], ids=str)  # fmt: skip
def test_a_servo_that_must_not_be_moved_is_refused_before_torque(one):
    bus = spoilt((3, *one), kind=V7)
    assert "so101 setup --repair" in trouble_with_moving(bus)
    assert not any(servo.drive.torque for servo in bus.world.servos)
    assert bus.holds(3, reg.PHASE, after_power_off=True) == dict([one]).get("PHASE", 12)


@pytest.mark.parametrize(("name", "value"), [("PHASE", 0), ("PHASE", 4), ("MIN_SPEED", 254)])
def test_a_joint_outside_its_limits_comes_in_at_a_crawl_whatever_the_unit_of_speeds(name, value):
    bus = spoilt((5, name, value))
    narrow = JointMap(servo_id=5, lower_ticks=Ticks(2600), upper_ticks=Ticks(3400))
    maps = {joint: JointMap(servo_id=i) for joint, i in SERVO_IDS.items()} | {"wrist_roll": narrow}
    arm = FeetechArm(
        lambda: bus.wire, bus.clock, maps,
        gravity=WEIGHT, speed=SPEED_CAP, acceleration=ACCELERATION_CAP, reply_timeout=0.0,
    )  # fmt: skip
    reading = arm.read()
    inside = np.array([*reading.q[:4], narrow.lower + 0.3])
    arm.write(reading.q, reading.q_jaw)
    arm.set_torque(True)
    fastest, was, first = 0.0, bus.world.q[4], bus.world.q[4]
    for _ in range(200):
        arm.write(inside, reading.q_jaw)
        arm.read()
        bus.clock.advance(0.01)
        bus.world.advance(bus.clock.now())
        fastest, was = max(fastest, abs(bus.world.q[4] - was) / 0.01), bus.world.q[4]
    assert abs(was - first) > math.radians(5.0)
    assert math.degrees(fastest) < 20.0  # a tick in 10 ms is 9
