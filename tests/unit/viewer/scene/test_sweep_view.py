import numpy as np
from so101_description import load_visual
from so101_viewer.scene.robot_view import LINKS, SweepView

from so101_motion.planning.kinematics.model import RobotModel

BLUE = (60, 130, 246)


def test_each_link_is_sent_once_and_stands_where_the_postures_say(scene):
    model = RobotModel.load()
    view = SweepView(scene, "/sweep", color=BLUE)
    view.show(None, 0.0, model)
    assert scene.under("/sweep", 1) == {}
    postures = np.array([np.full(5, 0.1), np.full(5, 0.2)])
    view.show(postures, 0.0, model)
    nodes = scene.under("/sweep", 1)
    assert set(nodes) == set(LINKS)
    for link, node in nodes.items():  # light, and of the same size
        fine = [surface.mesh for surface in load_visual(LINKS[link])]
        assert 20 < len(node.faces) < 0.25 * sum(len(mesh.faces) for mesh in fine)
        corners = np.concatenate([mesh.vertices for mesh in fine])
        np.testing.assert_allclose(node.vertices.min(axis=0), corners.min(axis=0), atol=0.003)
        np.testing.assert_allclose(node.vertices.max(axis=0), corners.max(axis=0), atol=0.003)
    expected = [model.link_placements(q, 0.0)["gripper_link"].p for q in postures]
    np.testing.assert_allclose(nodes["gripper_link"].batched_positions, expected, atol=1e-6)
    view.show(None, 0.0, model)
    assert not any(node.visible for node in nodes.values())
    view.show(postures[:1], 0.0, model)
    assert scene.under("/sweep", 1) == nodes
    assert all(node.visible for node in nodes.values())
