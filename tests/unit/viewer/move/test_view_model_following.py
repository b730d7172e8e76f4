from dataclasses import replace

import numpy as np
import pytest
from harness.fake_page import (
    planned,
    straight,
)

from so101_motion.common.errors import ConfigError
from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.planning.goals import PoseGoal


def test_dragging_during_a_motion_neither_stops_nor_redirects_it(page, arm):
    planned(page)
    page.execute()
    page.set_target_point(np.array([0.0, 0.3, 0.0]))
    assert not page.can_plan
    assert not page.can_execute
    arm.be(arm.executed[0].q_goal)
    arm.motion.future.set_result(None)
    page.refresh()
    assert page.sentence.text.startswith("Arrived, 0.0 mm off")
    assert page.can_plan
    assert len(arm.executed) == 1


def test_a_motion_that_is_planned_again_shows_its_newest_plan(page, arm):
    page.set_replan(True)
    planned(page)
    page.execute()
    page.refresh()
    assert page.plan_view is not None
    assert page.plan_view.plan is arm.executed[0]
    arm.scene = object()
    page.refresh()
    assert page.plan_is_current  # the scene alone does not end it
    arm.motion.plan = straight(np.full(5, 0.1), arm.executed[0].q_goal)
    page.refresh()
    assert page.plan_view.plan is arm.motion.plan
    arm.be(arm.executed[0].q_goal)
    arm.motion.future.set_result(None)
    page.refresh()
    assert page.sentence.text.startswith("Arrived, 0.0 mm off")


def test_an_arm_at_rest_gives_nothing_new_to_show(page, arm):
    assert not page.refresh()
    arm.be(np.full(5, to_rad(0.001)))
    assert not page.refresh()
    arm.be(np.full(5, to_rad(0.1)))
    assert page.refresh()
    assert not page.refresh()


def test_the_gripper_moves_at_once(page, gripper):
    page.move_jaw(1.0)
    page.move_jaw(0.0)
    assert gripper.apertures == [1.0, 0.0]


def test_at_the_target_there_is_nothing_to_plan(page):
    page.set_target_joints(np.zeros(5))
    assert page.sentence.text == "The arm is already there."
    assert not page.can_plan


def test_one_joint_turns_the_ghost_and_leaves_the_others(page):
    page.set_target_joints(np.full(5, 0.1))
    page.set_target_joint(3, 0.5)
    np.testing.assert_allclose(page.target.q, [0.1, 0.1, 0.1, 0.5, 0.1])
    page.set_target_joint(4, 2.1)
    assert page.sentence.text == "wrist_roll would be at 120.32°; its range is -114.59 to 114.59°."
    assert not page.can_plan


def test_another_frame_is_aimed_with_from_where_the_ghost_stands(page):
    page.set_target_point(np.array([0.2, 0.1, 0.1]))
    q = page.target.q
    page.set_target_frame("jaw_tip")
    np.testing.assert_array_equal(page.target.q, q)
    np.testing.assert_allclose(page.target.p_base, [0.2, 0.1, 0.2])
    page.set_target_point(np.array([0.2, 0.1, 0.1]))
    assert isinstance(page.target.goal, PoseGoal)
    assert page.target.goal.frame == "jaw_tip"
    with pytest.raises(ConfigError, match="must be one of"):
        page.set_target_frame("elbow")


def test_here_is_where_the_arm_is(page, arm):
    arm.be(np.full(5, 0.3))
    page.refresh()
    page.set_target_here()
    np.testing.assert_allclose(page.target.q, 0.3)
    assert page.sentence.text == "The arm is already there."


def test_a_plan_shows_postures_on_its_path_and_where_it_comes_close(page):
    page.set_target_point(np.array([0.3, 0.0, -0.1]))
    planned(page)
    assert page.sweep is not None
    assert len(page.sweep) >= 3
    assert 0.0 < page.sweep[0][0] < page.sweep[-1][0] < 0.3
    assert page.plan_view is not None
    assert page.plan_view.closest.distance == pytest.approx(0.1)
    assert page.plan_view.t_closest == pytest.approx(1.0)
    page.show_sweep(False)
    assert page.sweep is None


def test_the_ghost_plays_the_plan_at_the_pace_it_was_told(page, inputs):
    planned(page)
    page.play(0.5)
    assert page.refresh()
    inputs.t += 0.8
    assert page.refresh()
    assert page.preview_time == pytest.approx(0.4)
    page.play(0.5)  # once more: it stands
    inputs.t += 0.8
    assert not page.refresh()
    page.play(2.0)
    page.refresh()
    inputs.t += 5.0
    page.refresh()
    assert page.preview_time == 1.0
    assert not page.refresh()


def test_new_surroundings_drop_the_plan_and_are_taken_up_beside_the_page(page, arm, inputs):
    assert planned(page).can_execute
    arm.scene = object()
    assert not page.can_execute  # not even before the page has taken note
    assert page.refresh()
    assert page.sentence.text == "The surroundings have changed. Press Plan again."
    assert not page.can_execute
    page.refresh()
    assert inputs.loaded[-1].scene is arm.scene
    arm.range = (np.full(5, -1.0), np.full(5, 1.0))
    page.refresh()
    assert inputs.loaded[-1].range is arm.range
    page.refresh()
    assert not page.refresh()


def test_surroundings_that_cannot_be_taken_up_are_reported(page, arm, inputs):
    inputs.failure = ConfigError("elbow_flex", [1, 1], "leaves no angle")
    arm.range = (np.full(5, 1.0), np.full(5, 1.0))
    page.refresh()
    page.refresh()
    assert "leaves no angle" in page.sentence.text


def test_after_a_motion_it_is_told_how_well_the_arm_followed(page, arm):
    assert planned(page).tracker.newest is None
    page.execute()
    for k in range(5):
        q = np.full(5, 0.02 * k)
        arm.be(q - 0.01, t=0.1 * k, mode=Mode.MOVING)
        arm.state = replace(arm.state, q_ref=q, qd_ref=np.full(5, 0.2))
        page.refresh()
    arm.be(arm.executed[0].q_goal, t=1.0)
    arm.motion.future.set_result(None)
    page.refresh()
    tracking = page.tracker.newest
    assert tracking is not None
    np.testing.assert_allclose(tracking.worst, 0.01)
    assert tracking.lag == pytest.approx(0.05)
    ran = page.ran
    assert ran is not None
    assert ran[1] is tracking
    for k in range(5):
        arm.be(np.full(5, 0.02 * k), t=2.0 + 0.1 * k, mode=Mode.MOVING)
        page.refresh()
    arm.be(np.full(5, 0.08), t=3.0)
    page.refresh()
    assert page.tracker.newest_name == "another motion"
    assert page.ran is ran  # what somebody else moved is no run of the plan
