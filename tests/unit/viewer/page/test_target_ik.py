from __future__ import annotations

import numpy as np
import pytest
from so101_viewer.page.target_ik import FRAMES, Surroundings, TargetSolver

from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import JointGoal, PoseGoal
from so101_motion.planning.kinematics.model import RobotModel

HOME = np.zeros(5)


@pytest.fixture(scope="module")
def solver() -> TargetSolver:
    model = RobotModel.load()
    return TargetSolver.load(Surroundings(Scene(), (model.lower, model.upper)))


def test_the_ghost_stands_at_a_point_within_reach(solver: TargetSolver) -> None:
    p_base = np.array([0.25, 0.12, 0.15])
    target = solver.at_point(p_base, "tool", q_seed=HOME, q_jaw=0.0)
    assert target.problem is None
    np.testing.assert_allclose(solver.point(target.q, "tool"), p_base, atol=1e-4)
    assert isinstance(target.goal, PoseGoal)


def test_a_point_too_far_away_says_by_how_many_millimetres(solver: TargetSolver) -> None:
    target = solver.at_point(np.array([0.6, 0.0, 0.2]), "tool", q_seed=HOME, q_jaw=0.0)
    assert target.problem is not None
    assert target.problem.endswith(" mm out of reach (arm fully stretched).")
    missing = 0.001 * float(target.problem.split()[0])
    off = float(np.linalg.norm(solver.point(target.q, "tool") - target.p_base))
    assert off == pytest.approx(missing, abs=0.001)


def test_a_point_under_the_table_names_the_floor(solver: TargetSolver) -> None:
    target = solver.at_point(np.array([0.3, 0.0, -0.02]), "tool", q_seed=HOME, q_jaw=0.0)
    assert target.problem is not None
    assert target.problem.endswith(" would hit the floor.")


def test_joint_angles_are_a_target_too(solver: TargetSolver) -> None:
    target = solver.at_joints(np.full(5, 0.1), "tool", q_jaw=0.0)
    assert target.problem is None
    assert isinstance(target.goal, JointGoal)
    np.testing.assert_allclose(target.p_base, solver.point(np.full(5, 0.1), "tool"))


@pytest.mark.parametrize("frame", FRAMES)
def test_every_frame_of_the_hand_can_be_brought_to_a_point(
    solver: TargetSolver, frame: str
) -> None:
    p_base = np.array([0.25, 0.05, 0.10])
    target = solver.at_point(p_base, frame, q_seed=HOME, q_jaw=0.0)
    assert target.problem is None
    np.testing.assert_allclose(solver.point(target.q, frame), p_base, atol=1e-4)


def test_joint_angles_outside_the_limits_name_the_joint(solver: TargetSolver) -> None:
    target = solver.at_joints(np.array([0.0, 0.0, 3.0, 0.0, 0.0]), "tool", q_jaw=0.0)
    assert target.problem is not None
    assert target.problem.startswith("elbow_flex would be at 171.9°; its range is ")


def test_an_arm_that_was_calibrated_for_less_is_aimed_within_less() -> None:
    model = RobotModel.load()
    narrow = TargetSolver.load(Surroundings(Scene(), (0.5 * model.lower, 0.5 * model.upper)))
    target = narrow.at_joints(0.6 * model.upper, "tool", q_jaw=0.0)
    assert target.problem is not None
    assert "its range is" in target.problem
