"""An arm in manual mode carries itself and yields to a hand; emulated servos, hand and weight."""

import math

import numpy as np
import pytest
from harness.servo_stand import Guided, hand_leads

from so101_motion.common.compliance import Compliance
from so101_motion.common.errors import PortUnavailable
from so101_motion.drivers.feetech.feetech_arm import JOINTS


@pytest.fixture
def make(wired):
    return lambda **options: Guided(wired, **options)


# Holding itself


@pytest.mark.parametrize("heavier", [1.0, 1.2, 1.4])
def test_it_stays_where_it_is_while_nobody_touches_it(make, heavier):
    arm = make(heavier=heavier)
    arm.arm.guide(Compliance())
    assert arm.look(3.0).max() < 0.3


def test_only_ram_registers_are_written(make):
    arm = make()
    before = [bytes(servo.memory.bytes[:40]) for servo in arm.port.world.servos]
    saved = [servo.memory.flash for servo in arm.port.world.servos]
    arm.arm.guide(Compliance())
    arm.hand(hand_leads("shoulder_pan", 0.0, 30.0, 1.0))
    arm.look(3.0)
    arm.arm.guide(None)
    arm.look(0.2)
    after = [bytes(servo.memory.bytes[:40]) for servo in arm.port.world.servos]

    assert after == before
    assert [servo.memory.flash for servo in arm.port.world.servos] == saved


def test_no_joint_is_given_more_than_its_torque_limit(make):
    arm = make()
    arm.arm.set_torque_limit("shoulder_lift", 0.03)
    arm.arm.guide(Compliance())
    for _ in range(50):
        arm.look(0.01)
        assert arm.limits()[1] <= 30


# Yielding


@pytest.mark.parametrize(
    ("joint", "by_deg", "heavier"),
    [("shoulder_lift", -40.0, 1.2), ("elbow_flex", -40.0, 1.2), ("wrist_roll", -40.0, 1.0)],
)
def test_it_goes_where_a_hand_leads_it_and_stays_there(make, joint, by_deg, heavier):
    arm, i = make(heavier=heavier), JOINTS.index(joint)
    arm.arm.guide(Compliance())
    start = arm.q_deg
    hand = arm.hand(hand_leads(joint, start[i], by_deg, 4.0))
    arm.look(5.0)
    reached = arm.q_deg
    assert reached[i] - start[i] == pytest.approx(by_deg, abs=2.0), "it stops when friction does"
    assert max(hand.felt) < 1.1, "10 deg/s: gears and motor brake by 0.35 N m, under load by 0.7"
    away = arm.look(4.0)

    assert away.max() < 3.0
    assert arm.look(2.0).max() < 0.6, "it has come to rest"


def test_a_stiffer_arm_is_harder_to_push_and_one_that_resists_less_is_not(make):
    felt = {}
    for name, how in {
        "default": Compliance(),
        "stiff": Compliance(p_gain=32.0, resistance=0.1, dead_band=math.radians(3.0)),
        "weak": Compliance(p_gain=32.0, resistance=0.015, dead_band=math.radians(3.0)),
    }.items():
        arm = make()
        arm.arm.guide(how)
        hand = arm.hand(hand_leads("shoulder_pan", arm.q_deg[0], 20.0, 4.0))
        arm.look(5.0)
        felt[name] = np.mean(hand.felt)

    assert felt["stiff"] > 1.5 * felt["weak"]
    assert felt["stiff"] > 1.5 * felt["default"]


def test_a_joint_pushed_within_its_dead_band_comes_back(make):
    arm = make()
    arm.arm.guide(Compliance(dead_band=math.radians(5.0), p_gain=32.0, resistance=0.06))
    start = arm.q_deg[0]
    arm.hand(hand_leads("shoulder_pan", start, 4.0, 1.0))
    arm.look(1.9)
    assert arm.q_deg[0] - start > 1.7
    arm.look(3.0)

    assert arm.q_deg[0] == pytest.approx(start, abs=1.2)


# Ending


def test_afterwards_it_holds_where_it_was_left_with_all_its_strength(make):
    arm = make(heavier=1.2)
    arm.arm.guide(Compliance())
    arm.hand(hand_leads("shoulder_lift", arm.q_deg[1], -30.0, 1.0))
    arm.look(4.0)
    assert max(arm.limits()[:5]) < 400
    left = arm.q_deg
    arm.arm.guide(None)
    assert arm.limits() == [1000] * 6
    assert arm.look(3.0).max() < 0.9
    assert arm.q_deg == pytest.approx(left, abs=0.9)


def test_answers_that_are_lost_as_it_ends_put_no_joint_elsewhere(make):
    """It was led away from where it was wanted before; that is no way it was sent on."""
    arm = make()
    arm.arm.guide(Compliance())
    arm.hand(hand_leads("shoulder_pan", 0.0, 30.0, 1.0))
    arm.look(3.0)
    arm.arm.guide(None)
    arm.port.faults.loss = 1.0
    reading = arm.arm.read()
    arm.port.faults.loss = 0.0

    assert np.degrees(reading.q) == pytest.approx(arm.q_deg[:5], abs=0.5)


def test_letting_go_and_holding_again_end_it_too_and_only_a_held_arm_is_guided(make):
    arm = make()
    for on in (True, False):
        arm.arm.guide(Compliance())
        arm.look(0.3)
        arm.arm.set_torque(on)
        assert arm.limits() == [1000] * 6
    with pytest.raises(RuntimeError, match="hold the joints"):
        arm.arm.guide(Compliance())


@pytest.mark.parametrize("pushing", [False, True])
def test_a_program_that_died_meanwhile_leaves_no_trace_and_the_next_moves_nothing(make, pushing):
    arm = make(heavier=1.2)
    arm.arm.guide(Compliance())
    arm.look(0.5)
    if pushing:
        arm.hand("0 shoulder_lift start\n0.5 shoulder_lift -40\n9.0 shoulder_lift release\n")
    arm.look(1.0)
    arm.clock.advance(0.3)  # nobody looks any more
    assert max(arm.limits()[:5]) < 500
    before = arm.q_deg
    arm.connect()
    arm.look(0.5)

    assert arm.limits() == [1000] * 6
    assert arm.q_deg == pytest.approx(before, abs=0.5)


def test_a_port_that_goes_away_ends_it(make):
    arm = make()
    arm.arm.guide(Compliance())
    arm.look(0.5)
    arm.port.unplugged = True
    with pytest.raises(PortUnavailable, match="went away"):
        arm.arm.read()
    arm.port.unplugged = False
    arm.clock.advance(1.0)
    before = arm.q_deg
    arm.arm.read()

    assert arm.limits() == [1000] * 6
    assert arm.look(0.5, dt=0.05).max() < 0.5
    assert arm.q_deg == pytest.approx(before, abs=0.5)
