import numpy as np
import pytest
from so101_description import PARTS, load_visual
from so101_viewer.scene.robot_view import LINKS, RobotView, SweepView
from so101_viewer.server.guarded_server import start_guarded

from so101_motion.planning.kinematics.model import RobotModel


class NotedScene:
    """viser's scene, and what was added to it.

    Attributes:
        nodes: The handles that viser gave, by the names of their nodes.
    """

    def __init__(self, scene):
        self._scene = scene
        self.nodes = {}

    def __getattr__(self, name):
        add = getattr(self._scene, name)

        def noted(node, *args, **settings):
            self.nodes[node] = add(node, *args, **settings)
            return self.nodes[node]

        return noted

    def under(self, root, depth):
        """The nodes so many levels below ``root``, by what is behind it in their names."""
        names = {node: node.removeprefix(f"{root}/") for node in self.nodes if node != root}
        return {
            name: self.nodes[node]
            for node, name in names.items()
            if node.startswith(f"{root}/") and name.count("/") == depth - 1
        }


@pytest.fixture(scope="module")
def scene():
    server = start_guarded(port=0)
    yield NotedScene(server.viser.scene)
    server.close()


def placed():
    return RobotModel.load().link_placements(np.zeros(5), 0.0)


def meshes(scene, root):
    return list(scene.under(root, 2).values())


def sent(scene, root):
    """The links whose meshes were sent."""
    return {name.split("/")[0] for name in scene.under(root, 2)}


def test_every_link_stands_where_the_kinematics_put_it(scene):
    view = RobotView(scene, "/arm")
    placements = RobotModel.load().link_placements(np.array([0.3, -0.5, 0.4, 0.2, 1.0]), 0.5)
    view.move(placements)
    frames = scene.under("/arm", 1)
    assert set(frames) == set(PARTS) == set(placements)
    for link, frame in frames.items():
        np.testing.assert_allclose(frame.position, placements[link].p)
        np.testing.assert_allclose(frame.wxyz, placements[link].quaternion_wxyz())


def test_a_ghost_is_of_one_colour_and_changes_it_as_a_whole(scene):
    view = RobotView(scene, "/other", color=(60, 130, 246), opacity=0.35)
    view.move(placed())
    view.paint((224, 49, 49))
    assert {tuple(mesh.color) for mesh in meshes(scene, "/other")} == {(224, 49, 49)}
    assert {mesh.opacity for mesh in meshes(scene, "/other")} == {0.35}


def test_a_link_is_sent_when_it_is_to_be_seen_for_the_first_time(scene):
    view = RobotView(scene, "/late")
    assert not sent(scene, "/late")
    view.set_visible(False)
    view.show({"gripper_link"})
    view.move(placed())
    assert not sent(scene, "/late")
    view.set_visible(True)
    assert sent(scene, "/late") == {"gripper_link"}
    view.show(PARTS)
    assert sent(scene, "/late") == set(PARTS)
    frames = scene.under("/late", 1)
    for links in ({"gripper_link"}, set()):
        view.show(links)
        assert {link for link, frame in frames.items() if frame.visible} == links


def test_a_colour_holds_for_links_that_are_seen_later(scene):
    view = RobotView(scene, "/painted")
    view.show(())
    view.move(placed())
    view.paint((1, 2, 3), {"wrist_link"})
    view.show({"wrist_link"})
    painted = meshes(scene, "/painted")
    assert {tuple(mesh.color) for mesh in painted} == {(1, 2, 3)}
    view.repaint()
    assert (1, 2, 3) not in {tuple(mesh.color) for mesh in painted}


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
