import math
import time

import numpy as np
import pytest

from so101_motion.common.errors import NoReply, PortUnavailable, ServoFault
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.stale_replies import OVERDUE
from so101_motion.drivers.bus.ticks import RAD_PER_TICK, JointMap, Ticks
from so101_motion.drivers.feetech.feetech_arm import JOINTS, FeetechArm
from so101_motion.drivers.feetech.gravity_compensation import SETTLE_POSITION, SETTLE_VELOCITY

MAPS = {joint: JointMap(servo_id=i) for i, joint in enumerate(JOINTS, start=1)}
ELBOW, JAW = 3, 6
STEP = 0.03  # less than the caps allow in a cycle [rad]


def weightless(q):
    return np.zeros(6)


def heavy(q):
    """An outstretched arm with something in its hand."""
    return np.array([0.0, -0.9, -0.4, 0.0, 0.0, 0.0])


class Stand:
    """An arm on ``WiredPort``: servos, driver and clock, without a thread or a wait."""

    def __init__(self, clock, port):
        self.clock, self.port, self.arm = clock, port, None

    def connect(self, maps=None, gravity=weightless, **settings):
        caps = {"speed": math.radians(180.0), "acceleration": 10.0} | settings
        self.arm = FeetechArm(
            self.plug,
            self.clock,
            MAPS if maps is None else maps,
            gravity=gravity,
            reply_timeout=0.0,
            **caps,
        )
        return self.arm

    def plug(self):
        self.port.check()
        return self.port

    def memory(self, servo, row):
        self.port.world.advance(self.clock.now())
        return self.port.memory(servo, row)

    def torque(self):
        self.port.world.advance(self.clock.now())
        return [int(servo.drive.torque) for servo in self.port.world.servos]

    @property
    def q(self):
        self.port.world.advance(self.clock.now())
        return self.port.world.q

    def hold(self):
        self.seed()
        self.arm.set_torque(True)

    def seed(self):
        reading = self.arm.read()
        self.arm.write(reading.q, reading.q_jaw)
        self.sent = np.array([*reading.q, reading.q_jaw])

    def write(self, q_cmd, q_jaw_cmd):
        """Send the joints on towards a goal, as far as the caps allow in a cycle."""
        self.sent += np.clip([*q_cmd, q_jaw_cmd] - self.sent, -STEP, STEP)
        self.arm.write(self.sent[:5], self.sent[5])

    def follow(self, seconds, q_cmd=None, q_jaw_cmd=0.0):
        for _ in range(round(seconds / 0.01)):
            if q_cmd is not None:
                self.write(q_cmd, q_jaw_cmd)
            self.arm.read()
            self.clock.advance(0.01)
        return self.arm.read()

    def look(self, seconds, dt=0.05):
        """Reads on as the executor does with an arm in a fault; what was raised."""
        raised = []
        for _ in range(round(seconds / dt)):
            try:
                self.arm.read()
            except Exception as error:
                raised.append(error)
            self.clock.advance(dt)
        return raised


@pytest.fixture
def make_stand(clock, wired):
    def make(**servos):
        return Stand(clock, wired(now=clock.now, **servos))

    return make


@pytest.fixture
def stand(make_stand):
    stand = make_stand()
    stand.connect()
    return stand


# Beginning


def test_connecting_moves_nothing_and_leaves_torque_off(stand):
    stand.follow(1.0)
    assert stand.torque() == [0] * 6
    np.testing.assert_allclose(stand.q, 0.0, atol=RAD_PER_TICK)
    assert all(stand.memory(i, reg.GOAL_POSITION) == 0 for i in range(1, 7))


def test_connecting_caps_speed_and_acceleration_in_every_servo(make_stand):
    stand = make_stand()
    stand.connect(speed=math.radians(90.0), acceleration=math.radians(300.0))
    for servo_id in range(1, 7):
        assert stand.memory(servo_id, reg.GOAL_VELOCITY) == 1024
        assert stand.memory(servo_id, reg.ACCELERATION) == 28


def test_a_goal_is_only_remembered_while_the_joints_are_limp(stand):
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


def test_torque_without_a_goal_is_a_mistake(stand):
    with pytest.raises(RuntimeError, match="goal"):
        stand.arm.set_torque(True)


def test_a_servo_in_the_wrong_mode_or_counting_turns_is_put_right_for_good(make_stand):
    stand = make_stand()
    servo = stand.port.world.servo(ELBOW)
    for row, value in ((reg.LOCK, 0), (reg.OPERATING_MODE, 1), (reg.PHASE, 28), (reg.LOCK, 1)):
        servo.write(bytes((row.address, *row.encode(value))))
    stand.connect()
    servo.boot()
    assert stand.memory(ELBOW, reg.OPERATING_MODE) == 0
    assert stand.memory(ELBOW, reg.PHASE) == 12
    assert stand.memory(ELBOW, reg.LOCK) == 1


def test_a_servo_that_does_not_acknowledge_is_taught_to(make_stand):
    stand = make_stand()
    stand.port.world.servo(2).write(bytes((reg.STATUS_LEVEL.address, 0)))
    stand.connect()
    assert stand.memory(2, reg.STATUS_LEVEL) == 1


def test_the_calibration_is_the_truth_and_is_kept_in_the_servo(make_stand):
    stand = make_stand()
    maps = MAPS | {
        "elbow_flex": JointMap.from_calibration(
            servo_id=ELBOW, homing_offset=-100, range_min=1000, range_max=3300
        )
    }
    arm = stand.connect(maps)
    stand.port.world.servo(ELBOW).boot()
    assert stand.memory(ELBOW, reg.HOMING_OFFSET) == -100
    assert stand.memory(ELBOW, reg.MIN_POSITION) == 1000
    assert stand.memory(ELBOW, reg.MAX_POSITION) == 3300
    assert arm.read().q[2] == pytest.approx((2148 - 2150) * RAD_PER_TICK)


def test_without_a_calibration_the_servos_own_is_left_alone(make_stand):
    stand = make_stand()
    before = [stand.memory(i, reg.MAX_POSITION) for i in range(1, 7)]
    stand.connect()
    assert [stand.memory(i, reg.MAX_POSITION) for i in range(1, 7)] == before


def test_a_missing_servo_is_an_error_that_says_where_to_look(make_stand):
    stand = make_stand(ids={1: 1, 2: 2, 3: 3})
    with pytest.raises(NoReply, match=r"wrist_flex.*wrist_roll.*gripper.*between servos 3 and 4"):
        stand.connect()
    assert stand.port.closed


def test_an_arm_without_power_is_told_from_an_arm_without_a_servo(make_stand):
    stand = make_stand(volts=0.0)
    with pytest.raises(NoReply, match="no servo answers; check that the arm's power supply"):
        stand.connect()


def test_a_chain_of_five_servos_works_without_a_jaw(make_stand):
    stand = make_stand(ids={place: place for place in range(1, 6)})
    maps = {joint: MAPS[joint] for joint in JOINTS[:5]}
    arm = stand.connect(maps)
    stand.hold()
    reading = stand.follow(1.0, [0.2] * 5)
    np.testing.assert_allclose(reading.q, 0.2, atol=0.01)
    assert reading.q_jaw == 0.0
    assert [one.joint for one in arm.health] == list(JOINTS[:5])


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


def test_a_jaw_can_be_weakened(stand):
    stand.arm.set_torque_limit("gripper", 0.4)
    assert stand.memory(JAW, reg.TORQUE_LIMIT) == 400
    assert stand.memory(1, reg.TORQUE_LIMIT) == 1000


# Health


def test_health_tells_how_each_servo_is(stand):
    stand.hold()
    stand.port.world.warm(ELBOW, 62.0)
    stand.follow(0.5)
    health = {one.joint: one for one in stand.arm.health}
    assert health["elbow_flex"].temperature_c == 62
    assert health["elbow_flex"].servo_id == ELBOW
    assert health["gripper"].volts == pytest.approx(12.0, abs=0.2)
    assert health["gripper"].faults == ()
    assert not health["gripper"].is_silent
    assert health["gripper"].answers > 50
    assert health["gripper"].lost == health["gripper"].corrupt == 0


def test_a_fault_is_reported_by_name_and_costs_no_reading(stand):
    stand.hold()
    stand.port.world.warm(ELBOW, 75.0)
    stand.follow(0.5, np.zeros(5))
    hot = stand.arm.health[2]
    assert hot.faults == hot.latched == ("overheated",)
    stand.port.world.servo(ELBOW).drive.motor.temperature = 40.0
    stand.port.world.cool(ELBOW)
    stand.follow(0.5)
    assert stand.arm.health[2].faults == ()
    assert stand.arm.health[2].latched == ("overheated",)


def test_an_overloaded_jaw_is_reported_and_the_arm_moves_on(stand):
    stand.hold()
    stand.port.world.put_object(0.02)
    for _ in range(50):
        stand.follow(0.1, np.zeros(5), -1.5)
    assert "overload" in stand.arm.health[5].latched
    np.testing.assert_allclose(stand.follow(1.0, np.full(5, 0.2)).q, 0.2, atol=0.01)


# Silence


def test_a_dead_servo_is_reported_once_by_name_and_the_others_go_on(stand):
    stand.hold()
    stand.port.world.disconnect(ELBOW)
    raised = stand.look(2.0)
    assert len(raised) == 1
    with pytest.raises(NoReply, match=r"servo 3 \(elbow_flex\); the others answer"):
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


def test_letting_go_lets_go_of_all_that_can_be_reached(stand):
    stand.hold()
    stand.port.world.disconnect(2)
    stand.look(1.0)
    stand.arm.set_torque(False)
    assert [stand.torque()[i] for i in (0, 2, 3, 4, 5)] == [0] * 5


def test_letting_go_is_tried_with_all_servos_before_it_fails(stand):
    stand.hold()
    stand.port.world.disconnect(2)
    with pytest.raises(NoReply, match="shoulder_lift"):
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


def test_after_a_restart_the_arm_can_be_used_again(stand):
    stand.hold()
    stand.port.world.reboot(ELBOW)
    stand.look(3.0)
    stand.hold()
    np.testing.assert_allclose(stand.follow(1.5, np.full(5, 0.3)).q, 0.3, atol=0.01)


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


def test_a_brown_out_is_told_as_one_and_the_arm_comes_back(stand):
    stand.hold()
    stand.port.world.power(3.0)
    raised = stand.look(1.0)
    assert "no servo answers; check that the arm's power supply" in str(raised[-1])
    stand.port.world.power(12.0)
    assert isinstance(stand.look(2.0)[-1], ServoFault)
    assert stand.look(1.0) == []
    stand.hold()
    np.testing.assert_allclose(stand.follow(1.5, np.full(5, 0.2)).q, 0.2, atol=0.01)


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
    with pytest.raises(NoReply, match="does not say where it is: no two"):
        stand.arm.write(sent[:5], sent[5])
    assert len(stand.port.sent) == before


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


def test_servos_without_power_after_a_replug_are_looked_for_until_they_are_there(stand):
    stand.port.unplugged = True
    stand.look(0.5)
    stand.port.world.power(0.0)
    stand.port.unplugged = False
    assert all(isinstance(error, (NoReply, PortUnavailable)) for error in stand.look(1.0))
    stand.port.world.power(12.0)
    stand.look(2.0)
    assert stand.arm.is_connected


def test_an_arm_that_was_left_holding_is_taken_over_without_a_jump(make_stand):
    stand = make_stand(gravity=heavy)
    stand.connect()
    stand.hold()
    stand.follow(2.0, np.full(5, 0.2))
    stand.arm.close()
    before = stand.q
    stand.connect()
    stand.hold()
    moved = []
    for _ in range(100):
        stand.follow(0.01)
        moved.append(np.abs(stand.q - before))
    assert np.max(moved) < math.radians(0.3)


def test_closing_leaves_the_servos_holding(stand):
    stand.hold()
    stand.arm.close()
    assert stand.port.closed
    assert stand.torque() == [1] * 6
