import math
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from harness.servo_stand import ELBOW, JAW, heavy, weightless

from so101_motion.common.errors import NoReply, PortUnavailable, ServoFault
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.ticks import RAD_PER_TICK
from so101_motion.drivers.feetech.presence import missing_servos

# Silence


@pytest.mark.parametrize(
    ("answering", "told"),
    [([7], "the ids run from 2 to 7, not from 1 to 6"), ([], "no reply from 1 on /dev/x")],
)
def test_ids_that_begin_at_another_number_are_told_apart_from_a_silent_servo(answering, told):
    port = SimpleNamespace(name="/dev/x")
    bus = SimpleNamespace(answering=lambda ids, tries: answering, label=str, port=port)
    assert str(missing_servos(bus, [1], range(2, 7))).startswith(told)


def test_a_dead_servo_is_reported_once_by_name_and_the_others_go_on(stand):
    stand.hold()
    stand.port.world.disconnect(ELBOW)
    raised = stand.look(2.0)
    assert len(raised) == 1
    with pytest.raises(NoReply, match=r"servo 3 \(elbow_flex\) on .*; the others .* Support"):
        raise raised[0]
    assert [one.is_silent for one in stand.arm.health] == [False, False, True, False, False, False]
    stand.seed()
    np.testing.assert_allclose(stand.follow(1.5, [0.3, 0, 0, 0, 0]).q[0], 0.3, atol=0.01)


def test_a_few_lost_answers_are_no_silence(stand):
    stand.hold()
    stand.port.faults.loss, stand.port.faults.corrupt = 0.05, 0.02
    for _ in range(200):
        stand.follow(0.05, np.zeros(5))
    assert all(not one.is_silent for one in stand.arm.health)
    assert sum(one.lost for one in stand.arm.health) > 100


def test_where_a_joint_is_taken_to_be_is_no_surer_than_its_last_answer(stand):
    stand.hold()
    stand.follow(0.3, np.zeros(5), 1.0)
    for loss, seconds in ((1.0, 0.3), (0.0, 0.0), (1.0, 0.05)):
        stand.port.faults.loss = loss
        reading = stand.follow(seconds, np.zeros(5), 1.0)
    assert "gripper" in reading.unanswered
    assert "gripper" in reading.unconfirmed  # or it would be held where it may not be
    stand.port.faults.loss = 0.0
    assert not stand.follow(0.2, np.zeros(5), 1.0).unconfirmed


def test_an_arm_with_a_dead_joint_is_not_switched_on(stand):
    stand.port.world.disconnect(ELBOW)
    stand.look(1.0)
    reading = stand.arm.read()
    stand.arm.write(reading.q, reading.q_jaw)
    with pytest.raises(NoReply, match="elbow_flex"):
        stand.arm.set_torque(True)
    assert stand.torque() == [0] * 6


def test_an_arm_with_a_dead_jaw_works(stand):
    stand.hold()
    stand.port.world.disconnect(JAW)
    assert len(stand.look(1.0)) == 1
    stand.hold()
    np.testing.assert_allclose(stand.follow(1.0, np.full(5, 0.2)).q, 0.2, atol=0.01)


@pytest.mark.parametrize("is_known_to_be_dead", [False, True])
def test_letting_go_is_tried_with_all_servos_before_it_fails(stand, is_known_to_be_dead):
    stand.hold()
    stand.port.world.disconnect(2)
    stand.look(is_known_to_be_dead * 1.0)
    fails = nullcontext() if is_known_to_be_dead else pytest.raises(NoReply, match="shoulder_lift")
    with fails:
        stand.arm.set_torque(False)
    assert [stand.torque()[i] for i in (0, 2, 3, 4, 5)] == [0] * 5


def test_a_servo_that_restarted_holds_where_it_is_with_its_caps_and_says_so_once(stand):
    stand.arm.set_torque_limit("elbow_flex", 0.8)
    stand.hold()
    stand.follow(1.5, np.full(5, 0.3))
    stand.port.world.reboot(ELBOW)
    raised = stand.look(3.0)
    assert [type(error) for error in raised] == [NoReply, ServoFault]
    assert "servo 3 (elbow_flex) restarted" in str(raised[1])
    assert stand.torque() == [1] * 6
    assert stand.memory(ELBOW, reg.ACCELERATION) == stand.memory(1, reg.ACCELERATION)
    assert stand.memory(ELBOW, reg.GOAL_VELOCITY) == stand.memory(1, reg.GOAL_VELOCITY)
    assert stand.memory(ELBOW, reg.TORQUE_LIMIT) == 800
    np.testing.assert_allclose(stand.q[:5], 0.3, atol=0.01)
    stand.hold()
    np.testing.assert_allclose(stand.follow(1.5, np.full(5, 0.2)).q, 0.2, atol=0.01)


def test_a_servo_that_comes_back_too_hot_to_hold_is_named_and_the_others_are_still_read(stand):
    stand.hold()
    stand.port.world.disconnect(ELBOW)
    stand.look(1.0)
    stand.port.world.warm(ELBOW, 80.0)
    stand.port.world.connect(ELBOW)
    raised = stand.look(2.0)
    assert [type(error) for error in raised] == [ServoFault]
    assert stand.look(1.0) == []
    assert stand.arm.health[2].faults == ("overheated",)


def test_a_servo_that_comes_back_on_a_very_bad_wire_is_set_up_in_the_end(stand):
    stand.hold()
    stand.port.world.reboot(ELBOW)
    stand.look(0.7)
    stand.port.faults.corrupt = 0.5
    stand.look(4.0)
    stand.port.faults.corrupt = 0.0
    stand.look(2.0)
    assert stand.torque() == [1] * 6
    assert stand.memory(ELBOW, reg.ACCELERATION) == stand.memory(1, reg.ACCELERATION)


def test_a_servo_that_was_only_unheard_goes_on_holding(stand):
    stand.hold()
    stand.port.faults.loss = 1.0
    raised = stand.look(1.0)
    stand.port.faults.loss = 0.0
    assert all(isinstance(error, NoReply) for error in raised)
    assert stand.look(0.5) == []
    assert stand.torque() == [1] * 6


# The port


def test_joints_that_have_just_lost_their_power_are_not_held_where_they_once_were(make_stand):
    stand = make_stand(gravity=heavy)
    stand.connect(gravity=heavy)
    stand.hold()
    stand.follow(1.0)
    sent = stand.sent + RAD_PER_TICK
    stand.port.world.power(0.0)
    stand.follow(0.15)
    before = len(stand.port.sent)
    with pytest.raises(NoReply, match=r"the position of .* is not clear: no two"):
        stand.arm.write(sent[:5], sent[5])
    assert len(stand.port.sent) == before


def test_torque_does_not_come_on_at_a_position_that_no_two_answers_confirm(stand):
    stand.seed()
    stand.port.faults.loss = 1.0
    stand.follow(0.15)
    stand.port.faults.loss = 0.0
    with pytest.raises(NoReply, match=r"the position of .* is not clear: no two"):
        stand.arm.set_torque(True)
    assert stand.torque() == [0] * 6


def test_an_unplugged_port_is_an_error_at_once_and_comes_back_without_a_jump(make_stand):
    stand = make_stand(gravity=heavy)
    stand.connect(gravity=weightless)
    stand.hold()
    stand.follow(2.0)
    before = stand.q
    stand.port.unplugged = True
    with pytest.raises(PortUnavailable):
        stand.arm.write(np.zeros(5), 0.0)
    assert not stand.arm.is_connected
    assert all(isinstance(error, PortUnavailable) for error in stand.look(2.0))
    stand.port.unplugged = False
    stand.look(3.0)
    assert stand.arm.is_connected
    assert stand.arm.port_losses == 1
    moved = [np.abs(stand.q - before)]
    stand.hold()
    for _ in range(100):
        stand.follow(0.01)
        moved.append(np.abs(stand.q - before))
    assert np.max(moved) < math.radians(0.5)


def test_nothing_is_written_to_the_servos_before_somebody_asks(stand):
    stand.hold()
    stand.follow(1.0, np.full(5, 0.2))
    stand.port.unplugged = True
    stand.look(1.0)
    stand.port.unplugged = False
    stand.look(1.0)
    stand.port.sent.clear()
    stand.look(1.0)
    assert all(packet[4] == 0x82 for packet in stand.port.sent)


def test_writing_and_switching_without_a_port_is_refused(stand):
    stand.port.unplugged = True
    stand.look(0.1)
    stand.port.unplugged = False
    for use in (
        lambda: stand.arm.write(np.zeros(5), 0.0),
        lambda: stand.arm.set_torque(True),
        lambda: stand.arm.set_torque_limit("gripper", 0.4),
        lambda: stand.arm.bus,
    ):
        with pytest.raises(PortUnavailable, match="not connected at present"):
            use()


def test_closing_leaves_the_servos_holding_and_they_are_taken_over_without_a_jump(make_stand):
    stand = make_stand(gravity=heavy)
    stand.connect()
    stand.hold()
    stand.follow(2.0, np.full(5, 0.2))
    stand.arm.close()
    assert stand.port.closed
    assert stand.torque() == [1] * 6
    before = stand.q
    stand.connect()
    stand.hold()
    moved = []
    for _ in range(100):
        stand.follow(0.01)
        moved.append(np.abs(stand.q - before))
    assert np.max(moved) < math.radians(0.3)
