import numpy as np
import pytest
from so101_description import load_visual
from so101_viewer.scene.robot_view import CELL, LINKS, SweepView

from so101_motion.planning.collision.shape_files import coarse
from so101_motion.planning.kinematics.model import RobotModel

BLUE = (60, 130, 246)


@pytest.mark.parametrize("part", LINKS.values())
def test_a_coarse_part_is_light_and_of_the_same_size(part):
    meshes = [surface.mesh for surface in load_visual(part)]
    vertices, faces = coarse([(mesh.vertices, mesh.faces) for mesh in meshes], CELL)
    fine = np.concatenate([surface.mesh.vertices for surface in load_visual(part)])
    np.testing.assert_allclose(vertices.min(axis=0), fine.min(axis=0), atol=0.003)
    np.testing.assert_allclose(vertices.max(axis=0), fine.max(axis=0), atol=0.003)
    count = sum(len(surface.mesh.faces) for surface in load_visual(part))
    assert 20 < len(faces) < 0.25 * count
    assert faces.max() < len(vertices)


def test_each_link_is_sent_once_and_stands_where_the_postures_say(scene):
    model = RobotModel.load()
    view = SweepView(scene, "/sweep", color=BLUE)
    view.show(None, 0.0, model)
    assert scene.under("/sweep", 1) == {}
    postures = np.array([np.full(5, 0.1), np.full(5, 0.2)])
    view.show(postures, 0.0, model)
    nodes = scene.under("/sweep", 1)
    assert set(nodes) == set(LINKS)
    expected = [model.link_placements(q, 0.0)["gripper_link"].p for q in postures]
    np.testing.assert_allclose(nodes["gripper_link"].batched_positions, expected, atol=1e-6)
    view.show(None, 0.0, model)
    assert not any(node.visible for node in nodes.values())
    view.show(postures[:1], 0.0, model)
    assert scene.under("/sweep", 1) == nodes
    assert all(node.visible for node in nodes.values())
