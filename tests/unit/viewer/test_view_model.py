"""The state of the Move tab: of one arm that is a fake, and of three simulated ones."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from harness.fake_page import (
    WELCOME,
    CellBench,
    FakeArm,
    FakeGripper,
    OnePage,
    PageInputs,
    aside,
    planned,
    run_at_once,
    straight,
)
from so101_viewer.page.screen_state import Sentence, Tone
from so101_viewer.view_model import MoveModel, ViewModel

from so101_motion.common.errors import ConfigError, Interrupted, NoPath, ServoAlarm
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_rad
from so101_motion.files.cell_file import arms_in_a_circle
from so101_motion.planning.collision.apart import ROOM
from so101_motion.planning.goals import PoseGoal
from so101_motion.rig.cell_rigs import open_cell

HOT = {"elbow_flex": "its servo is too hot and has let go; support the arm"}


@pytest.fixture
def arm():
    return FakeArm()


@pytest.fixture
def gripper():
    return FakeGripper()


@pytest.fixture
def inputs():
    return PageInputs()


@pytest.fixture
def page(arm, gripper, inputs):
    page = ViewModel(
        arm=arm, gripper=gripper, load_solver=inputs.load_solver, submit=run_at_once, now=inputs.now
    )
    return OnePage(page, inputs)


def test_the_first_screen_shows_a_target_apart_from_the_arm_and_a_hint_of_the_path(page, arm):
    assert page.sentence.text == WELCOME
    assert page.q_ghost is not None
    assert not page.path.planned
    assert page.can_plan
    assert not page.can_execute
    page.execute()
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
    assert "would hit" in str(page.target.problem)
    page.take_nearest()
    np.testing.assert_allclose(page.target.p_base, [0.1, 0.1, -0.195])
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

    arm.stops += 1
    assert page.refresh()
    assert page.sentence.text == "Stopped at the target. Set another one."  # as the bar says


def test_what_is_said_of_an_arrival_follows_where_the_arm_is(page, arm):
    planned(page)
    page.execute()
    arm.be(arm.executed[0].q_goal, t=1.0)
    arm.motion.future.set_result(None)
    page.refresh()
    for off_deg, says in (
        (0.3, "Arrived"),
        (2.0, "Reachable. Press Plan."),
        (0.0, "Already there."),
    ):
        arm.be(arm.executed[0].q_goal + to_rad(off_deg), t=2.0)  # jogged there, or stopped there
        page.refresh()
        assert page.sentence.text.startswith(says)


@pytest.mark.parametrize(
    ("p_base", "says"),
    [
        ([0.0, 0.543, 0.0], "43 mm out of reach (arm fully stretched)."),
        ([0.1, 0.0, -0.3], "Target: the gripper would hit the floor."),
    ],
)
def test_a_target_that_cannot_be_is_explained_and_there_is_nothing_to_plan(page, p_base, says):
    page.set_target_point(np.array(p_base))
    assert page.sentence.text == f"{says} Press nearest for one that works."
    assert page.sentence.tone is Tone.BAD
    assert page.path is None
    assert not page.can_plan
    page.plan()
    assert not page.refresh()
    assert page.plan_view is None


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
@pytest.mark.parametrize("is_made", [True, False])
def test_a_limit_or_a_place_that_another_program_has_set_drops_the_plan(page, arm, cap, is_made):
    page.plan()
    if is_made:
        page.refresh()
        assert page.can_execute
    setattr(arm, cap, 0.5)
    assert not page.can_execute
    assert page.refresh()
    assert not page.plan_is_current
    assert page.sentence.text == "The speed limits have changed. Press Plan again."
    assert not page.refresh()
    assert planned(page).can_execute
    arm.be(np.full(5, to_rad(1.0)))
    assert page.refresh()
    assert not page.can_execute
    assert page.sentence.text == "The arm has moved. Press Plan again."


@pytest.mark.parametrize(
    ("failure", "says"),
    [
        (NoPath("no way around <the table>; move it"), "No way around <the table>; move it."),
        (ZeroDivisionError("oops"), "Internal error"),
    ],
)
def test_a_plan_that_fails_is_reported_and_does_not_stop_the_page(page, arm, failure, says):
    arm.failure = failure
    planned(page)
    assert says in page.sentence.text
    assert page.sentence.tone is Tone.BAD
    assert page.can_plan
    page.refresh()
    assert page.sentence.tone is Tone.BAD
    arm.scene = object()  # the cause may be gone
    page.refresh()
    assert page.sentence.text == "Reachable. Press Plan."


def test_the_preview_moves_the_ghost_along_the_plan(page):
    page.set_target_point(np.array([0.4, 0.0, 0.0]))
    assert planned(page).playback.t == 1.0
    page.playback.seek(0.5)
    np.testing.assert_allclose(page.q_ghost[:3], [0.2, 0.0, 0.0])
    page.playback.seek(99.0)
    assert page.playback.t == 1.0


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
    assert page.sentence.text == "Stopped. The arm holds where it is. Press Plan to go on."
    assert page.can_plan
    assert not page.can_execute


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        (Mode.LIMP, "limp"),
        (Mode.FAULT, "in a fault, so nothing can move"),
        (Mode.CALIBRATING, "calibrated"),
        (Mode.MOVING, "jogging is on. To plan, end it"),
        (Mode.HOLDING, "elbow_flex has let go: support the arm."),
    ],
)
def test_an_arm_that_cannot_move_says_so_and_offers_no_buttons(page, arm, mode, words):
    planned(page)
    held = mode is Mode.HOLDING
    arm.be(
        np.zeros(5), mode=mode, alarms=HOT if held else {}, let_go=frozenset(HOT if held else ())
    )
    page.refresh()
    assert words in page.sentence.text
    assert not page.can_plan
    assert not page.can_execute


def test_what_an_alarm_has_refused_is_red_until_the_alarm_is_over_without_the_file_s_path(
    page, arm
):
    planned(page)
    arm.be(np.zeros(5), alarms={"elbow_flex": "it gets only 5.0 V"})
    page.execute()
    error = ServoAlarm("elbow_flex", "it gets only 5.0 V", recent=())
    error.add_note("The second before is recorded in /a/failures/b.json")
    arm.motion.future.set_exception(error)
    for _ in range(3):
        page.refresh()
        assert page.sentence == Sentence("elbow_flex: it gets only 5.0 V.", Tone.BAD)
        assert (page.can_plan, page.can_execute) == (False, False)
    arm.be(np.zeros(5))
    page.refresh()
    assert page.sentence.text == "Reachable. Press Plan."


def test_an_alarm_is_shown_as_soon_as_it_is_there_and_no_longer(page, arm):
    welcome = page.sentence
    low = {joint: "it gets only 5.0 V; check it" for joint in (*ARM_JOINTS, GRIPPER_JOINT)}
    for alarms, says in (
        (low, "Every joint has an alarm. shoulder_pan: it gets only 5.0 V; check it."),
        ({"elbow_flex": "it is hot; wait"}, "elbow_flex: it is hot; wait."),
        ({}, welcome.text),
    ):
        arm.be(np.zeros(5), alarms=alarms)
        assert page.refresh()
        assert (page.sentence.text, page.can_plan) == (says, not alarms)


def test_an_arm_in_contact_where_it_stands_is_offered_a_way_out_that_is_shown_first(page, arm):
    assert not page.can_back_out
    arm.be(np.array([0.1, 0.1, -0.21, 0.0, 0.0]))  # in the floor
    page.refresh()
    assert page.can_back_out
    assert "press Back out slowly" in page.sentence.text
    page.plan_back_out()
    page.refresh()
    assert (page.can_execute, arm.executed) == (True, [])
    np.testing.assert_allclose(page.plan_view.plan.q_goal, [0.1, 0.1, -0.11, 0.0, 0.0])


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
    page.arms[""].replans = True
    planned(page)
    page.execute()
    page.refresh()
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


def test_one_joint_turns_the_ghost_and_leaves_the_others(page):
    page.set_target_joints(np.full(5, 0.1))
    page.set_target_joint(3, 0.5)
    np.testing.assert_allclose(page.target.q, [0.1, 0.1, 0.1, 0.5, 0.1])
    page.set_target_joint(4, 2.1)
    beyond = "wrist_roll would be at 120.32°; its range is -114.59 to 114.59°. Press nearest"
    assert page.sentence.text.startswith(beyond)
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


def test_here_is_where_the_arm_is_and_the_jaw_moves_at_once(page, arm, gripper):
    page.move_jaw(1.0)
    assert gripper.apertures == [1.0]
    arm.be(np.full(5, 0.3))
    page.refresh()
    page.set_target_here()
    np.testing.assert_allclose(page.target.q, 0.3)
    assert page.sentence.text == "Already there. Set another target."
    arm.be(np.full(5, 0.2))
    page.refresh()
    assert page.sentence.text == "Reachable. Press Plan."


def test_the_ghost_plays_the_plan_at_the_pace_it_was_told(page, inputs):
    planned(page)
    page.playback.play(0.5)
    assert page.refresh()
    inputs.t += 0.8
    assert page.refresh()
    assert page.playback.t == pytest.approx(0.4)
    page.playback.play(0.5)  # once more: it stands
    inputs.t += 0.8
    assert not page.refresh()
    page.playback.play(2.0)
    page.refresh()
    inputs.t += 5.0
    page.refresh()
    assert page.playback.t == 1.0
    assert not page.refresh()


def test_new_surroundings_drop_the_plan_and_are_taken_up_beside_the_page(page, arm, inputs):
    assert planned(page).can_execute
    arm.scene = object()
    assert not page.can_execute  # not even before the page has taken note
    assert page.refresh()
    assert page.sentence.text == "The surroundings have changed. Press Plan again."
    assert not page.can_execute
    page.refresh()
    assert inputs.loaded[-1][0] is arm.scene
    arm.range = (np.full(5, -1.0), np.full(5, 1.0))
    page.refresh()
    assert inputs.loaded[-1][1] is arm.range
    page.refresh()
    assert not page.refresh()
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
    np.testing.assert_allclose(tracking.worst, 0.01)
    assert tracking.lag == pytest.approx(0.05)
    ran = page.ran
    assert ran[1] is tracking
    for k in range(5):
        arm.be(np.full(5, 0.02 * k), t=2.0 + 0.1 * k, mode=Mode.MOVING)
        page.refresh()
    arm.be(np.full(5, 0.08), t=3.0)
    page.refresh()
    assert page.tracker.newest_name == "another motion"
    assert page.ran is ran  # what somebody else moved is no run of the plan


OVER_THE_MIDDLE = to_rad(np.array([0.0, -60.0, 60.0, 60.0, 0.0]))


class Bench(CellBench):
    """Three arms and the model of their page."""

    def aim(self, **targets):
        """Set a target for each arm; where none is given it stays."""
        for arm, name in zip(self.arms.values(), ("first", "second", "third"), strict=True):
            if name in targets:
                arm.set_target_joints(targets[name])
            else:
                arm.set_target_here()


@pytest.fixture
def bench(clock, planning_process):
    with open_cell(arms_in_a_circle(3), clock=clock) as opened:
        model_of = partial(MoveModel, submit=run_at_once, now=clock.now, welcome="Welcome.")
        yield Bench(opened, clock, model_of)


def test_one_plan_moves_every_arm_to_its_target_and_tells_the_clearance(bench):
    bench.aim(first=aside(55.0), second=aside(50.0))
    assert bench.plan().plan_is_current
    assert bench.model.can_execute
    common = bench.model.common_plan
    assert len(common.clearances) == 3
    assert all(each.least.distance > 0.7 * ROOM for each in common.clearances)
    bench.model.playback.seek(common.duration)
    ghosts = [each.q_ghost for each in bench.model.arms.values()]
    assert ghosts[2] is None, "the third stays where it is"
    goals = [plan.q_goal for plan in common.plans.values()]
    np.testing.assert_allclose(ghosts[:2], goals[:2])
    bench.model.execute()
    bench.move(lambda: bench.says("Arrived"))
    first, second, _ = bench.opened.rigs.values()
    np.testing.assert_allclose(first.arm.state.q, aside(55.0), atol=to_rad(0.5))
    np.testing.assert_allclose(second.arm.state.q, aside(50.0), atol=to_rad(0.5))
    assert not bench.model.plan_is_current


def test_stopping_one_arm_stops_all_and_the_page_says_so(bench):
    bench.aim(first=aside(70.0), second=aside(70.0))
    assert bench.plan().can_execute
    bench.model.execute()
    first, second, _ = (rig.arm for rig in bench.opened.rigs.values())
    bench.move(lambda: first.state.arm_moving and second.state.arm_moving)
    stopping = second.start_stop()
    bench.move(lambda: bench.says("Stopped. All arms hold where they are."))
    assert stopping.done()
    assert not first.state.arm_moving


def test_a_plan_is_dropped_for_all_arms_as_soon_as_one_target_changes(bench):
    bench.aim(first=aside(60.0))
    assert bench.plan().plan_is_current
    third = list(bench.arms.values())[2]
    third.set_target_joint(0, to_rad(20.0))
    bench.model.refresh()
    assert not any(each.plan_is_current for each in bench.arms.values())
    assert not bench.model.can_execute
    assert bench.model.can_plan
    assert bench.says("Reachable. Press Plan.")
    bench.aim()  # what is said is of all arms, whichever target came last
    bench.model.refresh()
    assert bench.says("Already there.")
    third.set_target_joint(0, to_rad(20.0))
    next(iter(bench.arms.values())).set_target_here()
    bench.model.refresh()
    assert bench.says("Reachable. Press Plan.")


def test_targets_that_arms_cannot_have_run_at_once_are_refused_with_their_names(bench):
    bench.aim(first=OVER_THE_MIDDLE, second=OVER_THE_MIDDLE, third=OVER_THE_MIDDLE)
    assert not bench.plan().plan_is_current
    assert bench.says("arm 1") or bench.says("Arm 1")
    assert any(arm.refused is arm.target for arm in bench.arms.values())  # its ghost is red
    bench.aim()
    list(bench.arms.values())[1].set_target_point(np.array([0.9, 0.0, 0.2]))  # out of reach
    assert bench.says("arm 2: ")
    assert not bench.model.can_plan
