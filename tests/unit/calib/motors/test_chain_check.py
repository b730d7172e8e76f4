"""The check of a finished chain of servos, as ``verify`` and ``scan`` report it."""

import pytest
from harness.lent_bus import LentBus

from so101_motion.common.errors import MotorSetupError
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.servo_types import STS3215_7V4
from so101_motion.setup.motor_operation import MotorOperation


def arm(**options):
    bus = LentBus(**options)
    return bus, MotorOperation(bus.lent)


def check(setup, joint):
    found = setup.verify()
    assert not found.ok
    return found.motors[joint]


TWINS = {1: 1, 2: 2, 3: 3, 4: 3, 5: 5, 6: 6}


def test_a_finished_arm_is_verified_without_writing():
    bus, setup = arm()
    found = setup.verify()
    assert found.ok
    assert found.sentence == "all six servos are set up correctly"
    assert [check.servo_id for check in found.motors.values()] == [1, 2, 3, 4, 5, 6]
    assert all(check.facts.model == "sts3215" for check in found.motors.values())
    assert all(packet[4] in (1, 2, 0x82) for _, packet in bus.wire.sent)


def test_for_a_dark_arm_the_advice_is_to_switch_it_on():
    _, setup = arm(volts=0.0)
    found = setup.verify()
    assert not found.ok
    assert "power supply" in found.sentence
    assert {check.status for check in found.motors.values()} == {"not_responding"}
    assert "power supply" in setup.state.next_step


def test_a_chain_that_is_cut_names_the_cable():
    bus, setup = arm()
    bus.plug(1, 2, 3)
    missing = check(setup, "wrist_flex")
    assert missing.status == "not_responding"
    assert "between servos 3 and 4" in missing.fix
    assert check(setup, "gripper").fix == missing.fix  # whoever is behind it is silent as well
    assert setup.state.motors["wrist_flex"].state == "failed"
    assert setup.state.motors["elbow_flex"].state == "verified"
    bus.whole_arm()
    assert setup.verify().ok
    _, setup = arm(ids={1: 1, 2: 2, 3: 3, 4: 7, 5: 8, 6: 9})  # with the wheels of a LeKiwi
    fix = check(setup, "wrist_flex").fix
    assert "between servos 3 and 4, or set wrist_flex up again if it answers as 7 or 8 or 9" in fix


def test_two_servos_with_one_id_are_named_and_garbled_answers_are_no_twins():
    _, setup = arm(ids=TWINS)
    twins = check(setup, "elbow_flex")
    assert twins.status == "duplicate"
    assert "several servos answer as 3 (elbow_flex) at once, and none as 4" in twins.error
    missing = check(setup, "wrist_flex")
    assert missing.status == "not_responding"
    assert missing.error.endswith("it may be one of those that answer as 3")
    assert "so101 setup --joint elbow_flex, then --joint wrist_flex" in missing.fix
    _, setup = arm(ids=TWINS | {1: 17, 2: 17, 4: 4})
    assert "answer as" not in check(setup, "shoulder_pan").error  # 17 is no joint's
    _, setup = arm(ids=TWINS, q_start=(0.0,) * 6, calibrated=False)  # though they hold the same
    assert check(setup, "elbow_flex").status == "duplicate"
    bus, setup = arm()
    bus.faults.corrupt = 0.07
    assert "duplicate" not in {check.status for check in setup.verify().motors.values()}


def test_a_servo_or_a_whole_arm_at_another_rate_is_found():
    bus, setup = arm()
    bus.set(5, baud_rate=reg.BAUDS.index(115_200))
    missing = check(setup, "wrist_roll")
    assert "servo 5 (wrist_roll) talks at 115200 baud, not at 1000000" in missing.error
    assert bus.wire.baud == 1_000_000
    for place in range(1, 7):
        bus.set(place, baud_rate=reg.BAUDS.index(500_000))
    found = setup.verify()
    assert "at 500000 baud, so the supply is on" in found.sentence
    assert "so101 setup --repair" in found.motors["gripper"].fix


def test_strangers_and_other_kinds_are_named():
    bus, setup = arm(ids={1: 1, 2: 2, 3: 3, 4: 4, 5: 5, 6: 9})
    found = setup.verify()
    assert found.unexpected_ids == (9,)
    assert "discover gripper" not in found.motors["wrist_roll"].fix
    assert any("9" in note for note in found.notes)
    bus, setup = arm()
    bus.set(2, model_number=1029)
    assert check(setup, "shoulder_lift").status == "wrong_model"
    bus.set(2, model_number=2825)
    found = setup.verify()
    assert found.ok
    assert "sts3250: it works" in found.notes[0]
    bus, setup = arm()
    bus.set(4, firmware_minor=9)
    found = setup.verify()
    assert found.ok
    assert "servo 4 3.9" in found.notes[0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"operating_mode": 3}, "in mode 3"),
        ({"phase": 12 | reg.MULTI_TURN}, "more than one turn"),
        ({"min_position": 1, "max_position": 1}, "no travel"),
        ({"status_level": 0}, "acknowledge"),
        ({"max_torque": 0}, "torque is 0"),
        ({"unloading_condition": 8}, "protection"),
        ({"phase": 0}, "50 times"),
        ({"phase": 12 | reg.REVERSED}, "backwards"),
        ({"p_gain": 4, "d_gain": 0}, "gains are P 4, D 0, I 0"),
        ({"angular_resolution": 3}, "resolution is 3"),
        ({"ccw_dead_zone": 16}, "dead zone"),
    ],
)
def test_settings_that_keep_an_arm_from_working_are_named_and_mended(changes, words):
    bus, setup = arm()
    bus.set(3, **changes)
    odd = check(setup, "elbow_flex")
    assert odd.status == "wrong_settings"
    assert words in odd.error
    assert "so101 setup --repair" in odd.fix
    flash = bytes(bus.world.servo("3").memory.flash)
    bus.plug(3)
    setup.assign("elbow_flex")
    bus.whole_arm()
    assert setup.verify().ok
    bus.world.servo("3").memory.flash = flash  # the same without unplugging
    bus.world.servo("3").boot()
    (done,) = setup.repair()["changed"]
    assert done.startswith("elbow_flex: ")
    bus.world.servo("3").boot()
    assert setup.verify().ok


def test_a_repair_keeps_what_was_set_until_power_off_and_brings_all_to_the_rate_of_the_port():
    bus, setup = arm()
    bus.set(3, phase=0, homing_offset=70, min_position=900)
    bus.set(5, baud_rate=reg.BAUDS.index(500_000))
    bus.call(lambda wire: wire.overlay(3, {reg.PHASE: 12}))
    assert setup.repair()["changed"] == ["wrist_roll: 1000000 baud, was 500000"]
    for place in range(1, 7):
        bus.world.servo(str(place)).boot()
    assert setup.verify().ok
    assert bus.holds(3, reg.PHASE, after_power_off=True) == 12
    assert bus.holds(3, reg.HOMING_OFFSET, after_power_off=True) == 70
    assert bus.holds(3, reg.MIN_POSITION, after_power_off=True) == 900


def test_nothing_is_repaired_while_two_servos_share_an_id():
    bus, setup = arm(ids=TWINS)
    bus.set(4, baud_rate=reg.BAUDS.index(500_000))
    with pytest.raises(MotorSetupError, match="share an id"):
        setup.repair()


def test_voltages_are_judged_servo_by_servo():
    _, setup = arm(kind=STS3215_7V4, volts=12.0)
    found = check(setup, "shoulder_pan")
    assert found.status == "wrong_voltage"
    assert "switch the power off" in found.fix
    bus, setup = arm(volts=12.0)
    bus.set(4, max_voltage=80)
    assert check(setup, "wrist_flex").status == "wrong_voltage"
    bus, setup = arm(volts=7.4, kind=STS3215_7V4)
    bus.set(4, max_voltage=140)
    assert "a 12 V servo" in check(setup, "wrist_flex").error


def test_a_skipped_joint_that_is_missing_stays_skipped():
    bus, setup = arm()
    bus.plug(1, 2, 3, 4, 5)
    setup.skip("gripper")
    assert not setup.verify().ok
    assert setup.state.motors["gripper"].state == "skipped"
    assert setup.state.next_joint is None


# Scanning


def test_a_scan_finds_everybody_at_every_rate():
    bus, setup = arm(ids={1: 1, 2: 2, 3: 3, 4: 200, 5: 5, 6: 6})
    bus.set(5, baud_rate=reg.BAUDS.index(57_600))
    found = setup.scan()
    assert [(s["id"], s["baudrate"], s["expected_name"]) for s in found["servos"]] == [
        (1, 1_000_000, "shoulder_pan"),
        (2, 1_000_000, "shoulder_lift"),
        (3, 1_000_000, "elbow_flex"),
        (6, 1_000_000, "gripper"),
        (200, 1_000_000, None),
        (5, 57_600, None),
    ]
    assert found["unexpected_count"] == 2
    assert (
        found["status"] == "6 servos answer, 2 of them with ids or rates that an arm does not use"
    )
    assert setup.state.status == found["status"]
    assert {s["model"] for s in found["servos"]} == {"sts3215"}
    _, setup = arm(ids={1: 1, 2: 1})
    found = setup.scan()
    assert [(s["id"], s["model"]) for s in found["servos"]] == [(1, "unknown")]
    assert "share an id" in found["status"]
    _, setup = arm(volts=0.0)
    assert "power supply" in setup.scan()["status"]
