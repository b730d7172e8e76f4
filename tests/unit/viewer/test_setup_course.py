from __future__ import annotations

from pathlib import Path

from so101_viewer.setup.course import Course

from so101_motion.calib.progress import Progress
from so101_motion.checkup import Check, Verdict
from so101_motion.workflow import CALIBRATION_ONLY, FULL, MOTORS_ONLY, TEST, Known


def begun(folder: Path) -> Course:
    return Course(Progress(folder / "setup.json", None))


def test_nothing_is_under_way_until_somebody_chooses(tmp_path: Path) -> None:
    course = begun(tmp_path)
    assert (course.workflow, course.step, course.rows(Known()), course.where) == (
        None,
        None,
        (),
        "",
    )
    course.choose(MOTORS_ONLY)
    assert course.step is MOTORS_ONLY.steps[0]
    assert course.where == f"Step 1 of 3, about {MOTORS_ONLY.minutes} min left"


def test_the_list_shows_what_is_done_what_is_now_and_what_is_left(tmp_path: Path) -> None:
    course = begun(tmp_path)
    course.choose(MOTORS_ONLY)
    course.go_on()
    rows = course.rows(Known())
    assert [row.place for row in rows] == ["done", "now", "left"]
    assert [row.title for row in rows] == [step.title for step in MOTORS_ONLY.steps]
    course.go_back()
    assert [row.place for row in course.rows(Known())] == ["now", "left", "left"]


def test_a_test_that_was_passed_over_or_not_passed_gets_no_tick(tmp_path: Path) -> None:
    course = begun(tmp_path)
    course.choose(CALIBRATION_ONLY)
    for _ in CALIBRATION_ONLY.steps[1:]:
        course.go_on()

    def test_found(verdict: Verdict | None) -> str:
        tested = verdict and Check(name="test", verdict=verdict, sentence="told")
        return course.rows(Known(tested=tested))[-2].place

    assert course.rows(Known())[-2].title == TEST.title
    assert test_found("ok") == "done"
    assert {test_found(None), test_found("warn"), test_found("fail")} == {"passed over"}


def test_back_from_the_first_step_is_the_choice_and_on_from_the_last_is_the_end(
    tmp_path: Path,
) -> None:
    course = begun(tmp_path)
    course.choose(CALIBRATION_ONLY)
    course.go_back()
    assert course.workflow is None
    course.choose(CALIBRATION_ONLY)
    for _ in CALIBRATION_ONLY.steps:
        assert course.workflow is CALIBRATION_ONLY
        course.go_on()
    assert course.workflow is None
    assert begun(tmp_path).interrupted is None


def test_a_crash_in_any_step_is_gone_on_from_in_that_step(tmp_path: Path) -> None:
    course = begun(tmp_path)
    course.choose(FULL)
    for step in FULL.steps:
        again = begun(tmp_path)
        assert again.step is None
        assert again.interrupted is step
        again.resume()
        assert (again.workflow, again.step) == (FULL, step)
        course.go_on()


def test_what_another_version_has_left_behind_is_no_setup(tmp_path: Path) -> None:
    progress = Progress(tmp_path / "setup.json", None)
    progress.reach("full", "a step of another version")
    course = begun(tmp_path)
    assert course.interrupted is None
    course.resume()
    assert course.workflow is None
