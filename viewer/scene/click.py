"""Find what a click in the picture hits: an obstacle or the floor."""

from __future__ import annotations

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.scene import Box, Capsule, Mesh, PointCloud, Scene, Sphere

_STEP, _FURTHEST = 0.002, 3.0
"""Step along the ray in the search for a capsule, and where the search ends [m]; chosen: the arm
reaches half a metre, the camera stands within two."""


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
            obstacle.shape,
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


def _distance(shape: object, p: Array, d: Array) -> float | None:
    """How far along a ray in a shape's own frame its surface is [m]."""
    if isinstance(shape, Box):
        return _to_boxes(np.zeros((1, 3)), 0.5 * shape.size, p, d)
    if isinstance(shape, PointCloud):
        edge = shape.resolution
        cubes = np.unique(np.floor(shape.points / edge), axis=0)
        return _to_boxes((cubes + 0.5) * edge, np.full(3, 0.5 * edge), p, d)
    if isinstance(shape, Mesh):
        return _to_triangles(shape.vertices[shape.triangles], p, d)
    if isinstance(shape, Sphere):
        half, c = float(p @ d), float(p @ p) - shape.radius**2
        inside = half**2 - c
        return None if inside < 0.0 else -half - float(np.sqrt(inside))
    if isinstance(shape, Capsule):
        t = np.arange(0.0, _FURTHEST, _STEP)
        points = p + t[:, None] * d
        reach = 0.5 * shape.length - shape.radius
        points[:, 2] -= np.clip(points[:, 2], -reach, reach)
        near = np.flatnonzero(np.linalg.norm(points, axis=1) <= shape.radius)
        return float(t[near[0]]) if len(near) else None
    return None


def _to_boxes(middles: Array, half: Array, p: Array, d: Array) -> float | None:
    """To the nearest of boxes of one size; ``middles`` has shape (n, 3)."""
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
    met = t[(u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0)]
    return float(met.min()) if len(met) else None
