"""Draw obstacles and held objects, and find which of them, or the floor, a click hits.

Nodes are numbered, so a name that a user typed never becomes part of a node's path.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
import trimesh
import viser

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.scene import (
    Attached,
    Box,
    Capsule,
    Mesh,
    PointCloud,
    Scene,
    Shape,
    Sphere,
)
from so101_motion.planning.collision.shape_files import read_shape

from .scene_edits import Thing, holder_of, pose_of, things

_OBSTACLE = (134, 142, 150)
_KEEP_OUT = (224, 49, 49)
_HELD = (240, 165, 0)
_ITEM = (140, 95, 200)
_CHOSEN = (12, 166, 120)
_AIR, _CHOSEN_AIR = 0.25, 0.5

_ROOT = "/world"

FLOOR_SIZE = 1.2  # edge of the floor that is drawn [m]; chosen: somewhat beyond the arm's reach

_AXES = 0.4  # how long X and Y are drawn on it [m]; chosen: their ends are in the first picture
_ABOVE = np.array([0.0, 0.0, 0.012])  # else the floor's lines go through the words [m]
_AXIS_NAMES = (f"X {1000.0 * _AXES:.0f} mm", "Y")  # the arm may hide a part of a longer Y
_AXIS_COLORS = np.array([(224, 49, 49), (47, 158, 68)])
"""Of X and Y, about as the arrows of the target have them."""

_FURTHEST = 3.0  # where the search along the ray ends [m]; chosen: the camera stands within two

_EDGE = 1e-9
"""How far beside a triangle it is met too, as a share of it: no ray slips between two of them."""


@dataclass(slots=True)
class _Drawn:
    """A thing and its scene node."""

    thing: Thing
    chosen: bool
    pose: SE3 | None
    node: Any


class SceneView:
    """Draws a scene, sending only what differs; ``on_pick`` connects clicks on a thing's node."""

    def __init__(
        self,
        stage: viser.SceneApi,
        *,
        on_pick: Callable[[Any, str], None] | None = None,
    ) -> None:
        self._stage, self._on_pick = stage, on_pick
        self._drawn: dict[str, _Drawn] = {}
        self._numbers = count()
        self._floor: viser.GridHandle | None = None

    def show(self, scene: Scene, tools: Mapping[str, SE3], *, chosen: str | None = None) -> None:
        """Draw ``scene``; the tools, by the names that ``holder_of`` gives, carry what is held."""
        self._show_floor(scene.floor_z)
        there = {thing.name: thing for thing in things(scene)}
        for name in [name for name, drawn in self._drawn.items() if not _still(drawn, there)]:
            self._drawn.pop(name).node.remove()
        for name, thing in there.items():
            is_chosen = name == chosen
            drawn = self._drawn.get(name)
            if drawn is None:
                drawn = self._drawn[name] = self._draw(thing, is_chosen)
            elif drawn.chosen is not is_chosen:
                drawn.chosen = is_chosen
                _paint(drawn.node, *_look(thing, is_chosen))
            drawn.thing = thing
            pose = pose_of(thing)
            if isinstance(thing, Attached):
                pose = tools[holder_of(thing)] @ pose
            if pose is not drawn.pose:
                drawn.pose = pose
                drawn.node.wxyz, drawn.node.position = pose.quaternion_wxyz(), pose.p

    def _draw(self, thing: Thing, chosen: bool) -> _Drawn:
        path = f"{_ROOT}/{next(self._numbers)}"
        node = _node(self._stage, path, read_shape(thing.shape), *_look(thing, chosen))
        if self._on_pick is not None and not isinstance(node, viser.PointCloudHandle):
            self._on_pick(node, thing.name)  # a cloud cannot be clicked
        return _Drawn(thing=thing, chosen=chosen, pose=None, node=node)

    def _show_floor(self, floor_z: float | None) -> None:
        if self._floor is None:
            if floor_z is None:
                return
            self._floor = _floor(self._stage, f"{_ROOT}/floor")
        self._floor.visible = floor_z is not None
        if floor_z is not None:
            self._floor.position = (0.0, 0.0, floor_z)


def _still(drawn: _Drawn, there: dict[str, Thing]) -> bool:
    old, new = drawn.thing, there.get(drawn.thing.name)
    return new is not None and new.shape is old.shape and _kind(new) == _kind(old)


def _kind(thing: Thing) -> str:
    if isinstance(thing, Attached):
        return "held"
    return "zone" if thing.keep_out else "obstacle" if thing.mass is None else "item"


def _look(thing: Thing, chosen: bool) -> tuple[tuple[int, int, int], float | None]:
    """A thing's colour and opacity, None for a solid body; a zone stays red when selected."""
    if _kind(thing) == "zone":
        return _KEEP_OUT, _CHOSEN_AIR if chosen else _AIR
    if chosen:
        return _CHOSEN, None
    return {"held": _HELD, "item": _ITEM, "obstacle": _OBSTACLE}[_kind(thing)], None


def _paint(node: Any, color: tuple[int, int, int], opacity: float | None) -> None:
    if isinstance(node, viser.PointCloudHandle):
        node.colors = np.tile(np.array(color, dtype=np.uint8), (len(node.points), 1))
    else:
        node.color, node.opacity = color, opacity


def _node(
    stage: viser.SceneApi,
    path: str,
    shape: Shape,
    color: tuple[int, int, int],
    opacity: float | None,
) -> Any:
    if isinstance(shape, PointCloud):
        colors = np.tile(np.array(color, dtype=np.uint8), (len(shape.points), 1))
        return stage.add_point_cloud(path, shape.points, colors, point_size=shape.resolution)
    vertices, triangles = surface(shape)
    return stage.add_mesh_simple(
        path,
        vertices,
        triangles,
        color=color,
        opacity=opacity,
        flat_shading=not isinstance(shape, Sphere | Capsule),
        side="double" if isinstance(shape, Mesh) else "front",  # which way they face is open
        cast_shadow=opacity is None,
        receive_shadow=opacity is None,
    )


def surface(shape: Box | Sphere | Capsule | Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, shape (n, 3), [m], and triangles of a shape as it is drawn."""
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


def _floor(stage: viser.SceneApi, path: str) -> viser.GridHandle:
    floor = stage.add_grid(
        path,
        width=FLOOR_SIZE,
        height=FLOOR_SIZE,
        cell_size=0.05,
        section_size=0.25,
        cell_color=(160, 165, 170),  # between light and dark, so legible on both
        section_color=(134, 142, 150),
        cell_thickness=0.5,
        shadow_opacity=0.25,
    )
    ends = _AXES * np.eye(3)[:2]
    lines = np.stack([np.zeros((2, 3)), ends], axis=1)
    colors = np.repeat(_AXIS_COLORS[:, None], 2, axis=1)
    stage.add_line_segments(f"{path}/axes", lines, colors, thickness=1.5, thickness_units="screen")
    for name, end in zip(_AXIS_NAMES, ends, strict=True):
        stage.add_label(
            f"{path}/{name[0]}",
            name,
            position=1.05 * end + _ABOVE,
            anchor="center-center",
            depth_test=True,
        )
    return floor


def hit(scene: Scene, p_from: Array, along: Array) -> Array | None:
    """Where a ray first hits something of ``scene``, shape (3,), [m]; None if it does not."""
    along = along / np.linalg.norm(along)
    distances = [
        _distance(
            read_shape(obstacle.shape),
            obstacle.T_base_obstacle.inverse @ p_from,
            obstacle.T_base_obstacle.R.T @ along,
        )
        for obstacle in scene.obstacles
    ]
    if scene.floor_z is not None and along[2] < 0.0:
        distances.append((scene.floor_z - float(p_from[2])) / float(along[2]))
    met = [distance for distance in distances if distance is not None and distance > 0.0]
    if not met or min(met) > _FURTHEST:
        return None
    return np.asarray(p_from + min(met) * along)


def _distance(shape: Shape, p: Array, d: Array) -> float | None:
    """How far along a ray in a shape's own frame its surface is [m]."""
    if isinstance(shape, PointCloud):
        edge = shape.resolution
        cubes = np.unique(np.floor(shape.points / edge), axis=0)
        return _to_cubes((cubes + 0.5) * edge, 0.5 * edge, p, d)
    vertices, triangles = surface(shape)
    return _to_triangles(vertices[triangles], p, d)


def _to_cubes(middles: Array, half: float, p: Array, d: Array) -> float | None:
    """To the nearest of cubes of one size; ``middles`` has shape (n, 3)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(middles - half - p) / d, (middles + half - p) / d])
    enters, leaves = np.nanmax(ends.min(axis=0), axis=1), np.nanmin(ends.max(axis=0), axis=1)
    met = enters[(enters <= leaves) & (leaves > 0.0)]
    return float(met.min()) if len(met) else None


def _to_triangles(corners: Array, p: Array, d: Array) -> float | None:
    """To the nearest triangle that is met from either side; ``corners`` has shape (n, 3, 3).

    Source: Moeller and Trumbore, Fast, minimum storage ray/triangle intersection, 1997.
    """
    first, side, other = corners[:, 0], *(corners[:, k] - corners[:, 0] for k in (1, 2))
    across, from_first = np.cross(d, other), p - first
    turned = np.cross(from_first, side)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / np.einsum("ij,ij->i", side, across)
        u = scale * np.einsum("ij,ij->i", from_first, across)
        v = scale * (turned @ d)
        t = scale * np.einsum("ij,ij->i", other, turned)
        met = t[(np.minimum(u, v) >= -_EDGE) & (u + v <= 1.0 + _EDGE) & (t > 0.0)]
    return float(met.min()) if len(met) else None
