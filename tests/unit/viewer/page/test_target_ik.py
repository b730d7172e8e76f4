from types import SimpleNamespace

import numpy as np
import pytest
from so101_viewer.page.target_editor import TargetEditor
from so101_viewer.page.target_ik import FRAMES, Direction, TargetSolver

from so101_motion.common.errors import ConfigError
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import JointGoal, PoseGoal
from so101_motion.planning.kinematics.model import RobotModel

HOME = np.zeros(5)


@pytest.fixture(scope="module")
def solver():
    model = RobotModel.load()
    return TargetSolver(Scene(), (model.lower, model.upper))


def test_a_point_in_the_table_names_it_and_one_too_far_away_says_by_how_much(solver):
    target = solver.at_point(np.array([0.3, 0.0, -0.02]), "tool", q_seed=HOME, q_jaw=0.0)
    assert target.problem.endswith(" would hit the floor.")
    target = solver.at_point(np.array([0.6, 0.0, 0.2]), "tool", q_seed=HOME, q_jaw=0.0)
    assert target.problem is not None
    assert target.problem.endswith(" mm out of reach (arm fully stretched).")
    missing = 0.001 * float(target.problem.split()[0])
    off = float(np.linalg.norm(solver.point(target.q, "tool") - target.p_base))
    assert off == pytest.approx(missing, abs=0.001)


@pytest.mark.parametrize("frame", FRAMES)
def test_every_frame_of_the_hand_can_be_brought_to_a_point(solver, frame):
    p_base = np.array([0.25, 0.05, 0.10])
    target = solver.at_point(p_base, frame, q_seed=HOME, q_jaw=0.0)
    assert target.problem is None
    assert isinstance(target.goal, PoseGoal)
    np.testing.assert_allclose(solver.point(target.q, frame), p_base, atol=1e-4)


def test_joint_angles_are_a_target_and_outside_the_calibrated_range_name_the_joint(solver):
    model = RobotModel.load()
    target = solver.at_joints(np.full(5, 0.1), "tool", q_jaw=0.0)
    assert target.problem is None
    assert isinstance(target.goal, JointGoal)
    np.testing.assert_allclose(target.p_base, solver.point(np.full(5, 0.1), "tool"))
    target = solver.at_joints(np.array([0.0, 0.0, 3.0, 0.0, 0.0]), "tool", q_jaw=0.0)
    assert target.problem.startswith("elbow_flex would be at 171.89°; its range is ")
    narrow = TargetSolver(Scene(), (0.5 * model.lower, 0.5 * model.upper))
    assert "its range is" in narrow.at_joints(0.6 * model.upper, "tool", q_jaw=0.0).problem


class Editor(TargetEditor):
    """A target editor of a page that shows nothing."""

    def _aim(self, target):
        self.target = target


@pytest.fixture
def editor(solver):
    state = SimpleNamespace(q_ref=HOME, q_jaw_ref=0.0)
    return Editor(solver, state, lambda: 0.0)


@pytest.mark.parametrize(
    ("frame", "tilt_deg", "p_base"),
    [
        ("tool", -90.0, (0.2, 0.08, 0.12)),
        ("tool", 0.0, (0.2, 0.08, 0.12)),
        ("jaw_tip", -45.0, (0.2, 0.08, 0.12)),
        ("jaw_tip", -90.0, (0.22, 0.05, 0.06)),
    ],
)
def test_a_target_keeps_the_direction_of_the_gripper(editor, frame, tilt_deg, p_base):
    model = RobotModel.load()
    editor.set_target_frame(frame)
    editor.set_target_point(np.array(p_base))
    editor.set_direction("tilt")
    editor.set_tilt(np.radians(tilt_deg))
    for roll_deg in (None, 40.0):
        if roll_deg is not None:
            editor.set_roll(np.radians(roll_deg))
        target = editor.target
        assert target.problem is None
        T_base_frame = model.frame(target.q, frame)
        np.testing.assert_allclose(T_base_frame.p, p_base, atol=2e-4)
        off = np.degrees(np.arcsin(T_base_frame.R[2, 2])) - tilt_deg
        assert abs(off) < 3.1
    assert np.degrees(target.q[4]) == pytest.approx(40.0, abs=4.0)
    editor.set_target_point(np.array([0.2, 0.0, 0.1]))  # what was chosen stays
    assert editor.target.direction == Direction(tilt=np.radians(tilt_deg), roll=np.radians(40.0))


@pytest.mark.parametrize(
    ("p_base", "tilt_deg"), [((0.2, 0.08, 0.0), -90.0), ((0.36, 0.1, 0.0), -70.0)]
)
def test_a_click_on_the_table_is_reached_from_above(editor, p_base, tilt_deg):
    editor.set_target_above(np.array(p_base))
    assert editor.target.problem is None
    np.testing.assert_allclose(editor.target.p_base, (*p_base[:2], 0.02))
    assert editor.target.direction == Direction(tilt=np.radians(tilt_deg))
    editor.set_target_above(np.array([0.9, 0.0, 0.0]))
    assert editor.target.direction is None  # out of reach whatever it does
    editor.set_direction("tilt")
    editor.set_tilt(0.0)
    editor.set_target_above(np.array([0.2, 0.08, 0.1]))
    assert editor.target.direction == Direction(tilt=0.0)  # as was chosen


def test_undo_brings_back_how_much_of_the_direction_was_chosen(editor):
    editor.set_target_point(np.array([0.2, 0.08, 0.12]))
    editor.set_direction("tilt and roll")
    editor.history.undo()
    assert editor.kind == "any"
    editor.set_target_point(np.array([0.2, 0.0, 0.12]))
    assert editor.target.direction is None
    editor.history.undo()
    editor.set_direction("tilt")
    editor.history.undo()
    editor.history.redo()
    assert editor.kind == "tilt"
    assert editor.target.direction is not None


def test_turned_handles_turn_the_gripper_and_the_wrong_way_is_said(editor):
    editor.set_target_point(np.array([0.2, 0.08, 0.12]))
    editor.set_direction("tilt and roll")
    editor.set_tilt(np.radians(-60.0))
    editor.set_roll(np.radians(25.0))
    R = editor.R_base_target
    editor.set_direction("any")
    editor.set_turn(R)  # handles that are not to be seen cannot be turned
    assert editor.target.direction is None
    editor.set_direction("tilt and roll")
    editor.set_tilt(0.0)
    editor.set_turn(R)
    assert editor.direction.tilt == pytest.approx(np.radians(-60.0), abs=1e-6)
    assert editor.direction.roll == pytest.approx(np.radians(25.0), abs=0.05)
    editor.set_tilt(np.radians(90.0))
    assert editor.target.problem is not None
    with pytest.raises(ConfigError, match="direction"):
        editor.set_direction("sideways")
