from __future__ import annotations

import numpy as np
import pytest
from so101_viewer.aim import FRAMES, Aimer, Surroundings

from so101_motion.planning.goals import JointGoal, PoseGoal
from so101_motion.planning.model import RobotModel
from so101_motion.planning.scene import Scene

HOME = np.zeros(5)


@pytest.fixture(scope="module")
def aimer() -> Aimer:
    model = RobotModel.load()
    return Aimer.load(Surroundings(Scene(), (model.lower, model.upper)))


def test_the_ghost_stands_at_a_point_within_reach(aimer: Aimer) -> None:
    p_base = np.array([0.25, 0.12, 0.15])
    aim = aimer.at_point(p_base, "tool", q_seed=HOME, q_jaw=0.0)
    assert aim.problem is None
    np.testing.assert_allclose(aimer.point(aim.q, "tool"), p_base, atol=1e-4)
    assert isinstance(aim.goal, PoseGoal)


def test_a_point_too_far_away_says_by_how_many_millimetres(aimer: Aimer) -> None:
    aim = aimer.at_point(np.array([0.6, 0.0, 0.2]), "tool", q_seed=HOME, q_jaw=0.0)
    assert aim.problem is not None
    assert aim.problem.startswith("Out of reach by ")
    missing = 0.001 * float(aim.problem.split()[4])
    off = float(np.linalg.norm(aimer.point(aim.q, "tool") - aim.p_base))
    assert off == pytest.approx(missing, abs=0.001)


def test_a_point_under_the_table_names_the_floor(aimer: Aimer) -> None:
    aim = aimer.at_point(np.array([0.3, 0.0, -0.02]), "tool", q_seed=HOME, q_jaw=0.0)
    assert aim.problem is not None
    assert aim.problem.startswith("Collides there: ")
    assert "floor" in aim.problem


def test_joint_angles_are_a_target_too(aimer: Aimer) -> None:
    aim = aimer.at_joints(np.full(5, 0.1), "tool", q_jaw=0.0)
    assert aim.problem is None
    assert isinstance(aim.goal, JointGoal)
    np.testing.assert_allclose(aim.p_base, aimer.point(np.full(5, 0.1), "tool"))


@pytest.mark.parametrize("frame", FRAMES)
def test_every_frame_of_the_hand_can_be_brought_to_a_point(aimer: Aimer, frame: str) -> None:
    p_base = np.array([0.25, 0.05, 0.10])
    aim = aimer.at_point(p_base, frame, q_seed=HOME, q_jaw=0.0)
    assert aim.problem is None
    np.testing.assert_allclose(aimer.point(aim.q, frame), p_base, atol=1e-4)


def test_joint_angles_outside_the_limits_name_the_joint(aimer: Aimer) -> None:
    aim = aimer.at_joints(np.array([0.0, 0.0, 3.0, 0.0, 0.0]), "tool", q_jaw=0.0)
    assert aim.problem is not None
    assert aim.problem.startswith("elbow_flex at 171.9° is outside its ")


def test_an_arm_that_was_calibrated_for_less_is_aimed_within_less() -> None:
    model = RobotModel.load()
    narrow = Aimer.load(Surroundings(Scene(), (0.5 * model.lower, 0.5 * model.upper)))
    aim = narrow.at_joints(0.6 * model.upper, "tool", q_jaw=0.0)
    assert aim.problem is not None
    assert "is outside its" in aim.problem
