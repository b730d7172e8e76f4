"""What stands around the arm and what it holds, as shapes on the stage.

Nodes are numbered, not named after things: a name that a user gave never becomes part of a path or
of the page.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import trimesh
import viser

from so101_motion.geometry import SE3
from so101_motion.planning.scene import Box, Capsule, Mesh, PointCloud, Scene, Shape, Sphere

_OBSTACLE = (134, 142, 150)
_KEEP_OUT = (224, 49, 49)
_HELD = (240, 165, 0)
_SOLID, _AIR = 0.9, 0.25


class _Node(Protocol):
    wxyz: np.ndarray
    position: np.ndarray


class SceneView:
    """Draws a scene once and moves what is held.

    Args:
        stage: Where to draw.
        scene: What to draw.
    """

    def __init__(self, stage: viser.SceneApi, scene: Scene) -> None:
        for k, thing in enumerate(scene.obstacles):
            color, opacity = (_KEEP_OUT, _AIR) if thing.keep_out else (_OBSTACLE, _SOLID)
            node = _draw(stage, f"/around/{k}", thing.shape, color, opacity)
            _place(node, thing.T_base_obstacle)
        self._held = [
            (_draw(stage, f"/held/{k}", thing.shape, _HELD, _SOLID), thing.T_tool_object)
            for k, thing in enumerate(scene.attached)
        ]

    @property
    def holds(self) -> bool:
        """Whether anything is held."""
        return bool(self._held)

    def move(self, T_base_tool: SE3) -> None:
        """Take what is held along with the tool."""
        for node, T_tool_object in self._held:
            _place(node, T_base_tool @ T_tool_object)


def _place(node: _Node, pose: SE3) -> None:
    node.wxyz, node.position = pose.quaternion_wxyz(), pose.p


def _draw(
    stage: viser.SceneApi, name: str, shape: Shape, color: tuple[int, int, int], opacity: float
) -> _Node:
    if isinstance(shape, PointCloud):
        colors = np.tile(np.array(color, dtype=np.uint8), (len(shape.points), 1))
        return stage.add_point_cloud(name, shape.points, colors, point_size=shape.resolution)
    vertices, triangles = _surface(shape)
    return stage.add_mesh_simple(name, vertices, triangles, color=color, opacity=opacity)


def _surface(shape: Box | Sphere | Capsule | Mesh) -> tuple[np.ndarray, np.ndarray]:
    if isinstance(shape, Mesh):
        return shape.vertices, shape.triangles
    if isinstance(shape, Box):
        body = trimesh.creation.box(shape.size)
    elif isinstance(shape, Sphere):
        body = trimesh.creation.icosphere(3, shape.radius)
    else:
        body = trimesh.creation.capsule(shape.length - 2.0 * shape.radius, shape.radius)
        body.apply_translation(-body.bounds.mean(axis=0))
    return np.asarray(body.vertices), np.asarray(body.faces)
