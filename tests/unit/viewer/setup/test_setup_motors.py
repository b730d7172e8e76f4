from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from so101_viewer.setup.motors import PATIENCE, PAUSE, MotorCards

from so101_motion.calib.motors.setup_view import SetupView


class Time:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def time() -> Time:
    return Time()


@pytest.fixture
def motors(time: Time) -> MotorCards:
    return MotorCards(time)


def view(**states: dict[str, Any]) -> SetupView:
    whole = SetupView()
    changed = {joint: replace(m, **states.get(joint, {})) for joint, m in whole.motors.items()}
    return replace(whole, motors=changed)


DONE = {"state": "configured", "found_id": 6, "baud": 1_000_000, "sentence": "done"}
NEW = {"state": "found", "found_id": 1, "baud": 1_000_000, "sentence": "found a servo with id 1"}
NOBODY = {
    "state": "failed",
    "sentence": "the adapter is connected, but no servo answers",
    "fix": "x",
}
TWO = {"state": "failed", "sentence": "several servos answer", "fix": "unplug the others; y"}


def test_it_looks_at_the_cable_by_itself_but_not_without_a_break(
    motors: MotorCards, time: Time
) -> None:
    assert motors.wants_to_look(view()) == "gripper"
    motors.looked(view())
    assert motors.wants_to_look(view()) is None
    time.now += PAUSE
    assert motors.wants_to_look(view()) == "gripper"
    motors.looked(view())
    motors.look_again()
    assert motors.wants_to_look(view()) == "gripper"


def test_a_motor_that_is_found_alone_can_be_written_to(motors: MotorCards) -> None:
    found = view(gripper=NEW)
    assert motors.can_write(found)
    assert motors.look(found, found.motors["gripper"]) == ("found", NEW["sentence"], "")
    facts = {**NEW, "model": "sts3215", "firmware": "3.10", "volts": 12.04}
    known = view(gripper=facts)
    assert (
        motors.look(known, known.motors["gripper"])[1] == "found it: sts3215, firmware 3.10, 12.0 V"
    )
    assert not motors.can_write(view())
    assert not motors.can_write(view(gripper=TWO))


def test_a_motor_on_the_wrong_supply_is_in_trouble_and_is_not_written_to(
    motors: MotorCards,
) -> None:
    hot = view(gripper={**NEW, "fix": "switch the power off now"})
    assert not motors.can_write(hot)
    look, _, fix = motors.look(hot, hot.motors["gripper"])
    assert (look, fix) == ("trouble", "switch the power off now")


def test_the_motor_that_was_just_set_up_is_not_taken_for_the_next(motors: MotorCards) -> None:
    still = view(gripper=DONE, wrist_roll={**NEW, "found_id": 6})
    assert not motors.can_write(still)
    look, words, _ = motors.look(still, still.motors["wrist_roll"])
    assert look == "now"
    assert words.startswith(
        "unplug the motor of gripper and write 6 on it, then connect only the motor of wrist_roll"
    )


def test_a_motor_that_got_another_ones_id_can_be_taken_for_what_it_is(motors: MotorCards) -> None:
    swapped = view(gripper=DONE, wrist_roll={**NEW, "found_id": 6})
    assert motors.owner(swapped) == "gripper"
    assert motors.owner(view(gripper=DONE, wrist_roll=NEW)) is None
    motors.picked = "wrist_roll"
    asked_again = view(wrist_roll={**NEW, "found_id": 6})  # the gripper's was forgotten
    assert motors.owner(asked_again) is None
    assert motors.can_write(asked_again)


def test_an_older_motor_that_is_plugged_in_again_is_named(motors: MotorCards) -> None:
    both = view(
        gripper=DONE,
        wrist_roll={**DONE, "found_id": 5},
        wrist_flex={**NEW, "found_id": 6},
    )
    _, words, _ = motors.look(both, both.motors["wrist_flex"])
    assert words.startswith("unplug the motor of gripper")


def test_the_id_of_all_new_motors_tells_nothing_about_whose_it_is(motors: MotorCards) -> None:
    done = {**DONE, "found_id": 1}
    redo = view(shoulder_pan=done, gripper=NEW)
    assert motors.can_write(redo)


def test_two_motors_at_once_are_a_trouble_with_what_to_do(motors: MotorCards) -> None:
    fix = "connect only the servo of gripper; then discover gripper again"
    two = view(gripper={**TWO, "fix": fix})
    assert motors.look(two, two.motors["gripper"]) == (
        "trouble",
        "several servos answer",
        "connect only the servo of gripper",
    )


def test_nobody_on_the_cable_is_no_trouble_until_it_has_been_so_for_a_while(
    motors: MotorCards, time: Time
) -> None:
    nobody = view(gripper=NOBODY)
    assert motors.look(nobody, nobody.motors["gripper"])[0] == "now"
    motors.looked(nobody)
    assert motors.hint == ""
    time.now += PATIENCE + 0.1
    motors.looked(nobody)
    assert "dead" in motors.hint
    motors.looked(view(gripper=NEW))
    assert motors.hint == ""


def test_each_motor_has_its_own_time_to_be_plugged_in(motors: MotorCards, time: Time) -> None:
    motors.looked(view(gripper=NOBODY))
    time.now += PATIENCE - 1.0
    motors.looked(view(gripper=DONE, wrist_roll=NOBODY))
    time.now += 2.0
    motors.looked(view(gripper=DONE, wrist_roll=NOBODY))
    assert motors.hint == ""


def test_a_motor_that_was_skipped_can_be_picked_and_leaves_the_others_alone(
    motors: MotorCards,
) -> None:
    skipped = view(gripper={"state": "skipped"})
    assert motors.joint(skipped) == "wrist_roll"
    assert motors.look(skipped, skipped.motors["gripper"])[0] == "skipped"
    motors.picked = "gripper"
    assert motors.joint(skipped) == "gripper"


def test_a_motor_that_was_replaced_can_be_set_up_again(motors: MotorCards) -> None:
    everybody = view(**{joint: DONE for joint in SetupView().motors})
    motors.picked = "elbow_flex"
    assert motors.wants_to_look(everybody) == "elbow_flex"
    again = replace(everybody.motors["elbow_flex"], **NEW)
    found = replace(everybody, motors={**everybody.motors, "elbow_flex": again})
    assert motors.can_write(found)


def test_when_all_are_done_nobody_looks(motors: MotorCards) -> None:
    everybody = view(**{joint: DONE for joint in SetupView().motors})
    assert motors.wants_to_look(everybody) is None
    assert not motors.can_write(everybody)
