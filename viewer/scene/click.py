"""Find what a click in the picture hits: an obstacle or the floor."""

from __future__ import annotations

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.scene import Box, Capsule, Scene, Sphere

_STEP, _FURTHEST = 0.002, 3.0
"""Step along the ray in the search for a capsule, and where the search ends [m]; chosen: the arm
reaches half a metre, the camera stands within two."""


def hit(scene: Scene, p_from: Array, along: Array) -> Array | None:
    """Where a ray first hits something of ``scene``, shape (3,), [m]; None if it hits nothing.

    Meshes and point clouds are passed through.

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
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.stack([(-0.5 * shape.size - p) / d, (0.5 * shape.size - p) / d])
        enters, leaves = np.nanmax(ends.min(axis=0)), np.nanmin(ends.max(axis=0))
        return float(enters) if enters <= leaves else None
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
