"""Draw the arm: one frame per link, with the link's meshes under it.

The frames are siblings with absolute poses, so the browser needs no kinematics.
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping
from functools import cache

import numpy as np
import viser
from so101_description import PARTS, Surface, load_visual

from so101_motion.common.geometry import SE3, Array, rotation_angle
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.planning.collision.shape_files import coarse
from so101_motion.planning.kinematics.model import RobotModel

Color = tuple[int, int, int]

MOVED_LINK = {
    "shoulder_pan": "shoulder_link",
    "shoulder_lift": "upper_arm_link",
    "elbow_flex": "lower_arm_link",
    "wrist_flex": "wrist_link",
    "wrist_roll": "gripper_link",
    GRIPPER_JOINT: "moving_jaw_so101_v1_link",
}
"""The link that each joint's motor moves; it is highlighted for the joint."""

_OPACITY = 0.10

CELL = 0.006
"""Edge of the grid that the meshes are thinned with [m]; chosen: a tenth of the triangles are left,
and at this opacity nobody sees the difference. Without a GPU all of them would treble the time of
a picture."""

LINKS = {link: part for link, part in PARTS.items() if link != "base_link"}


class RobotView:
    """One arm in the scene.

    A link's meshes are sent when it is shown for the first time: widgets reach the browser first,
    and an arm that is hidden costs nothing.

    Args:
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
        self._scene, self._name, self._color, self._opacity = scene, root, color, opacity
        self._root = scene.add_frame(root, show_axes=False)
        self._frames = {link: scene.add_frame(f"{root}/{link}", show_axes=False) for link in PARTS}
        self._meshes: dict[str, list[viser.MeshHandle]] = {}
        self._painted: dict[str, Color] = {}
        self._shown = frozenset(PARTS)
        self._is_placed = False

    def move(self, T_base: Mapping[str, SE3]) -> None:
        """Place every link at ``T_base``; keys are link names."""
        for link, frame in self._frames.items():
            T_base_link = T_base[link]
            frame.position = T_base_link.p
            frame.wxyz = T_base_link.quaternion_wxyz()
        self._is_placed = True
        self._draw()

    def show(self, links: Container[str]) -> None:
        self._shown = frozenset(link for link in PARTS if link in links)
        for link, frame in self._frames.items():
            frame.visible = link in self._shown
        self._draw()

    def move_beside(self, T_base: Mapping[str, SE3], T_arm: Mapping[str, SE3]) -> None:
        """Place a ghost; its links that stand where those of the arm do are hidden."""
        self.show({link for link in PARTS if looks_different(T_base[link], T_arm[link])})
        self.move(T_base)

    def set_visible(self, visible: bool) -> None:
        """Show it, as far as its links are shown, or hide it completely."""
        self._root.visible = visible
        self._draw()

    def paint(self, color: Color, links: Container[str] = PARTS) -> None:
        for link in PARTS:
            if link in links:
                self._painted[link] = color
                for mesh in self._meshes.get(link, ()):
                    mesh.color = color

    def repaint(self) -> None:
        self._painted.clear()
        for link, meshes in self._meshes.items():
            for mesh, (own, _) in zip(meshes, self._looks(link), strict=True):
                mesh.color = own

    def _draw(self) -> None:
        if not self._is_placed or not self._root.visible:
            return
        for link in PARTS:
            if link not in self._shown or link in self._meshes:
                continue
            self._meshes[link] = [
                self._scene.add_mesh_simple(
                    f"{self._name}/{link}/{surface.name}_{k}",
                    surface.mesh.vertices,
                    surface.mesh.faces,
                    color=self._painted.get(link, own),
                    opacity=self._opacity,
                    cast_shadow=self._opacity is None,
                    receive_shadow=self._opacity is None,
                )
                for k, (own, surface) in enumerate(self._looks(link))
            ]

    def _looks(self, link: str) -> list[tuple[Color, Surface]]:
        surfaces = _surfaces(PARTS[link])
        return [(self._color or _bytes(surface.color), surface) for surface in surfaces]


def looks_different(T: SE3, other: SE3) -> bool:
    """Whether two placements differ visibly; coinciding surfaces would flicker."""
    turned = rotation_angle(T.R.T @ other.R)
    return bool(np.linalg.norm(T.p - other.p) > 0.002 or turned > math.radians(1.0))


def segments(points: Array) -> Array:
    """A line through ``points``, shape (n, 3), as pieces, shape (n - 1, 2, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1)


class Line:
    """A line in the scene that comes, changes and goes."""

    def __init__(self, scene: viser.SceneApi, name: str) -> None:
        self._scene, self._name = scene, name
        self._node: viser.LineSegmentsHandle | None = None
        self._visible = True

    def set_visible(self, visible: bool) -> None:
        self._visible = visible
        if self._node is not None:
            self._node.visible = visible

    def show(self, pieces: Array | None, color: Color, thickness: float = 3.0) -> None:
        """Draw pieces, shape (n, 2, 3), [m], so thick [px], instead of what was there."""
        if self._node is not None:
            self._node.remove()
            self._node = None
        if pieces is not None and len(pieces):
            self._node = self._scene.add_line_segments(
                self._name,
                pieces,
                color,
                thickness=thickness,
                thickness_units="screen",
                visible=self._visible,
            )


@cache
def _surfaces(part: str) -> tuple[Surface, ...]:
    surfaces: tuple[Surface, ...] = load_visual(part)
    return surfaces


def _bytes(color: tuple[float, float, float]) -> Color:
    red, green, blue = (int(x) for x in np.round(255.0 * np.array(color)))
    return red, green, blue


class SweepView:
    """Draws configurations of one arm along its path, nearly transparent and without the base.

    Each link's mesh is sent once and drawn as often as there are configurations.
    """

    def __init__(self, scene: viser.SceneApi, root: str, *, color: Color) -> None:
        self._scene, self._color = scene, color
        self._root = scene.add_frame(root, show_axes=False)
        self._name = root
        self._links: dict[str, viser.BatchedMeshHandle] = {}
        self._shown: Array | None = None

    def set_visible(self, visible: bool) -> None:
        self._root.visible = visible

    def show(self, configurations: Array | None, q_jaw: float, model: RobotModel) -> None:
        """Draw the arm at these configurations, shape (k, 5), [rad]; None hides it."""
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
