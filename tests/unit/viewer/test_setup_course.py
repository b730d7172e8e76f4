from __future__ import annotations

from pathlib import Path

from so101_viewer.setup.course import Course

from so101_motion.calib.progress import Progress
from so101_motion.workflow import CALIBRATION_ONLY, FULL, MOTORS_ONLY


def begun(folder: Path) -> Course:
    return Course(Progress(folder / "setup.json", None))


def test_nothing_is_under_way_until_somebody_chooses(tmp_path: Path) -> None:
    course = begun(tmp_path)
    assert (course.workflow, course.step, course.rows, course.where) == (None, None, (), "")
    course.choose(MOTORS_ONLY)
    assert course.step is MOTORS_ONLY.steps[0]
    assert course.where == f"Step 1 of 3, about {MOTORS_ONLY.minutes} min left"


def test_the_list_shows_what_is_done_what_is_now_and_what_is_left(tmp_path: Path) -> None:
    course = begun(tmp_path)
    course.choose(MOTORS_ONLY)
    course.go_on()
    assert [row.place for row in course.rows] == ["done", "now", "left"]
    assert [row.title for row in course.rows] == [step.title for step in MOTORS_ONLY.steps]
    course.go_back()
    assert [row.place for row in course.rows] == ["now", "left", "left"]


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
