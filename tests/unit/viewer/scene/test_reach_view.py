import numpy as np
import pytest
from so101_viewer.scene.reach_view import Reach, ReachView, mesh

from so101_motion.common.errors import Unreachable
from so101_motion.planning.goals import PoseGoal
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.sweeps.atlas import Atlas
from so101_motion.tasks.sweeps.reach import Grid

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


def test_the_shade_is_a_flat_ring_between_the_limits_of_the_base():
    reach = Reach(MODEL, "tool")
    rings = [(0.1, 0.2)]
    vertices, faces = mesh(reach, rings, 0.05)
    away = vertices[:, :2] - reach.axis
    np.testing.assert_allclose(vertices[:, 2], 0.05)
    assert set(np.round(np.hypot(*away.T), 6)) == {0.1, 0.2}
    angles = np.arctan2(away[:, 1], away[:, 0])
    np.testing.assert_allclose([angles.min(), angles.max()], reach.pan)
    assert faces.max() == len(vertices) - 1
    assert reach.rings(2.0) == []


class Scene:
    """Keeps what is there to be seen."""

    def __init__(self):
        self.shown = []

    def add_batched_meshes_simple(self, name, vertices, faces, wxyzs, positions, **_looks):
        return Node(self.shown, positions)

    def add_mesh_simple(self, name, *_args, **_looks):
        return Node(self.shown, name)


class Node:
    """One of the things, until it is removed."""

    def __init__(self, shown, what):
        self._shown, self._what = shown, what
        shown.append(what)

    def remove(self):
        self._shown[:] = [each for each in self._shown if each is not self._what]


def test_an_atlas_is_shaded_at_the_height_of_a_target_of_its_frame():
    grid = Grid(0.1, (0, 0, 0), (4, 1, 3))
    kinds = [("ways", "u2"), ("torque_left", "f4")]
    rows = np.array([(1, 0.5), (0, 0.5), (2, -0.1), (3, 0.9), (1, 0.2)], dtype=kinds)
    atlas = Atlas({"frame": "tool"}, grid, np.array([4, 5, 6, 7, 8]), rows)
    scene = Scene()
    view = ReachView(scene, MODEL, atlas)
    view.show("tool", 0.12)  # free of contact and not too heavy
    (squares,) = scene.shown
    assert squares == pytest.approx(np.array([[0.0, 0.0, 0.1], [0.3, 0.0, 0.1]]))
    view.show("tool", 0.5)
    assert scene.shown == []
    view.show("jaw_tip", 0.1)  # is not what the atlas is of
    assert scene.shown == ["/reach"]
    view.hide()
    assert scene.shown == []
