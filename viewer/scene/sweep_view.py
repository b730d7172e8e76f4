"""Draw the swept motion: the arm at a few configurations of the plan, nearly transparent.

Each link's mesh is sent once and drawn as often as there are configurations. The base is left out.
"""

from __future__ import annotations

import numpy as np
import viser
from so101_description import PARTS, load_visual

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.shape_files import coarse
from so101_motion.planning.kinematics.model import RobotModel

from .robot_view import Color

_OPACITY = 0.10

CELL = 0.006
"""Edge of the grid that the meshes are thinned with [m]; chosen: a tenth of the triangles are left,
and at this opacity nobody sees the difference. Without a GPU all of them would treble the time of
a picture."""

LINKS = {link: part for link, part in PARTS.items() if link != "base_link"}


class SweepView:
    """Draws configurations of one arm along its path."""

    def __init__(self, scene: viser.SceneApi, root: str, *, color: Color) -> None:
        self._scene, self._color = scene, color
        self._root = scene.add_frame(root, show_axes=False)
        self._name = root
        self._links: dict[str, viser.BatchedMeshHandle] = {}
        self._shown: Array | None = None

    def set_visible(self, visible: bool) -> None:
        """Show or hide all of it."""
        self._root.visible = visible

    def show(self, configurations: Array | None, q_jaw: float, model: RobotModel) -> None:
        """Draw the arm at these configurations, shape (k, 5), [rad]; None hides it.

        Args:
            configurations: What to draw; nothing is done when they are those drawn last.
            q_jaw: Jaw angle [rad].
            model: Where the links are.
        """
        if configurations is self._shown:
            return
        self._shown = configurations
        if configurations is None:
            for node in self._links.values():
                node.visible = False
            return
        placed = [model.link_placements(q, q_jaw) for q in configurations]
        for link in LINKS:
            wxyzs = np.array([T_base[link].quaternion_wxyz() for T_base in placed])
            positions = np.array([T_base[link].p for T_base in placed])
            self._put(link, wxyzs, positions)

    def _put(self, link: str, wxyzs: Array, positions: Array) -> None:
        node = self._links.get(link)
        if node is not None:
            node.batched_wxyzs = wxyzs.astype(np.float32)
            node.batched_positions = positions.astype(np.float32)
            node.visible = True
            return
        surfaces = [surface.mesh for surface in load_visual(LINKS[link])]
        vertices, faces = coarse([(mesh.vertices, mesh.faces) for mesh in surfaces], CELL)
        self._links[link] = self._scene.add_batched_meshes_simple(
            f"{self._name}/{link}",
            vertices,
            faces,
            wxyzs,
            positions,
            batched_colors=self._color,
            opacity=_OPACITY,
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )
