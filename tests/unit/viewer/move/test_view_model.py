import numpy as np
import pytest
from harness.fake_page import (
    WELCOME,
    planned,
)
from so101_viewer.page.screen_state import Tone

from so101_motion.common.errors import ConfigError, Interrupted, NoPath
from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad


def test_the_first_screen_shows_a_target_apart_from_the_arm_and_a_hint_of_the_path(page, arm):
    assert page.sentence.text == WELCOME
    assert page.q_ghost is not None
    assert page.path is not None
    assert not page.path.planned
    assert page.can_plan
    assert not page.can_execute
    assert arm.executed == []


def test_targets_are_undone_and_redone_and_a_drag_is_one_change(page, inputs):
    first = page.target.p_base
    assert not page.history.can_undo
    for k in range(5):
        inputs.t += 0.1
        page.set_target_point(np.array([0.1, 0.1, 0.01 * k]))
    inputs.t += 5.0
    page.set_target_joints(np.full(5, 0.3))
    page.history.undo()
    np.testing.assert_allclose(page.target.p_base, [0.1, 0.1, 0.04])
    page.history.undo()
    np.testing.assert_allclose(page.target.p_base, first)
    assert (page.history.can_undo, page.history.can_redo) == (False, True)
    page.history.redo()
    page.history.redo()
    np.testing.assert_allclose(page.target.q, np.full(5, 0.3))
    page.history.undo()
    page.set_target_point(np.array([0.2, 0.0, 0.1]))  # soon after, but what was undone is gone
    assert not page.history.can_redo
    page.history.undo()
    np.testing.assert_allclose(page.target.p_base, [0.1, 0.1, 0.04])
    planned(page)
    page.history.undo()
    assert not page.plan_is_current


def test_the_nearest_place_is_taken_also_when_the_target_is_in_contact(page):
    page.set_target_point(np.array([0.1, 0.1, -0.235]))
    assert page.target.problem is not None
    assert "would hit" in str(page.target.problem)
    page.take_nearest()
    np.testing.assert_allclose(page.target.p_base, [0.1, 0.1, -0.195])
    assert page.target.problem is None
    assert page.target.problem is None
    page.history.undo()
    np.testing.assert_allclose(page.target.p_base, [0.1, 0.1, -0.235])
    page.set_target_point(np.array([0.1, 0.1, -0.4]))
    with pytest.raises(ConfigError, match="no place within 120 mm of it can be reached"):
        page.take_nearest()
    np.testing.assert_allclose(page.target.p_base, [0.1, 0.1, -0.4])


def test_two_buttons_show_the_product(page, arm):
    planned(page)
    assert page.can_execute
    assert page.path is not None
    assert page.path.planned
    assert page.sentence.tone is Tone.GOOD

    page.execute()
    assert len(arm.executed) == 1
    assert not page.can_execute

    arm.be(arm.executed[0].q_goal, t=1.0)
    arm.motion.future.set_result(None)
    assert page.refresh()
    assert page.sentence.text.startswith("Arrived, 0.0 mm off")
    assert page.q_ghost is None
    assert page.path is None
    assert not page.can_plan
    assert not page.can_execute


def test_nothing_moves_without_a_plan(page, arm):
    page.execute()
    assert arm.executed == []


def test_out_of_reach_says_by_how_much_and_why_and_there_is_nothing_to_plan(page):
    page.set_target_point(np.array([0.0, 0.543, 0.0]))
    assert page.sentence.text == "43 mm out of reach (arm fully stretched)."
    assert page.sentence.tone is Tone.BAD
    assert page.path is None
    assert not page.can_plan
    page.plan()
    assert not page.refresh()
    assert page.plan_view is None


def test_a_target_inside_the_table_says_what_touches_what(page):
    page.set_target_point(np.array([0.1, 0.0, -0.3]))
    assert page.sentence.text == "The gripper would hit the floor."
    assert not page.can_plan


@pytest.mark.parametrize(
    "change",
    [
        lambda page: page.set_target_point(np.array([0.1, 0.1, 0.1])),
        lambda page: page.set_target_joints(np.full(5, 0.2)),
        lambda page: page.set_target_joint(3, 0.4),
        lambda page: page.set_target_frame("jaw_tip"),
        lambda page: page.set_speed(to_rad(30.0)),
        lambda page: page.set_acceleration(to_rad(30.0)),
        lambda page: page.move_jaw(1.0),
    ],
    ids=["target", "pose", "joint", "frame", "speed", "acceleration", "jaw"],
)
def test_whatever_a_plan_was_made_for_changes_drops_it(page, arm, change):
    assert planned(page).can_execute
    change(page)
    assert not page.can_execute
    page.execute()
    assert arm.executed == []


@pytest.mark.parametrize("cap", ["speed", "acceleration"])
def test_a_limit_that_another_program_has_set_drops_the_plan(page, arm, cap):
    assert planned(page).can_execute
    setattr(arm, cap, 0.5)
    assert not page.can_execute
    assert page.refresh()
    assert not page.plan_is_current
    assert page.sentence.text == "The speed limits have changed. Press Plan again."
    assert not page.refresh()
    assert planned(page).can_execute


def test_a_plan_being_made_is_dropped_when_another_program_sets_a_limit(page, arm):
    page.plan()
    arm.speed = 0.5
    assert page.refresh()
    assert page.plan_view is None
    assert page.sentence.text == "The speed limits have changed. Press Plan again."
    assert planned(page).can_execute


def test_an_arm_moved_by_somebody_else_drops_the_plan(page, arm):
    assert planned(page).can_execute
    arm.be(np.full(5, to_rad(1.0)))
    assert page.refresh()
    assert not page.can_execute
    assert page.sentence.text == "The arm has moved. Press Plan again."


def test_the_preview_moves_the_ghost_along_the_plan(page):
    page.set_target_point(np.array([0.4, 0.0, 0.0]))
    assert planned(page).preview_time == 1.0
    page.preview(0.5)
    assert page.q_ghost is not None
    np.testing.assert_allclose(page.q_ghost[:3], [0.2, 0.0, 0.0])
    page.preview(99.0)
    assert page.preview_time == 1.0


def test_progress_follows_the_clock_from_the_first_movement(page, arm):
    planned(page)
    page.execute()
    assert page.progress == 0.0
    arm.be(np.zeros(5), t=7.0, mode=Mode.MOVING)
    page.refresh()
    arm.be(np.full(5, 0.05), t=7.5, mode=Mode.MOVING)
    assert page.refresh()
    assert page.progress == pytest.approx(0.5)


def test_a_stop_is_reported_plainly_and_the_target_can_be_planned_for_again(page, arm):
    planned(page)
    page.execute()
    arm.be(np.array([0.01, 0.0, 0.0, 0.0, 0.0]))
    arm.motion.future.set_exception(Interrupted("stop"))
    page.refresh()
    assert page.sentence.text == "Stopped. The arm holds where it is."
    assert page.can_plan
    assert not page.can_execute


def test_a_failed_plan_is_reported_in_its_own_words(page, arm):
    arm.failure = NoPath("no way around <the table>; move the target")
    planned(page)
    assert page.sentence.text == "No way around <the table>; move the target."
    assert page.sentence.tone is Tone.BAD
    assert page.can_plan


def test_a_mistake_inside_is_reported_and_does_not_stop_the_page(page, arm):
    arm.failure = ZeroDivisionError("oops")
    assert "Internal error" in planned(page).sentence.text


@pytest.mark.parametrize(
    ("mode", "words"),
    [(Mode.LIMP, "limp"), (Mode.FAULT, "Fault: see above"), (Mode.CALIBRATING, "calibrated")],
)
def test_an_arm_that_cannot_move_says_so_and_offers_no_buttons(page, arm, mode, words):
    planned(page)
    arm.be(np.zeros(5), mode=mode)
    page.refresh()
    assert words in page.sentence.text
    assert not page.can_plan
    assert not page.can_execute


def test_an_arm_in_contact_where_it_stands_is_offered_a_way_out_that_is_shown_first(page, arm):
    assert not page.can_back_out
    arm.be(np.array([0.1, 0.1, -0.21, 0.0, 0.0]))  # in the floor
    page.refresh()
    assert page.can_back_out
    page.plan_back_out()
    page.refresh()
    assert (page.can_execute, arm.executed) == (True, [])
    assert page.plan_view is not None
    np.testing.assert_allclose(page.plan_view.plan.q_goal, [0.1, 0.1, -0.11, 0.0, 0.0])
