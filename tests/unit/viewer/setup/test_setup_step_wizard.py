from so101_motion.calib.motors.progress import SetupProgress
from so101_viewer.setup.step_wizard import StepWizard

from so101_motion.setup.checkup import Check
from so101_motion.setup.setup_steps import CALIBRATION_ONLY, FULL, MOTORS_ONLY, TEST, SetupState


def begun(folder):
    return StepWizard(SetupProgress(folder / "setup.json", None))


def test_nothing_is_under_way_until_somebody_chooses(tmp_path):
    wizard = begun(tmp_path)
    assert (wizard.workflow, wizard.step, wizard.rows(SetupState()), wizard.where) == (
        None,
        None,
        (),
        "",
    )
    wizard.choose(MOTORS_ONLY)
    assert wizard.step is MOTORS_ONLY.steps[0]
    assert wizard.where == f"Step 1 of 3, about {MOTORS_ONLY.minutes} min left"


def test_the_list_shows_what_is_done_what_is_now_and_what_is_left(tmp_path):
    wizard = begun(tmp_path)
    wizard.choose(MOTORS_ONLY)
    wizard.go_on()
    rows = wizard.rows(SetupState())
    assert [row.place for row in rows] == ["done", "now", "left"]
    assert [row.title for row in rows] == [step.title for step in MOTORS_ONLY.steps]
    wizard.go_back()
    assert [row.place for row in wizard.rows(SetupState())] == ["now", "left", "left"]


def test_a_test_that_was_passed_over_or_not_passed_gets_no_tick(tmp_path):
    wizard = begun(tmp_path)
    wizard.choose(CALIBRATION_ONLY)
    for _ in CALIBRATION_ONLY.steps[1:]:
        wizard.go_on()

    def test_found(verdict):
        tested = verdict and Check(name="test", verdict=verdict, sentence="told")
        return wizard.rows(SetupState(tested=tested))[-2].place

    assert wizard.rows(SetupState())[-2].title == TEST.title
    assert test_found("ok") == "done"
    assert {test_found(None), test_found("warn"), test_found("fail")} == {"passed over"}


def test_back_from_the_first_step_is_the_choice_and_on_from_the_last_is_the_end(tmp_path):
    wizard = begun(tmp_path)
    wizard.choose(CALIBRATION_ONLY)
    wizard.go_back()
    assert wizard.workflow is None
    wizard.choose(CALIBRATION_ONLY)
    for _ in CALIBRATION_ONLY.steps:
        assert wizard.workflow is CALIBRATION_ONLY
        wizard.go_on()
    assert wizard.workflow is None
    assert begun(tmp_path).interrupted is None


def test_after_a_crash_a_setup_resumes_in_its_step(tmp_path):
    wizard = begun(tmp_path)
    wizard.choose(FULL)
    for step in FULL.steps:
        again = begun(tmp_path)
        assert again.step is None
        assert again.interrupted is step
        again.resume()
        assert (again.workflow, again.step) == (FULL, step)
        wizard.go_on()


def test_progress_of_another_version_is_ignored(tmp_path):
    progress = SetupProgress(tmp_path / "setup.json", None)
    progress.reach("full", "a step of another version")
    wizard = begun(tmp_path)
    assert wizard.interrupted is None
    wizard.resume()
    assert wizard.workflow is None
