"""Find what a click in the picture hits: an obstacle or the floor."""

from __future__ import annotations

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.scene import PointCloud, Scene, Shape
from so101_motion.planning.collision.shape_files import read_shape

from .scene_view import surface

_FURTHEST = 3.0
"""Where the search along the ray ends [m]; chosen: the camera stands within two."""

_EDGE = 1e-9
"""How far beside a triangle it is met too, as a share of it: no ray slips between two of them."""


def hit(scene: Scene, p_from: Array, along: Array) -> Array | None:
    """Where a ray first hits something of ``scene``, shape (3,), [m]; None if it hits nothing.

    Args:
        scene: What is around the arm.
        p_from: Where the ray begins, shape (3,), [m].
        along: Its direction, shape (3,).
    """
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
