"""A joint that a hand leads is light, and slows down by itself; on emulated servos that differ."""

import math

import numpy as np
import pytest
from harness.emulated_rig import loaded
from harness.servo_stand import WEIGHT, Guided, hand_leads
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.common.compliance import Compliance
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_rad
from so101_motion.drivers.feetech.gravity_compensation import Trim
from so101_motion.drivers.feetech.hand_guiding import (
    FAST,
    HELP_BRAKE,
    HELP_FRICTION,
    LEAD,
    SLOW,
    HandGuiding,
)
from so101_motion.drivers.servo_types import STS3215_7V4, ServoFigures

SLIPPERY = {joint: ServoFigures(friction=0.67) for joint in ARM_JOINTS}
GRIPPY = {joint: ServoFigures(friction=1.33) for joint in ARM_JOINTS}
FOLDED, STRETCHED = (0.0, -1.17, -0.15, -0.53, -0.42, 0.3), (0.0, 0.1, 0.1, 0.0, 0.0, 0.3)
LATE = 0.02
STRONG = 6.0
"""Torque of a hand that leads a joint at 90 deg/s [N m]."""

ARMS = {
    "servos that differ, late cycles": dict(spread=0.2, seed=2, late=LATE),
    "a third less friction, late cycles": dict(figures=SLIPPERY, late=LATE),
    "7.4 V, a third less friction, late": dict(figures=SLIPPERY, kind=STS3215_7V4, late=LATE),
    "a third more friction": dict(figures=GRIPPY),
    "0.3 kg in the hand": dict(gravity=loaded(0.3).gravity_torque, spread=0.2, seed=4),
}


def hand_leads_all(q_deg, by_deg, seconds, hold=0.0):
    """A hand that takes all joints after 0.1 s, leads them and lets go, in motion without hold."""
    lines = []
    for joint, at in zip(ARM_JOINTS, q_deg, strict=False):
        lines += [
            f"0.1 {joint} start",
            f"{0.1 + seconds} {joint} {at + by_deg}",
            f"{0.1 + seconds + hold} {joint} release",
        ]
    return "\n".join(lines)


@pytest.mark.parametrize("joint", ["shoulder_pan", "wrist_roll"])
def test_a_hand_leads_a_joint_easily(wired, joint):
    arm = Guided(wired)
    arm.arm.guide(Compliance())
    hand = arm.hand(hand_leads(joint, 0.0, 30.0, 1.0))
    arm.look(1.4)
    assert np.median(hand.felt) < 0.75, "a limp joint takes 0.17 N m, one with a shorted motor 1"


@pytest.mark.parametrize(("speed", "most", "by_deg"), [(30.0, 5.0, 1.0), (90.0, 12.0, -1.0)])
@pytest.mark.parametrize("name", ARMS)
def test_a_joint_that_is_let_go_in_motion_comes_to_rest_and_stays_there(
    wired, name, speed, most, by_deg
):
    options = dict(ARMS[name])
    late = options.pop("late", 0.0)
    arm = Guided(wired, **options)
    arm.arm.guide(Compliance())
    before = arm.q_deg
    arm.hand(hand_leads_all(before, 18.0 * by_deg, 18.0 / speed), STRONG)
    arm.look(0.1 + 18.0 / speed, late=late)
    assert np.all((arm.q_deg - before)[:5] * by_deg > 4.0), "all were led"

    assert arm.look(2.0, late=late).max() < most
    assert arm.look(1.0, late=late).max() < 0.3


@pytest.mark.parametrize(("pose", "seed"), [(FOLDED, 0), (STRETCHED, 1)])
def test_an_arm_whose_object_is_taken_away_neither_rises_nor_goes_on_when_it_is_led(
    wired, pose, seed
):
    arm = Guided(wired, gravity=loaded(0.3).gravity_torque, q_start=pose, spread=0.2, seed=seed)
    arm.arm.guide(Compliance())
    arm.look(0.3)
    arm.port.world.gravity = WEIGHT
    assert arm.look(2.0).max() < 1.5, "it jumped by 30 to 50 deg once"
    way = 60.0 if pose is FOLDED else -60.0
    before = arm.q_deg[1]
    arm.hand(hand_leads("shoulder_lift", before, way, 2.0), 2.0)
    arm.look(3.01)
    assert (arm.q_deg[1] - before) / way > 0.8

    assert arm.look(2.0).max() < 3.0
    assert arm.look(1.0).max() < 0.3


def test_an_object_taken_up_while_guided_is_known_after_a_small_move(wired):
    arm = Guided(wired, q_start=(0.0, -0.2, 0.0, 0.2, 0.0, 0.3), spread=0.2, seed=0)
    arm.arm.guide(Compliance())
    arm.port.world.gravity = loaded(0.2).gravity_torque
    arm.look(1.0)
    arm.arm.guide(None)
    q = arm.arm.read().q
    for k in range(200):
        there_and_back = math.sin(0.01 * math.pi * k) * np.array([0.0, 0.2, -0.1, 0.0, 0.0])
        arm.arm.write(q + there_and_back, 0.3)
        arm.look(0.01)
    arm.look(1.0)
    arm.arm.guide(Compliance())
    arm.hand(hand_leads("shoulder_lift", arm.q_deg[1], -25.0, 1.7), 3.0)
    arm.look(2.71)
    assert arm.look(3.0).max() < 2.0, "without the move it sinks by 45 to 75 deg"


@pytest.mark.parametrize(
    ("joint", "seed", "held_kg"), [("shoulder_lift", 0, 0.3), ("elbow_flex", 2, 0.0)]
)
def test_a_joint_that_is_led_far_stays_where_it_is_let_go(wired, joint, seed, held_kg):
    weight = loaded(held_kg).gravity_torque
    arm = Guided(wired, gravity=weight, q_start=FOLDED, spread=0.2, seed=seed)
    arm.arm.guide(Compliance())
    arm.hand(hand_leads(joint, arm.q_deg[ARM_JOINTS.index(joint)], 70.0, 2.3))
    arm.look(3.31)
    assert arm.look(2.0).max() < 2.0, "the elbow rose by 15 deg once"


@pytest.mark.parametrize(("stronger", "late", "seed"), [(2.0, 0.0, 0), (1.4, LATE, 1)])
def test_joints_between_walls_that_are_stronger_come_to_rest(wired, stronger, late, seed):
    arm = Guided(wired, spread=0.2, seed=seed)
    arm.arm.guide(
        Compliance(wall=stronger * Compliance().wall), lambda q, q_guided: 0.0 * q_guided + q
    )
    arm.hand(hand_leads_all(arm.q_deg, 8.0, 0.3, hold=0.4), 3.0)
    arm.look(1.8, late=late)
    assert arm.look(1.0, late=late).max() < 0.1


# Without servos: how hard a joint in motion is driven


def guided_at(speed, wall=None):
    """Goal beyond the joint [rad], limit of its drive, and model; the pan after 0.5 s at speed."""
    trim = Trim(lambda q: np.zeros(6))
    guide = HandGuiding(Compliance(), trim, [0.0] * 6, 0.0, wall)
    q, goals, shares = [0.0] * 6, [0.0], [0.0]
    for k in range(1, 51):
        q[0] = speed * k * 0.01
        goals, shares = guide.step(q, [speed, *[0.0] * 5], k * 0.01)
    return goals[0] - q[0], shares[0], trim.models[0]


@given(speed=st.floats(SLOW, 4.0), side=st.sampled_from([1.0, -1.0]))
def test_a_moving_joint_is_driven_by_less_than_brakes_it(speed, side):
    ahead, share, model = guided_at(side * speed)
    wanted = model.distance(HELP_FRICTION * model.friction(0.0, 1.0), HELP_BRAKE * min(speed, FAST))
    assert ahead * side <= 0.0 or share <= model.drive(wanted)
    assert HELP_FRICTION < 2.0 / 3.0, "friction may be a third less than modelled"
    assert HELP_BRAKE < 2.0 / 3.0, "and so may the motor brake"
    assert abs(ahead) <= wanted + LEAD * FAST


def test_nothing_leads_a_joint_towards_a_wall_near_by():
    speed = to_rad(30.0)
    there = 0.5 * speed + 0.5 * LEAD * speed
    free, *_ = guided_at(speed)
    near, *_ = guided_at(speed, lambda q, q_guided: np.minimum(q_guided, there))
    assert free > LEAD * (speed - SLOW)
    assert near <= 0.0


def test_no_goal_is_faster_than_twice_the_speed_that_is_helped():
    """A strong hand breaks through a wall, and flings the joint."""
    guide = HandGuiding(Compliance(), Trim(lambda q: np.zeros(6)), [0.0] * 6, 0.0)
    q, speed, before = [0.0] * 6, 0.0, 0.0
    for k in range(1, 31):
        speed = min(speed + 0.15, 1.6)
        q[0] += 0.01 * speed
        goals, _ = guide.step(q, [speed, *[0.0] * 5], 0.01 * k)
        assert goals[0] - before <= 0.02 * FAST + 0.002, "what it is helped by may grow meanwhile"
        before = goals[0]
    assert before - q[0] > LEAD * (FAST - SLOW), "the goal leads all the same"
