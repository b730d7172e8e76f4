import numpy as np
import pytest
from so101_viewer.scene.reach_view import Reach

from so101_motion.common.errors import Unreachable
from so101_motion.planning.goals import PoseGoal
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel

MODEL = RobotModel.load()
NEAR_EDGE = 0.02
"""How far from the edge of the shade a point must be to be judged [m]."""


def can_reach(solver, p, frame):
    try:
        return bool(next(iter(solver.candidates(PoseGoal.at_point(p, frame=frame), np.zeros(5)))))
    except Unreachable:
        return False


@pytest.mark.parametrize(("frame", "height"), [("tool", 0.1), ("tool", 0.3), ("jaw_tip", 0.2)])
def test_the_reachable_area_is_shaded(frame, height):
    reach, solver = Reach(MODEL, frame), IkSolver(MODEL)
    rings = reach.rings(height)
    edges = np.array(rings).ravel()
    for radius in np.linspace(0.06, 0.5, 12):
        if np.min(np.abs(edges - radius)) < NEAR_EDGE:
            continue
        away = radius * np.array([np.cos(0.4), np.sin(0.4)])
        p = np.array([*(reach.axis + away), height])
        shaded = any(inner <= radius <= outer for inner, outer in rings)
        assert shaded == can_reach(solver, p, frame), radius
