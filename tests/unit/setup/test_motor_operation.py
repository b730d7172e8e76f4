"""Which motor is asked for, what may be written to it, and what is said about the chain."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from harness.lent_bus import LentBus

from so101_motion.calib.motors.setup_view import MotorCheck, SetupView, Verification
from so101_motion.calib.record.record import JOINTS
from so101_motion.common.errors import MotorSetupError
from so101_motion.setup.motor_operation import PATIENCE, PAUSE, ChainOperation, MotorOperation

DONE = {"state": "configured", "found_id": 6, "baud": 1_000_000, "sentence": "done"}
NEW = {"state": "found", "found_id": 1, "baud": 1_000_000, "sentence": "found a servo with id 1"}
NOBODY = {
    "state": "failed",
    "sentence": "the adapter is connected, but no servo answers",
    "fix": "x",
}
TWO = {
    "state": "failed",
    "sentence": "several servos answer",
    "fix": "connect only the servo of gripper; then discover gripper again",
}


def operation(now=lambda: 100.0, *, writes=False, **states):
    asked = MotorOperation(LentBus({}, calibrated=False).lent, now=now)
    asked.writes = writes
    put(asked, **states)
    return asked


def put(asked, **states):
    """The motors are as a test says."""
    motors = {j: replace(m, **states.get(j, {})) for j, m in asked.state.motors.items()}
    asked.state = replace(asked.state, motors=motors)


def can_write(view):
    offer = view.offer("assign_id")
    return offer is not None and offer.why_not is None


def test_it_looks_at_the_cable_by_itself_but_not_without_a_break():
    now = [100.0]
    asked = operation(lambda: now[0], gripper=NEW)
    assert asked.view.offer("discover").due_in == pytest.approx(0.0)
    with pytest.raises(MotorSetupError):
        asked.ask("discover", motor_name="gripper")
    assert asked.view.offer("discover").due_in == pytest.approx(PAUSE)
    now[0] += PAUSE
    assert asked.view.offer("discover").due_in == pytest.approx(0.0)


def test_a_motor_that_is_found_alone_can_be_written_to():
    view = operation(gripper={**NEW, "model": "sts3215", "firmware": "3.10", "volts": 12.04}).view
    assert view.text == "found it: sts3215, firmware 3.10, 12.0 V"
    assert can_write(view)
    assert view.offers[0].title == "Write id 6 to this motor"
    assert view.offers[0].due_in is None, "a person says so"
    assert not can_write(operation().view)
    two = operation(gripper=TWO).view
    assert not can_write(two)
    assert (two.trouble, two.fix) == (TWO["sentence"], "connect only the servo of gripper")
    assert operation(writes=True, gripper=NEW).view.offers[0].due_in == 0.0
    on_wrong_supply = {**NEW, "fix": "switch the power off now"}
    view = operation(writes=True, gripper=on_wrong_supply).view
    assert (can_write(view), view.fix) == (False, "switch the power off now")


def test_the_motor_that_was_just_set_up_is_not_taken_for_the_next():
    asked = operation(writes=True, gripper=DONE, wrist_roll={**NEW, "found_id": 6})
    assert not can_write(asked.view)
    assert asked.view.note.startswith("Id 6 answers, that of gripper. If another motor")
    assert asked.view.text.startswith(
        "unplug the motor of gripper and write 6 on it, then connect only the motor of wrist_roll"
    )
    older = {"wrist_roll": {**DONE, "found_id": 5}, "wrist_flex": {**NEW, "found_id": 6}}
    view = operation(gripper=DONE, **older).view
    assert view.text.startswith("unplug the motor of gripper")


def test_a_motor_that_got_another_ones_id_can_be_taken_for_what_it_is():
    found = {**NEW, "found_id": 6}
    asked = operation(gripper=DONE, wrist_roll=found)
    swap = asked.view.offer("swap")
    assert swap.asks
    asked.ask("swap", **swap.arguments)
    put(asked, wrist_roll=found)  # it is found again
    assert asked.view.state == "wrist_roll"
    assert can_write(asked.view)
    assert operation(gripper=DONE, wrist_roll=NEW).view.offer("swap") is None


@pytest.mark.parametrize("writes", [False, True])
def test_a_motor_with_an_id_of_another_joint_is_written_to_when_a_person_says_so(writes):
    view = operation(writes=writes, gripper={**NEW, "found_id": 5}).view
    assert "set up as the motor of wrist_roll" in view.note
    assert can_write(view)
    assert view.offers[0].due_in is None


def test_nobody_on_the_cable_is_no_trouble_until_it_has_been_so_for_a_while():
    now = [100.0]
    asked = operation(lambda: now[0], gripper=NOBODY)

    def look(joint):
        with pytest.raises(MotorSetupError):
            asked.ask("discover", motor_name=joint)

    look("gripper")
    assert (asked.view.trouble, "dead" in asked.view.note) == ("", False)
    now[0] += PATIENCE + 0.1
    assert "dead" in asked.view.note
    put(asked, gripper=DONE, wrist_roll=NOBODY)  # each has its own time to be plugged in
    look("wrist_roll")
    assert "dead" not in asked.view.note


def test_a_motor_that_is_done_can_be_set_up_again_and_rows_name_the_ids():
    asked = operation(**dict.fromkeys(SetupView().motors, DONE))
    assert (asked.view.state, asked.view.is_over) == ("done", True)
    assert asked.view.text.endswith("Write 1 on the motor of shoulder_pan.")
    assert asked.view.offer("discover") is None, "nobody looks"
    asked.ask("choose", motor_name="elbow_flex")
    assert asked.view.state == "elbow_flex"
    put(asked, elbow_flex=NEW)
    assert can_write(asked.view)
    states = {"gripper": {"state": "skipped"}, "wrist_roll": {**NEW, "found_id": 6}}
    rows = {row.label: row.cells[0] for row in operation(**states).view.rows}
    assert rows["gripper"] == "skipped"
    assert rows["wrist_roll"] == "id 6 → 5, 1 Mbaud"
    assert rows["wrist_flex"] == "gets id 4"
    several = operation(gripper={**TWO, "found_id": 3}).view.rows[0]
    assert several.cells == ("gets id 6",), "which of them would get it is not known"
    is_plugged_in = operation(gripper=DONE, wrist_roll={**NEW, "found_id": 6}).view.rows[1]
    assert is_plugged_in.cells == ("gets id 5",), "the gripper's motor is not changed"


def chain(status, *, error, fix, sound=0):
    """Six motors; those beyond the first ``sound`` have one trouble."""
    motors = {
        joint: MotorCheck(joint=joint, servo_id=i, status="ok")
        if i <= sound
        else MotorCheck(joint=joint, servo_id=i, status=status, error=f"servo {i} {error}", fix=fix)
        for i, joint in enumerate(JOINTS, start=1)
    }
    checked = Verification(motors=motors, unexpected_ids=(), notes=(), sentence="")
    return ChainOperation(SimpleNamespace(checked=checked)).view


def test_one_trouble_of_many_motors_is_reported_once():
    hot = chain("wrong_voltage", error="gets 15.5 V", fix="switch the power off now")
    assert hot.trouble == "servo 1 gets 15.5 V; the same with 2, 3, 4, 5, 6"
    assert hot.fix == "switch the power off now"
    last = chain("not_responding", error="does not answer", fix="check the cable", sound=5)
    assert (last.trouble, last.fix) == ("servo 6 does not answer", "check the cable")
    assert [row.mark for row in last.rows] == ["✓"] * 5 + ["✗"]
    assert chain("", error="", fix="", sound=6).is_over
