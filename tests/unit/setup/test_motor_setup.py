import logging

import pytest
from harness.lent_bus import APART, LentBus, loose, refused
from hypothesis import given, settings
from hypothesis import strategies as st

from so101_motion.calib.motors import single_servo
from so101_motion.calib.motors.setup_view import SETUP_ORDER
from so101_motion.calib.record.record import SERVO_IDS
from so101_motion.common.errors import BusError, MotorSetupError, PortUnavailable, So101Error
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import REPLY_TIMEOUT
from so101_motion.drivers.servo_types import STS3215_7V4
from so101_motion.setup.motor_operation import MotorOperation

KIT = dict.fromkeys(range(1, 7), 1)
"""Six servos as they come: all have id 1."""


# A kit, from the box to the arm


def test_a_kit_is_set_up_from_the_gripper_to_the_shoulder():
    bus = LentBus(KIT, calibrated=False)
    setup = MotorOperation(bus.lent)
    assert setup.state.status == "Motor setup ready"
    assert not setup.state.in_progress
    assert list(SETUP_ORDER) == sorted(SERVO_IDS, key=SERVO_IDS.get, reverse=True), "as published"
    for step, joint in enumerate(SETUP_ORDER):
        assert setup.state.step == step
        assert setup.state.next_joint == joint
        assert f"discover {joint}" in setup.state.next_step
        bus.plug(SERVO_IDS[joint])
        found = setup.discover(joint)
        assert setup.state.motors[joint].state == "found"
        assert (found["current_id"], found["found_baudrate"]) == (1, 1_000_000)
        assert (found["model"], found["firmware"], found["volts"]) == ("sts3215", "3.10", 12.0)
        assert f"assign {joint}" in setup.state.next_step
        done = setup.assign(joint)
        assert (done["old_id"], done["new_id"]) == (1, SERVO_IDS[joint])
        assert setup.state.motors[joint].state == "configured"
        assert setup.state.in_progress == (joint != SETUP_ORDER[-1])
    assert setup.state.next_joint is None
    assert "then verify" in setup.state.next_step

    bus.whole_arm()
    found = setup.verify()
    assert found.ok, found
    assert all(motor.state == "verified" for motor in setup.state.motors.values())
    assert "calibrate" in setup.state.next_step
    assert setup.state.step == 6


@pytest.mark.parametrize(
    ("servo_id", "baud"), [*zip((0, 1, 17, 253, 0, 1, 17, 253), reg.BAUDS, strict=True)]
)
def test_any_id_at_any_rate_is_found_and_set_up_for_good(servo_id, baud):
    bus, setup = loose(servo_id, baud)
    found = setup.discover("gripper")
    assert (found["current_id"], found["found_baudrate"]) == (servo_id, baud)
    assert bus.wire.baud == 1_000_000, "the port is back at its own rate"
    done = setup.assign("gripper")
    assert (done["old_id"], done["old_baudrate"], done["new_id"], done["new_baudrate"]) == (
        servo_id, baud, 6, 1_000_000,
    )  # fmt: skip
    for kept in (False, True):
        assert bus.holds(6, reg.ID, after_power_off=kept) == 6
        assert bus.holds(6, reg.BAUD_RATE, after_power_off=kept) == 0
    assert bus.holds(6, reg.LOCK) == 1
    assert bus.wire.baud == 1_000_000


def test_a_port_with_a_rate_of_its_own_gets_servos_of_that_rate():
    bus = LentBus({6: 1}, calibrated=False, baud=500_000)
    setup = MotorOperation(bus.lent)
    assert setup.assign("gripper")["new_baudrate"] == 500_000
    assert bus.holds(6, reg.BAUD_RATE, after_power_off=True) == 1
    assert bus.wire.baud == 500_000


def test_the_search_begins_at_the_rate_the_user_gives_and_what_was_done_is_logged(caplog):
    bus, setup = loose(1, 57_600)
    with caplog.at_level(logging.INFO, "so101_motion"):
        setup.assign("gripper", current_id=1, target_id=6, current_baudrate=57_600)
    assert bus.rates[0] == 57_600
    assert "id 1 is now id 6, 57600 baud are now 1000000" in caplog.text
    bus, setup = loose(1, 1_000_000)
    done = setup.assign("gripper", current_id=1, target_id=6, current_baudrate=57_600)
    assert done["old_baudrate"] == 1_000_000
    bus, setup = loose(1, 1_000_000)
    assert setup.assign("gripper", current_baudrate=123)["old_baudrate"] == 1_000_000


def test_while_a_servo_is_written_to_the_view_says_not_to_unplug_it(monkeypatch):
    _, setup = loose(6, 1_000_000)
    program, told = single_servo.program, []

    def look(*given):
        told.append((setup.view.doing, setup.view.note))
        return program(*given)

    monkeypatch.setattr(single_servo, "program", look)
    setup.discover("gripper")
    setup.assign("gripper")
    assert told == [("writing to the motor of gripper: do not unplug it yet", "")]
    assert setup.view.doing == ""
    assert setup.state.motors["gripper"].sentence == "gripper: id 6 kept, checked and locked"


# What a servo is given


def test_a_fresh_servo_gets_what_an_arm_needs_and_is_limp():
    bus, setup = loose()
    bus.set(
        6, return_delay=250, operating_mode=1, phase=12 | reg.MULTI_TURN, status_level=0,
        unloading_condition=0, p_gain=8, min_position=0, max_position=1, homing_offset=-900,
    )  # fmt: skip
    changed = setup.assign("gripper")["changed"]
    expected = {
        reg.RETURN_DELAY: 0, reg.OPERATING_MODE: 0, reg.PHASE: 12, reg.STATUS_LEVEL: 1,
        reg.UNLOADING: 44, reg.P_GAIN: 32, reg.D_GAIN: 32, reg.I_GAIN: 0, reg.MIN_POSITION: 0,
        reg.MAX_POSITION: 4095, reg.HOMING_OFFSET: 0, reg.MAX_TORQUE: 500,
    }  # fmt: skip
    for register, value in expected.items():
        assert bus.holds(6, register) == value, register.name
        assert bus.holds(6, register, after_power_off=True) == value, register.name
    assert "phase" in changed
    assert "d_gain" not in changed, "what is right already is not written"
    assert bus.holds(6, reg.TORQUE_ENABLE) == 0


def test_a_servo_that_is_right_already_keeps_its_calibration_and_is_not_written():
    bus, setup = loose(6)
    bus.set(6, p_gain=16, d_gain=40, i_gain=2)
    setup.assign("gripper")
    chosen = [bus.holds(6, row) for row in (reg.P_GAIN, reg.D_GAIN, reg.I_GAIN)]
    assert chosen == [16, 40, 2], "gains that somebody chose are left alone"
    bus.set(6, homing_offset=321, min_position=1000, max_position=2400)
    bus.wire.sent.clear()
    done = setup.assign("gripper")
    assert done["changed"] == []
    assert bus.holds(6, reg.HOMING_OFFSET) == 321
    written = [packet for _, packet in bus.wire.sent if packet[4] == 3]
    assert {packet[5] for packet in written} <= {reg.TORQUE_ENABLE.address, reg.LOCK.address}


def test_a_jaw_that_becomes_a_shoulder_forgets_its_calibration_and_carries_again():
    bus, setup = loose(6)
    bus.set(6, homing_offset=321, min_position=1000, max_position=2400)
    bus.set(6, max_torque=500, overload_torque=25)
    setup.assign("shoulder_lift")
    rows = (reg.HOMING_OFFSET, reg.MAX_POSITION, reg.OVERLOAD_TORQUE, reg.MAX_TORQUE)
    held = [bus.holds(6, row, after_power_off=True) for row in rows]
    assert held == [0, 4095, 80, 1000]


def test_voltage_limits_are_never_touched():
    bus, setup = loose(kind=STS3215_7V4, volts=12.0)
    setup.assign("gripper")
    assert bus.holds(6, reg.MAX_VOLTAGE) == 80
    addresses = {packet[5] for _, packet in bus.wire.sent if packet[4] == 3}
    assert not addresses & {reg.MAX_VOLTAGE.address, reg.MIN_VOLTAGE.address}


# What may be wrong, each in its own words


@pytest.mark.parametrize(("baud", "longest"), [(1_000_000, 1.0), (76_800, 3.0)])
def test_a_servo_is_found_soon_at_the_rates_looked_at_first_and_last(baud, longest):
    bus, setup = loose(1, baud, reply_timeout=REPLY_TIMEOUT)
    assert setup.discover("gripper")["found_baudrate"] == baud
    assert bus.waited < longest


def test_nobody_there_means_power_or_cable_and_is_told_within_three_seconds():
    bus = LentBus({}, calibrated=False, reply_timeout=REPLY_TIMEOUT)
    setup = MotorOperation(bus.lent)
    error = refused(lambda: setup.discover("gripper"), "no servo", "power supply", "3-pin cable")
    motor = setup.state.motors["gripper"]
    assert (motor.state, motor.sentence) == ("failed", error.reason)
    assert setup.state.next_step == motor.fix
    assert "then discover gripper again" in motor.fix
    assert set(bus.rates) | {1_000_000} == set(reg.BAUDS), "all rates were tried"
    assert 0.5 < bus.waited < 3.0


@pytest.mark.parametrize(
    ("loose_servos", "joint", "problem", "words"),
    [
        ({5: 1, 4: 9}, "gripper", "several servos", ("1 and 9 answer", "only the servo")),
        ({5: 1, 6: 1}, "gripper", "same id", ("answer as servo 1 at once",)),
        ({5: 1, 6: 6}, "gripper", "id taken", ("id of gripper, 6",)),
        (None, "elbow_flex", "several servos", ("skip it to verify",)),
    ],
    ids=["two ids", "one id", "its own id", "a whole arm"],
)
@pytest.mark.parametrize("q_start", [APART, (0.0,) * 6])
def test_more_than_one_servo_is_refused_and_nothing_is_written(
    loose_servos, joint, problem, words, q_start
):
    bus = LentBus(loose_servos, calibrated=False, q_start=q_start)
    setup = MotorOperation(bus.lent)
    refused(lambda: setup.discover(joint), problem, *words)
    refused(lambda: setup.assign(joint), problem)
    assert all(packet[4] != 3 for _, packet in bus.wire.sent)


def test_twins_whose_very_pings_collide_are_refused():
    bus = LentBus({5: 1, 6: 1}, calibrated=False)
    bus.faults.corrupt = 1.0
    setup = MotorOperation(bus.lent)
    refused(lambda: setup.discover("gripper"), "same id", "check the plugs")


@pytest.mark.parametrize("second", [6, 1, 99])
def test_a_second_servo_at_another_rate_is_noticed(second):
    bus = LentBus({4: 1, 5: second}, calibrated=False)
    bus.set(4, baud_rate=reg.BAUDS.index(57_600))
    setup = MotorOperation(bus.lent)
    call = lambda: setup.assign("gripper", current_baudrate=57_600)  # noqa: E731
    refused(call, "several servos", "at 57600 baud, and another at 1000000")
    refused(lambda: setup.assign("gripper"), "several servos", "another at 57600")
    assert (bus.holds(4, reg.ID), bus.holds(5, reg.ID)) == (1, second)


def test_a_servo_of_another_kind_is_refused():
    bus, setup = loose()
    bus.set(6, model_number=2825)
    assert setup.discover("gripper")["model"] == "sts3250"
    bus.set(6, model_number=1029)
    refused(lambda: setup.assign("gripper"), "wrong model", "model 1029")


@pytest.mark.parametrize(
    ("options", "sentence", "fix"),
    [
        (
            {"kind": STS3215_7V4, "volts": 12.0},
            "12.0 V but is made for at most 8.0 V: a 7.4 V servo on a 12 V supply",
            "switch the power off now and use a supply of 7.4 V",
        ),
        ({"volts": 4.3}, "only 4.3 V", "USB port cannot feed"),
        ({"volts": 7.4}, "is a 12 V servo", ""),
        ({"kind": STS3215_7V4, "volts": 5.0}, "found a servo", None),  # many arms are fed so
    ],
)
def test_a_wrong_supply_is_reported_and_what_to_do_but_the_id_can_be_set(options, sentence, fix):
    _, setup = loose(**options)
    found = setup.discover("gripper")
    assert sentence in found["status"]
    assert found["fix"] is None if fix is None else fix in found["fix"]
    assert setup.state.fix == (found["fix"] or "")
    assert setup.assign("gripper")["new_id"] == 6


def test_a_port_that_is_gone_is_reported():
    bus, setup = loose()
    bus.wire.unplugged = True
    with pytest.raises(PortUnavailable, match="USB cable"):
        setup.discover("gripper")
    motor = setup.state.motors["gripper"]
    assert motor.state == "failed"
    assert "went away" in motor.sentence
    assert motor.fix.startswith("check the USB cable")
    assert setup.state.doing == ""


def test_the_servo_of_a_motor_that_is_done_is_not_taken_for_the_next():
    _, setup = loose()
    setup.assign("gripper")
    found = setup.discover("wrist_roll")
    assert "That is the id of gripper" in found["status"]
    refused(
        lambda: setup.assign("wrist_roll"), "other servo", "that was set up before", "unplug it"
    )
    setup.forget("gripper")  # its cable was moved too early, so this is the one of wrist_roll
    assert setup.assign("wrist_roll")["new_id"] == 5
    assert setup.state.next_joint == "gripper"


def test_any_joint_may_be_skipped_or_be_the_first():
    bus = LentBus(KIT, calibrated=False)
    setup = MotorOperation(bus.lent)
    bus.plug(1)
    setup.assign("shoulder_pan")
    bus.plug(6)
    assert setup.assign("gripper")["old_id"] == 1
    _, setup = loose()
    for count, joint in enumerate(SETUP_ORDER, start=1):
        assert setup.state.next_joint == joint
        assert setup.skip(joint)["status"] == f"{joint} skipped"
        assert setup.state.step == count
    assert setup.state.next_joint is None
    assert "calibrate" in setup.state.next_step


# A bad wire, and being interrupted


def test_the_view_says_what_is_going_on_and_does_not_wait():
    bus, setup = loose(1, 38_400)
    seen = []
    bus.before = lambda: seen.append((setup.state.doing, setup.state.in_progress))
    setup.discover("gripper")
    assert ("listening at 115200 baud", True) in seen
    assert setup.state.doing == ""


@pytest.mark.parametrize("seed", range(6))
def test_lost_and_garbled_answers_cost_retries_or_a_plain_error_and_never_an_id(seed):
    bus, setup = loose(1, 115_200)
    bus.faults.__init__(seed=seed, loss=0.05, corrupt=0.03, request_loss=0.03)
    for _ in range(30):
        try:
            done = setup.assign("gripper")
        except (MotorSetupError, BusError):
            assert setup.state.motors["gripper"].state == "failed"
            continue
        assert done["new_id"] == 6
        break
    bus.faults.__init__()
    assert bus.holds(6, reg.ID, after_power_off=True) == 6
    assert bus.holds(6, reg.BAUD_RATE, after_power_off=True) == 0
    assert setup.assign("gripper")["changed"] == []


@pytest.mark.parametrize("lost", range(20))
def test_a_moment_of_silence_never_means_that_the_id_was_not_taken(lost):
    """Nor that another motor, whose id a new one has, did not answer."""
    bus, setup = loose()
    jobs = iter(range(1000))

    def be_silent_once():
        bus.plug(*(() if next(jobs) == lost else (6,)))

    bus.before = be_silent_once
    problem, said = "", ""
    try:
        setup.assign("gripper")
    except MotorSetupError as error:
        problem, said = error.problem, str(error)
    assert problem != "not taken"
    assert "shoulder_pan" not in said


class _PlugPulled(Exception):
    pass


def test_it_can_be_taken_up_again_wherever_it_was_cut_off():
    for cut in range(1, 40):
        bus, setup = loose(1, 57_600)
        bus.set(6, homing_offset=500)
        jobs = iter(range(1, 1000))

        def pull(jobs=jobs, cut=cut):
            if next(jobs) == cut:
                raise _PlugPulled

        bus.before = pull
        try:
            setup.assign("gripper", current_baudrate=57_600)
        except _PlugPulled:
            pass
        else:
            break
        bus.before = lambda: None
        bus.wire.baud = 1_000_000
        assert setup.assign("gripper")["new_baudrate"] == 1_000_000
        assert bus.holds(6, reg.ID, after_power_off=True) == 6
        assert bus.holds(6, reg.HOMING_OFFSET, after_power_off=True) == 0
        assert bus.holds(6, reg.LOCK) == 1
    assert cut > 10, "it was cut off at every job"


# No servo's id is ever changed unasked, whatever is plugged in and requested


RATES = (1_000_000, 115_200, 38_400)
joints = st.sampled_from(SETUP_ORDER)

kits = st.lists(
    st.tuples(st.sampled_from([1, 1, 1, 2, 5, 6, 17, 253]), st.sampled_from(RATES)),
    min_size=6,
    max_size=6,
)
requests = st.lists(
    st.one_of(
        st.tuples(st.just("plug"), st.sets(st.integers(1, 6), max_size=2)),
        st.tuples(st.just("plug"), st.sets(st.integers(1, 6))),
        st.tuples(st.just("discover"), joints),
        st.tuples(st.just("assign"), joints),
        st.tuples(st.just("assign"), joints),
        st.tuples(st.just("skip"), joints),
        st.tuples(st.just("verify"), st.none()),
        st.tuples(st.just("reset"), st.none()),
    ),
    max_size=12,
)


def state(bus):
    """Id and rate of every servo, by place."""
    return {i: (servo.servo_id, servo.baud) for i, servo in enumerate(bus.world.servos, start=1)}


def carry_out(setup, name, argument):
    try:
        getattr(setup, name)(*(() if argument is None else (argument,)))
    except So101Error as error:
        return error
    return None


@settings(max_examples=100)
@given(kits, requests)
def test_only_a_servo_that_is_alone_is_changed_and_only_as_asked(kit, wanted):
    bus = LentBus(calibrated=False)
    for place, (servo_id, baud) in enumerate(kit, start=1):
        bus.set(place, id=servo_id, baud_rate=reg.BAUDS.index(baud))
    setup = MotorOperation(bus.lent)
    plugged = set(range(1, 7))
    for name, argument in wanted:
        if name == "plug":
            plugged = argument
            bus.plug(*argument)
            continue
        before = state(bus)
        error = carry_out(setup, name, argument)
        changed = {place for place, now in state(bus).items() if now != before[place]}
        if changed:
            assert name == "assign"
            assert changed == plugged
            assert len(plugged) == 1
        if name == "assign" and error is None:
            (place,) = plugged
            assert state(bus)[place] == (SERVO_IDS[argument], 1_000_000)
            assert setup.state.motors[argument].state == "configured"
        if name == "assign" and len(plugged) != 1:
            assert error is not None
        assert bus.wire.baud == 1_000_000, "the port is back at its own rate"
        assert setup.state.doing == ""
        assert setup.state.next_step
