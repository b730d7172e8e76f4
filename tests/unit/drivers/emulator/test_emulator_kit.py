"""Handling an emulated kit: plugging servos in, holding the arm up, leading its joints."""

import math

import pytest

from so101_motion.common.clock import ManualClock
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.faults import parse_fault
from so101_motion.planning.kinematics.model import RobotModel


@pytest.fixture
def make_kit():
    made = []

    def make(**options):
        clock = ManualClock()
        weight = RobotModel.load().gravity_torque
        made.append(Emulator(EmulatorOptions(**options), now=clock.now, gravity=weight))
        return made[-1], clock

    yield make
    for kit in made:
        kit.close()


def pass_time(kit, clock, seconds):
    for _ in range(round(seconds / 0.1)):
        clock.advance(0.1)
        kit.advance()


def plugged_in(kit):
    return [servo.joint.name for servo in kit.world.servos if servo.connected]


def test_a_new_kit_has_six_servos_with_the_same_id_and_none_plugged_in(make_kit):
    kit, _ = make_kit(ids=dict.fromkeys(range(1, 7), 1), loose=True, calibrated=False)
    assert plugged_in(kit) == []
    assert {servo.memory.bytes[5] for servo in kit.world.servos} == {1}


def test_one_servo_alone_is_plugged_in_and_in_the_end_all(make_kit):
    kit, _ = make_kit(loose=True)
    kit.begin(parse_fault("only:gripper"))
    assert plugged_in(kit) == ["gripper"]
    kit.begin(parse_fault("only:5"))
    assert plugged_in(kit) == ["wrist_roll"]
    kit.begin(parse_fault("chain"))
    assert len(plugged_in(kit)) == 6
    kit.end(parse_fault("chain"))
    assert plugged_in(kit) == []


def test_a_hand_holds_a_limp_arm_up_until_it_lets_go(make_kit):
    kit, clock = make_kit()
    pass_time(kit, clock, 2.0)
    assert max(abs(kit.world.q)) > 0.5, "it has sunk"
    kit.begin(parse_fault("pose"))
    pass_time(kit, clock, 2.0)
    assert max(abs(kit.world.q)) < math.radians(4.0)
    kit.end(parse_fault("pose"))
    pass_time(kit, clock, 2.0)
    assert max(abs(kit.world.q)) > 0.5, "it has sunk again"


@pytest.mark.parametrize(("fault", "seconds"), [("sweep", 29.0), ("sweep=240", 18.0)])
def test_a_hand_leads_every_joint_to_both_its_stops(make_kit, fault, seconds):
    kit, clock = make_kit()
    kit.begin(parse_fault(fault))
    seen = {servo.joint.name: [math.inf, -math.inf] for servo in kit.world.servos}
    for _ in range(round(seconds / 0.05)):
        clock.advance(0.05)
        kit.advance()
        for servo in kit.world.servos:
            ends = seen[servo.joint.name]
            ends[:] = min(ends[0], servo.drive.q), max(ends[1], servo.drive.q)
    for servo in kit.world.servos:
        stops = (servo.joint.lower, servo.joint.upper)
        assert seen[servo.joint.name] == pytest.approx(stops, abs=math.radians(1.0))
