from __future__ import annotations

import numpy as np
import pytest
from so101_viewer.aim import Aimer

from so101_motion.planning.goals import JointGoal, PoseGoal
from so101_motion.planning.scene import Scene

HOME = np.zeros(5)


@pytest.fixture(scope="module")
def aimer() -> Aimer:
    return Aimer.load(scene=Scene())


def test_the_ghost_stands_at_a_point_within_reach(aimer: Aimer) -> None:
    p_base = np.array([0.25, 0.12, 0.15])
    aim = aimer.at_point(p_base, q_seed=HOME, q_jaw=0.0)
    assert aim.problem is None
    np.testing.assert_allclose(aimer.tool_point(aim.q), p_base, atol=1e-4)
    assert isinstance(aim.goal, PoseGoal)


def test_a_point_too_far_away_says_by_how_many_millimetres(aimer: Aimer) -> None:
    aim = aimer.at_point(np.array([0.6, 0.0, 0.2]), q_seed=HOME, q_jaw=0.0)
    assert aim.problem is not None
    assert aim.problem.startswith("Out of reach by ")
    missing = 0.001 * float(aim.problem.split()[4])
    off = float(np.linalg.norm(aimer.tool_point(aim.q) - aim.p_base))
    assert off == pytest.approx(missing, abs=0.001)


def test_a_point_under_the_table_names_the_floor(aimer: Aimer) -> None:
    aim = aimer.at_point(np.array([0.3, 0.0, -0.02]), q_seed=HOME, q_jaw=0.0)
    assert aim.problem is not None
    assert aim.problem.startswith("Collides there: ")
    assert "floor" in aim.problem


def test_joint_angles_are_a_target_too(aimer: Aimer) -> None:
    aim = aimer.at_joints(np.full(5, 0.1), q_jaw=0.0)
    assert aim.problem is None
    assert isinstance(aim.goal, JointGoal)
    np.testing.assert_allclose(aim.p_base, aimer.tool_point(np.full(5, 0.1)))
