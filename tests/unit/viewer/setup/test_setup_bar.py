"""Which of the bar's buttons can be pressed during a setup, and why the others cannot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from so101_viewer.setup.part import StepWizard
from so101_viewer.setup.setup_context import SETTLED, SetupTarget, TorqueWatch, torque
from so101_viewer.setup_app import alarms, reasons

from so101_motion.calib.motors.setup_view import SetupProgress
from so101_motion.calib.procedure.steps import State
from so101_motion.common.modes import Mode
from so101_motion.setup.checkup import Check, Verdict
from so101_motion.setup.setup_steps import CALIBRATION_ONLY, FULL, MOTORS_ONLY, TEST, SetupState

CAN = None


@dataclass(kw_only=True)
class Arm:
    """An arm that is set up; a calibrated one that is held, unless said otherwise."""

    mode: Mode = Mode.HOLDING
    holds: bool | None = True
    state: State = State.IDLE
    is_calibrated: bool = True
    answers: bool = True
    is_connected: bool = True
    has_rig: bool = True

    def target(self):
        situation = SimpleNamespace(
            is_connected=self.is_connected,
            holds=self.holds,
            view=SimpleNamespace(state=self.state),
            saved=Path("arm.json") if self.is_calibrated else None,
            joints={"elbow_flex": SimpleNamespace(ticks=2048 if self.answers else None)},
        )
        rig = SimpleNamespace(arm=SimpleNamespace(state=SimpleNamespace(mode=self.mode)))
        found = SimpleNamespace(situation=situation, rig=rig if self.has_rig else None)
        return cast(SetupTarget, found)


HELD, LIMP = "The joints are held already", "The joints are limp already"
CALIBRATED = "A calibration is under way"


@pytest.mark.parametrize(
    ("arm", "hold", "guide", "let_go"),
    [
        (Arm(), HELD, CAN, CAN),
        (Arm(mode=Mode.MOVING), HELD, "Something moves: press STOP first", CAN),
        (Arm(mode=Mode.GUIDING), CAN, "Guide by hand is on already", CAN),
        (Arm(mode=Mode.LIMP, holds=False), CAN, "press Hold first.", LIMP),
        (Arm(mode=Mode.LIMP, holds=True), CAN, "press Hold first.", CAN),  # by another program
        (Arm(mode=Mode.FAULT), CAN, "The arm is in a fault: press Hold first", CAN),
        (Arm(is_calibrated=False), HELD, "Only a calibrated arm", CAN),
        (
            Arm(mode=Mode.LIMP, holds=None, answers=False, is_calibrated=False),
            "Not all six motors answer", "Only a calibrated arm", "No motor answers",
        ),
        (
            Arm(mode=Mode.CALIBRATING, state=State.RECORDING, holds=False),
            CALIBRATED, CALIBRATED, LIMP,
        ),
        (Arm(mode=Mode.CALIBRATING, state=State.ERROR), CALIBRATED, CALIBRATED, CAN),
        (Arm(is_connected=False), *("There is no connection",) * 3),
        (Arm(has_rig=False), *("The machine has no arm yet",) * 3),
    ],
)  # fmt: skip
def test_each_grey_button_says_why(arm, hold, guide, let_go):
    for said, wanted in zip(reasons(arm.target(), ""), (hold, guide, let_go), strict=True):
        assert (said is None) is (wanted is None), said
        assert (wanted or "") in (said or "")


def test_without_an_arm_nothing_can_be_pressed_and_letting_go_waits_for_nothing():
    assert reasons(None, "") == ("No arm is connected yet.",) * 3
    wait = "Wait for the end of this: planning the test."
    assert reasons(Arm().target(), "planning the test") == (wait, wait, None)


FINE = {
    "silent": False, "volts": 12.1, "amps": 0.1, "temperature_c": 30, "load_percent": 5.0,
    "faults": [], "answers": 10, "lost": 0, "corrupt": 0, "retries": 0,
}  # fmt: skip


def test_a_hot_servo_is_always_said_and_a_silent_one_once_all_six_were_seen_together():
    told = {
        "elbow_flex": {**FINE, "silent": True},
        "gripper": {**FINE, "temperature_c": 68},
        "wrist_roll": FINE,
    }
    arm = SimpleNamespace(state=SimpleNamespace(late_ticks=0))
    rig = SimpleNamespace(arm=arm, status={"health": told})

    def said(checked):
        found = SimpleNamespace(situation=SimpleNamespace(checked=checked), rig=rig)
        return [each.text for each in alarms(cast(SetupTarget, found))]

    (hot,) = said(None)  # the others are not plugged in yet
    assert hot.startswith("gripper: its servo is too hot (68 °C")
    silent, again = said("all six")
    assert (silent, again) == (
        "elbow_flex: its servo does not answer; check its plugs and its power.",
        hot,
    )
    assert [*alarms(None)] == []


def bench(*, connected: bool = True, holds: bool | None = False) -> SetupTarget:
    situation = SimpleNamespace(is_connected=connected, holds=holds)
    return cast(SetupTarget, SimpleNamespace(situation=situation, rig=None))


def test_a_look_at_the_motors_does_not_make_the_torque_flicker() -> None:
    now = [0.0]
    watch = TorqueWatch(lambda: now[0])
    limp, lost = bench(), bench(connected=False)
    assert watch.look(limp, is_blind=False) == torque(limp)
    assert watch.look(lost, is_blind=True) == torque(limp)
    assert watch.look(lost, is_blind=False) == torque(limp)
    for _ in range(2):
        now[0] += 0.9 * SETTLED
        assert watch.look(lost, is_blind=False) == torque(limp)
        assert watch.look(limp, is_blind=False) == torque(limp)
    assert watch.look(lost, is_blind=False) == torque(limp)
    now[0] += SETTLED
    assert watch.look(lost, is_blind=False) == torque(lost)
    watch = TorqueWatch(lambda: 0.0)  # of a new bench, shown at once as is its end
    new = bench(holds=None)
    assert watch.look(new, is_blind=True) == torque(new)
    assert watch.look(lost, is_blind=True) == torque(new)  # it is written to
    assert watch.look(None, is_blind=False) == torque(None)


def begun(folder: Path) -> StepWizard:
    return StepWizard(SetupProgress(folder / "setup.json", None))


def test_the_list_shows_what_is_done_what_is_now_and_what_is_left(tmp_path: Path) -> None:
    wizard = begun(tmp_path)
    assert (wizard.workflow, wizard.step, wizard.where) == (None, None, "")
    assert wizard.rows(SetupState()) == []
    wizard.choose(MOTORS_ONLY)
    assert wizard.step is MOTORS_ONLY.steps[0]
    assert wizard.where == f"Step 1 of 3, about {MOTORS_ONLY.minutes} min left"
    wizard.turn(1)
    places = ("done", "now", "left")
    assert wizard.rows(SetupState()) == list(zip(MOTORS_ONLY.steps, places, strict=True))
    wizard.turn(-1)
    assert [place for _, place in wizard.rows(SetupState())] == ["now", "left", "left"]


def test_a_test_that_was_passed_over_or_not_passed_gets_no_tick(tmp_path: Path) -> None:
    wizard = begun(tmp_path)
    wizard.choose(CALIBRATION_ONLY)
    for _ in CALIBRATION_ONLY.steps[1:]:
        wizard.turn(1)

    def test_found(verdict: Verdict | None) -> str:
        tested = verdict and Check(name="test", verdict=verdict, sentence="told")
        step, place = wizard.rows(SetupState(tested=tested))[-2]
        assert step is TEST
        return place

    assert test_found("ok") == "done"
    assert {test_found(None), test_found("warn"), test_found("fail")} == {"passed over"}


def test_back_from_the_first_step_is_the_choice_and_on_from_the_last_is_the_end(
    tmp_path: Path,
) -> None:
    wizard = begun(tmp_path)
    wizard.choose(CALIBRATION_ONLY)
    wizard.turn(-1)
    assert wizard.workflow is None
    wizard.choose(CALIBRATION_ONLY)
    for _ in CALIBRATION_ONLY.steps:
        assert wizard.workflow is CALIBRATION_ONLY
        wizard.turn(1)
    assert wizard.workflow is None
    assert begun(tmp_path).workflow is None


def test_after_a_crash_a_setup_resumes_in_its_step_unless_it_is_of_another_version(
    tmp_path: Path,
) -> None:
    wizard = begun(tmp_path)
    wizard.choose(FULL)
    for step in FULL.steps:
        again = begun(tmp_path)
        assert (again.workflow, again.step) == (FULL, step)
        wizard.turn(1)
    progress = SetupProgress(tmp_path / "setup.json", None)
    progress.reach("full", "a step of another version")
    assert begun(tmp_path).workflow is None
