"""The arm as a picture: one frame per link, with the link's meshes hung under it.

The frames are all siblings under one root and get absolute poses, so moving the arm is seven
small messages and no kinematics in the browser.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from functools import cache

import numpy as np
import viser
from so101_description import PARTS, Surface, load_visual

from so101_motion.geometry import SE3

Color = tuple[int, int, int]


class RobotView:
    """One arm in the scene.

    Args:
        scene: Where to draw it.
        root: Name of its root node, e.g. ``"/live"``.
        color: One colour for all parts; None for their own.
        opacity: 0 to 1 for a see-through ghost without shadows; None for a solid arm.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        root: str,
        *,
        color: Color | None = None,
        opacity: float | None = None,
    ) -> None:
        self._root = scene.add_frame(root, show_axes=False)
        self._frames = {link: scene.add_frame(f"{root}/{link}", show_axes=False) for link in PARTS}
        self._meshes: dict[str, list[viser.MeshHandle]] = {link: [] for link in PARTS}
        self._own: dict[str, list[Color]] = {link: [] for link in PARTS}
        for link, part in PARTS.items():
            for k, surface in enumerate(_surfaces(part)):
                own = color or _bytes(surface.color)
                self._own[link].append(own)
                self._meshes[link].append(
                    scene.add_mesh_simple(
                        f"{root}/{link}/{surface.name}_{k}",
                        surface.mesh.vertices,
                        surface.mesh.faces,
                        color=own,
                        opacity=opacity,
                        cast_shadow=opacity is None,
                        receive_shadow=opacity is None,
                    )
                )

    def move(self, T_base: Mapping[str, SE3]) -> None:
        """Put every link where ``T_base`` says; keys are link names."""
        for link, frame in self._frames.items():
            T_base_link = T_base[link]
            frame.position = T_base_link.p
            frame.wxyz = T_base_link.quaternion_wxyz()

    def show(self, links: Container[str]) -> None:
        """Show these links and hide the others."""
        for link, frame in self._frames.items():
            frame.visible = link in links

    def set_visible(self, visible: bool) -> None:
        """Show it, as far as its links are shown, or hide it as a whole."""
        self._root.visible = visible

    def paint(self, color: Color, links: Container[str] = PARTS) -> None:
        """Give all its parts one colour, or those of these links."""
        for link, meshes in self._meshes.items():
            if link in links:
                for mesh in meshes:
                    mesh.color = color

    def repaint(self) -> None:
        """Give all its parts the colours they had at first."""
        for link, meshes in self._meshes.items():
            for mesh, own in zip(meshes, self._own[link], strict=True):
                mesh.color = own


@cache
def _surfaces(part: str) -> tuple[Surface, ...]:
    surfaces: tuple[Surface, ...] = load_visual(part)
    return surfaces


def _bytes(color: tuple[float, float, float]) -> Color:
    red, green, blue = (int(x) for x in np.round(255.0 * np.array(color)))
    return red, green, blue
