from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from so101_viewer.page.screen_state import Screen, Tone
from so101_viewer.page.target_ik import Surroundings, TargetSolver
from so101_viewer.view_model import ViewModel

from so101_motion.common.errors import ConfigError, Interrupted, NoPath, OutsideLimits, Unreachable
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS, JointReading, JointState
from so101_motion.common.units import to_rad
from so101_motion.planning.goals import JointGoal, PoseGoal
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Trajectory

REACH = 0.5
"""The pretended arm's tool point is its first three angles, and it reaches this far [m]."""

WELCOME = "Welcome."


def point(q: Array, frame: str) -> Array:
    return q[:3] if frame == "tool" else q[:3] + np.array([0.0, 0.0, 0.1])


def clearance(q: Array, _q_jaw: float) -> Any:
    """How far the pretended arm is from the floor that it touches at -0.2 m."""
    return SimpleNamespace(distance=q[2] + 0.2, first="gripper", second="floor")


def check_limits(q: Array) -> None:
    i = int(np.argmax(np.abs(q)))
    if abs(q[i]) > 2.0:
        raise OutsideLimits("far", joint=ARM_JOINTS[i], value=q[i], lower=-2.0, upper=2.0)


def candidates(goal: PoseGoal, q_seed: Array) -> list[Any]:
    p = goal.T_base_tool.p
    distance = float(np.linalg.norm(p))
    if distance > REACH:
        raise Unreachable(
            "too far",
            error_position=distance - REACH,
            error_angle=0.0,
            p_base_nearest=p * REACH / distance,
            q_nearest=np.append(p * REACH / distance, q_seed[3:]),
            limit="full stretch",
        )
    return [SimpleNamespace(q=np.append(p, q_seed[3:]))]


def contact(q: Array, _q_jaw: float) -> tuple[str, str] | None:
    return ("gripper", "floor") if q[2] < -0.2 else None


@dataclass(eq=False)
class PretendedPlan:
    q_start: Array
    q_goal: Array
    trajectory: Trajectory
    tool_path: Array
    limits: MotionLimits
    report: Any

    @property
    def duration(self) -> float:
        return self.trajectory.duration


def straight(q_start: Array, q_goal: Array) -> PretendedPlan:
    q = np.linspace(q_start, q_goal, 101)
    still = np.zeros_like(q)
    return PretendedPlan(
        q_start=q_start,
        q_goal=q_goal,
        trajectory=Trajectory(dt=0.01, q=q, qd=still, qdd=still, duration=1.0),
        tool_path=q[:, :3],
        limits=MotionLimits.uniform(velocity=1.0, acceleration=1.0, jerk=10.0),
        report=None,
    )


class PretendedArm:
    """An arm that is where it is told to be, and whose motions end when the test says so."""

    def __init__(self) -> None:
        self.speed = self.acceleration = 1.0
        self.scene: object = object()
        self.range = (np.full(5, -2.0), np.full(5, 2.0))
        self.newest = None
        self.failure: Exception | None = None
        self.executed: list[PretendedPlan] = []
        self.motion = SimpleNamespace(future=Future())
        self.state = JointState(
            t=0.0,
            mode=Mode.HOLDING,
            reading=JointReading(q=np.zeros(5), qd=np.zeros(5), q_jaw=0.0, qd_jaw=0.0),
            q_ref=np.zeros(5),
            qd_ref=np.zeros(5),
            q_jaw_ref=0.0,
            arm_moving=False,
            jaw_moving=False,
            late_ticks=0,
        )

    def be(self, q: Array, *, t: float = 0.0, mode: Mode = Mode.HOLDING) -> None:
        reading = JointReading(q=q, qd=np.zeros(5), q_jaw=0.0, qd_jaw=0.0)
        self.state = replace(
            self.state,
            t=t,
            reading=reading,
            q_ref=q,
            mode=mode,
            arm_moving=mode is Mode.MOVING,
            fault="servo 3 is hot" if mode is Mode.FAULT else None,
        )

    def set_speed(self, speed: float) -> None:
        self.speed = speed

    def set_acceleration(self, acceleration: float) -> None:
        self.acceleration = acceleration

    def plan(self, goal: PoseGoal | JointGoal) -> PretendedPlan:
        if self.failure is not None:
            raise self.failure
        q = goal.q if isinstance(goal, JointGoal) else np.append(goal.T_base_tool.p, np.zeros(2))
        return straight(self.state.q_ref, q)

    def start_execute(self, plan: PretendedPlan) -> Any:
        self.executed.append(plan)
        self.motion = SimpleNamespace(future=Future())
        return self.motion


class PretendedGripper:
    def __init__(self) -> None:
        self.apertures: list[float] = []
        self.is_holding = False

    def start_move(self, aperture: float) -> None:
        self.apertures.append(aperture)


def run_at_once(call: Callable[[], Any]) -> Future[Any]:
    future: Future[Any] = Future()
    try:
        future.set_result(call())
    except Exception as error:
        future.set_exception(error)
    return future


@pytest.fixture
def arm() -> PretendedArm:
    return PretendedArm()


@pytest.fixture
def gripper() -> PretendedGripper:
    return PretendedGripper()


class PageInputs:
    """What the page is given: a clock that the test drives, and solvers for some surroundings."""

    def __init__(self) -> None:
        self.t = 0.0
        self.loaded: list[Surroundings] = []
        self.failure: Exception | None = None

    def now(self) -> float:
        return self.t

    def load_solver(self, around: Surroundings) -> TargetSolver:
        self.loaded.append(around)
        if self.failure is not None:
            raise self.failure
        return TargetSolver(
            point=point,
            candidates=candidates,
            clearance=clearance,
            contact=contact,
            check_limits=check_limits,
            rotation=lambda _q, _frame: np.eye(3),
        )


@pytest.fixture
def inputs() -> PageInputs:
    return PageInputs()


@pytest.fixture
def page(arm: PretendedArm, gripper: PretendedGripper, inputs: PageInputs) -> ViewModel:
    return ViewModel(
        arm=arm,  # type: ignore[arg-type]
        gripper=gripper,  # type: ignore[arg-type]
        load_solver=inputs.load_solver,
        submit=run_at_once,
        now=inputs.now,
        welcome=WELCOME,
    )


def planned(page: ViewModel) -> Screen:
    page.plan()
    page.refresh()
    return page.screen()


def test_the_first_screen_shows_a_target_apart_from_the_arm_and_a_hint_of_the_way(
    page: ViewModel, arm: PretendedArm
) -> None:
    screen = page.screen()
    assert screen.sentence.text == WELCOME
    assert screen.q_ghost is not None
    assert screen.path is not None
    assert not screen.path.planned
    assert screen.can_plan
    assert not screen.can_execute
    assert arm.executed == []


def test_targets_are_undone_and_redone_and_a_drag_is_one_change(
    page: ViewModel, inputs: PageInputs
) -> None:
    first = page.target.p_base
    assert not page.screen().can_undo
    for k in range(5):
        inputs.t += 0.1
        page.set_target_point(np.array([0.1, 0.1, 0.01 * k]))
    inputs.t += 5.0
    page.set_target_joints(np.full(5, 0.3))
    page.undo()
    np.testing.assert_allclose(page.target.p_base, [0.1, 0.1, 0.04])
    page.undo()
    np.testing.assert_allclose(page.target.p_base, first)
    assert (page.screen().can_undo, page.screen().can_redo) == (False, True)
    page.redo()
    page.redo()
    np.testing.assert_allclose(page.target.q, np.full(5, 0.3))
    page.undo()
    page.set_target_point(np.array([0.2, 0.0, 0.1]))  # soon after, but what was undone is gone
    assert not page.screen().can_redo
    page.undo()
    np.testing.assert_allclose(page.target.p_base, [0.1, 0.1, 0.04])
    planned(page)
    page.undo()
    assert not page.plan_is_current


def test_two_buttons_show_the_product(page: ViewModel, arm: PretendedArm) -> None:
    screen = planned(page)
    assert screen.can_execute
    assert screen.path is not None
    assert screen.path.planned
    assert screen.sentence.tone is Tone.GOOD

    page.execute()
    assert len(arm.executed) == 1
    assert not page.screen().can_execute

    arm.be(arm.executed[0].q_goal, t=1.0)
    arm.motion.future.set_result(None)
    assert page.refresh()
    screen = page.screen()
    assert screen.sentence.text.startswith("Arrived, 0.0 mm off")
    assert screen.q_ghost is None
    assert screen.path is None
    assert not screen.can_plan
    assert not screen.can_execute


def test_nothing_moves_without_a_plan(page: ViewModel, arm: PretendedArm) -> None:
    page.execute()
    assert arm.executed == []


def test_out_of_reach_says_by_how_much_and_why_and_there_is_nothing_to_plan(
    page: ViewModel,
) -> None:
    page.set_target_point(np.array([0.0, 0.543, 0.0]))
    screen = page.screen()
    assert screen.sentence.text == "43 mm out of reach (arm fully stretched)."
    assert screen.sentence.tone is Tone.BAD
    assert screen.path is None
    assert not screen.can_plan
    page.plan()
    assert not page.refresh()
    assert page.screen().plan is None


def test_a_target_inside_the_table_says_what_touches_what(page: ViewModel) -> None:
    page.set_target_point(np.array([0.1, 0.0, -0.3]))
    screen = page.screen()
    assert screen.sentence.text == "The gripper would hit the floor."
    assert not screen.can_plan


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
def test_whatever_a_plan_was_made_for_changes_drops_it(
    page: ViewModel, arm: PretendedArm, change: Callable[[ViewModel], None]
) -> None:
    assert planned(page).can_execute
    change(page)
    assert not page.screen().can_execute
    page.execute()
    assert arm.executed == []


def test_an_arm_moved_by_somebody_else_drops_the_plan(page: ViewModel, arm: PretendedArm) -> None:
    assert planned(page).can_execute
    arm.be(np.full(5, to_rad(1.0)))
    assert page.refresh()
    screen = page.screen()
    assert not screen.can_execute
    assert screen.sentence.text == "The arm has moved. Press Plan again."


def test_the_preview_moves_the_ghost_along_the_plan(page: ViewModel) -> None:
    page.set_target_point(np.array([0.4, 0.0, 0.0]))
    assert planned(page).preview_time == 1.0
    page.preview(0.5)
    screen = page.screen()
    assert screen.q_ghost is not None
    np.testing.assert_allclose(screen.q_ghost[:3], [0.2, 0.0, 0.0])
    page.preview(99.0)
    assert page.screen().preview_time == 1.0


def test_progress_follows_the_clock_from_the_first_movement(
    page: ViewModel, arm: PretendedArm
) -> None:
    planned(page)
    page.execute()
    assert page.screen().progress == 0.0
    arm.be(np.zeros(5), t=7.0, mode=Mode.MOVING)
    page.refresh()
    arm.be(np.full(5, 0.05), t=7.5, mode=Mode.MOVING)
    assert page.refresh()
    assert page.screen().progress == pytest.approx(0.5)


def test_a_stop_is_told_plainly_and_the_target_can_be_planned_for_again(
    page: ViewModel, arm: PretendedArm
) -> None:
    planned(page)
    page.execute()
    arm.be(np.array([0.01, 0.0, 0.0, 0.0, 0.0]))
    arm.motion.future.set_exception(Interrupted("stop"))
    page.refresh()
    screen = page.screen()
    assert screen.sentence.text == "Stopped. The arm holds where it is."
    assert screen.can_plan
    assert not screen.can_execute


def test_a_failed_plan_is_told_in_its_own_words(page: ViewModel, arm: PretendedArm) -> None:
    arm.failure = NoPath("no way around <the table>; move the target")
    screen = planned(page)
    assert screen.sentence.text == "No way around <the table>; move the target."
    assert screen.sentence.tone is Tone.BAD
    assert screen.can_plan


def test_a_mistake_inside_is_told_and_does_not_stop_the_page(
    page: ViewModel, arm: PretendedArm
) -> None:
    arm.failure = ZeroDivisionError("oops")
    assert "Internal error" in planned(page).sentence.text


@pytest.mark.parametrize(
    ("mode", "words"),
    [(Mode.LIMP, "limp"), (Mode.FAULT, "Fault: see above"), (Mode.CALIBRATING, "calibrated")],
)
def test_an_arm_that_cannot_move_says_so_and_offers_no_buttons(
    page: ViewModel, arm: PretendedArm, mode: Mode, words: str
) -> None:
    planned(page)
    arm.be(np.zeros(5), mode=mode)
    page.refresh()
    screen = page.screen()
    assert words in screen.sentence.text
    assert not screen.can_plan
    assert not screen.can_execute


def test_dragging_during_a_motion_neither_stops_nor_redirects_it(
    page: ViewModel, arm: PretendedArm
) -> None:
    planned(page)
    page.execute()
    page.set_target_point(np.array([0.0, 0.3, 0.0]))
    screen = page.screen()
    assert not screen.can_plan
    assert not screen.can_execute
    arm.be(arm.executed[0].q_goal)
    arm.motion.future.set_result(None)
    page.refresh()
    screen = page.screen()
    assert screen.sentence.text.startswith("Arrived, 0.0 mm off")
    assert screen.can_plan
    assert len(arm.executed) == 1


def test_an_arm_at_rest_gives_nothing_new_to_show(page: ViewModel, arm: PretendedArm) -> None:
    assert not page.refresh()
    arm.be(np.full(5, to_rad(0.001)))
    assert not page.refresh()
    arm.be(np.full(5, to_rad(0.1)))
    assert page.refresh()
    assert not page.refresh()


def test_the_gripper_moves_at_once(page: ViewModel, gripper: PretendedGripper) -> None:
    page.move_jaw(1.0)
    page.move_jaw(0.0)
    assert gripper.apertures == [1.0, 0.0]


def test_at_the_target_there_is_nothing_to_plan(page: ViewModel) -> None:
    page.set_target_joints(np.zeros(5))
    screen = page.screen()
    assert screen.sentence.text == "The arm is already there."
    assert not screen.can_plan


def test_one_joint_turns_the_ghost_and_leaves_the_others(page: ViewModel) -> None:
    page.set_target_joints(np.full(5, 0.1))
    page.set_target_joint(3, 0.5)
    np.testing.assert_allclose(page.target.q, [0.1, 0.1, 0.1, 0.5, 0.1])
    page.set_target_joint(4, 2.1)
    assert (
        page.screen().sentence.text
        == "wrist_roll would be at 120.3°; its range is -114.6° to 114.6°."
    )
    assert not page.screen().can_plan


def test_another_frame_is_aimed_with_from_where_the_ghost_stands(page: ViewModel) -> None:
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


def test_here_is_where_the_arm_is(page: ViewModel, arm: PretendedArm) -> None:
    arm.be(np.full(5, 0.3))
    page.refresh()
    page.set_target_here()
    np.testing.assert_allclose(page.target.q, 0.3)
    assert page.screen().sentence.text == "The arm is already there."


def test_a_plan_shows_postures_on_its_way_and_where_it_comes_close(page: ViewModel) -> None:
    page.set_target_point(np.array([0.3, 0.0, -0.1]))
    screen = planned(page)
    assert screen.sweep is not None
    assert len(screen.sweep) >= 3
    assert 0.0 < screen.sweep[0][0] < screen.sweep[-1][0] < 0.3
    assert screen.plan is not None
    assert screen.plan.closest.distance == pytest.approx(0.1)
    assert screen.plan.t_closest == pytest.approx(1.0)
    page.show_sweep(False)
    assert page.screen().sweep is None


def test_the_ghost_plays_the_plan_at_the_pace_it_was_told(
    page: ViewModel, inputs: PageInputs
) -> None:
    planned(page)
    page.play(0.5)
    assert page.refresh()
    inputs.t += 0.8
    assert page.refresh()
    assert page.screen().preview_time == pytest.approx(0.4)
    page.play(0.5)  # once more: it stands
    inputs.t += 0.8
    assert not page.refresh()
    page.play(2.0)
    page.refresh()
    inputs.t += 5.0
    page.refresh()
    screen = page.screen()
    assert screen.preview_time == 1.0
    assert screen.rate is None


def test_new_surroundings_drop_the_plan_and_are_taken_up_beside_the_page(
    page: ViewModel, arm: PretendedArm, inputs: PageInputs
) -> None:
    assert planned(page).can_execute
    arm.scene = object()
    assert not page.screen().can_execute  # not even before the page has taken note
    assert page.refresh()
    screen = page.screen()
    assert screen.sentence.text == "The surroundings have changed. Press Plan again."
    assert not screen.can_execute
    page.refresh()
    assert inputs.loaded[-1].scene is arm.scene
    arm.range = (np.full(5, -1.0), np.full(5, 1.0))
    page.refresh()
    assert inputs.loaded[-1].range is arm.range
    page.refresh()
    assert not page.refresh()


def test_surroundings_that_cannot_be_taken_up_are_told(
    page: ViewModel, arm: PretendedArm, inputs: PageInputs
) -> None:
    inputs.failure = ConfigError("elbow_flex", [1, 1], "leaves no angle")
    arm.range = (np.full(5, 1.0), np.full(5, 1.0))
    page.refresh()
    page.refresh()
    assert "leaves no angle" in page.screen().sentence.text


def test_after_a_motion_it_is_told_how_well_the_arm_followed(
    page: ViewModel, arm: PretendedArm
) -> None:
    assert planned(page).tracking is None
    page.execute()
    for k in range(5):
        q = np.full(5, 0.02 * k)
        arm.be(q - 0.01, t=0.1 * k, mode=Mode.MOVING)
        arm.state = replace(arm.state, q_ref=q, qd_ref=np.full(5, 0.2))
        page.refresh()
    arm.be(arm.executed[0].q_goal, t=1.0)
    arm.motion.future.set_result(None)
    page.refresh()
    tracking = page.screen().tracking
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
    assert page.screen().tracked == "another motion"
    assert page.ran is ran  # what somebody else moved is no run of the plan
