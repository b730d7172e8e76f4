"""Convert the shapes of a scene to coal's: one form for obstacles, one for held objects.

coal has boxes, spheres, capsules and octrees itself. The mesh of an obstacle becomes a tree of
bounding volumes over its triangles, exact and searched in microseconds. Two such trees are slow to
check against each other, so held objects are convex.
"""

from __future__ import annotations

import itertools
from functools import cache, lru_cache
from typing import Any

import coal
import numpy as np

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.checkpoint import Checkpoint, never_abandoned
from so101_motion.planning.collision.scene import Box, Capsule, Mesh, PointCloud, Shape, Sphere

_CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))  # corners of a cube of edge 1
_THICKNESS = 5e-4  # flat held objects are made so thick [m], because a hull needs a volume. Chosen
_THINNEST = 1e-6  # plates and points are made so thick for coal [m]


def standing_shape(shape: Box | Sphere | Capsule | Mesh) -> Any:
    """The shape of an obstacle, in the obstacle's own frame; see ``octree`` for clouds."""
    return _triangles(shape) if isinstance(shape, Mesh) else _simple(shape)


def octree(points: Array, resolution: float) -> Any:
    """The cubes of an edge ``resolution`` [m] around points, shape (n, 3), n >= 1, [m]."""
    return coal.makeOctree(np.array(points), resolution)


def full_cubes(cloud: PointCloud, checkpoint: Checkpoint = never_abandoned) -> Array:
    """The middles of the cubes that hold a point, each once, shape (n, 3), [m].

    A camera sees thousands of points in each cube. coal takes a second for a million of them, and
    nothing can interrupt it; this takes a tenth of that, a few milliseconds at a time.
    """
    found, merged, waiting = [np.zeros(0, dtype=np.int64)], 0, 0
    for begin in range(0, len(cloud.points), _AT_ONCE):
        checkpoint()
        points = cloud.points[begin : begin + _AT_ONCE]
        found.append(np.unique(cube_numbers(points, cloud.resolution)))
        waiting += len(found[-1])
        if waiting > merged + 4 * _AT_ONCE:
            checkpoint()
            found = [np.unique(np.concatenate(found))]
            merged, waiting = len(found[0]), 0
    checkpoint()
    return cube_middles(np.unique(np.concatenate(found)), cloud.resolution)


_AT_ONCE = 16_384  # number of points handled between two checkpoints. Chosen: 3 ms


def held_shape(shape: Shape) -> tuple[Any, Array]:
    """The shape of a held object, and points whose hull contains it, shape (n, 3), [m].

    A hull with more corners than ``MOST_CORNERS`` is replaced by that of some of them, widened
    until it contains all: by 0.3 mm for a ball of 60 mm.
    """
    if not isinstance(shape, Mesh | PointCloud):
        return _simple(shape), _CORNERS * _extent(shape)
    hull = convex_hull(shape.vertices if isinstance(shape, Mesh) else _full_corners(shape))
    points = np.array(hull.points())
    if len(points) <= MOST_CORNERS:
        return hull, points
    kept = points[np.unique(np.argmax(points @ directions().T, axis=0))]
    hull = convex_hull(kept)
    radius = max(distance_outside(point, hull) for point in points)
    hull.setSweptSphereRadius(radius)
    return hull, (kept[:, None] + 2.0 * radius * _CORNERS).reshape(-1, 3)


MOST_CORNERS = 512  # most corners of a body that moves; as in ``native.h``


def hull_points(shape: Shape, count: int = MOST_CORNERS) -> Array:
    """Points whose hull is that of a shape, shape (n, 3), [m]; ``count`` of them if it is round."""
    if not isinstance(shape, Sphere | Capsule):
        return held_shape(shape)[1]
    ball = directions(count)
    half = 0.5 * shape.length - shape.radius if isinstance(shape, Capsule) else 0.0
    return shape.radius * ball + np.outer(np.sign(ball[:, 2]), (0.0, 0.0, half))


@cache
def directions(count: int = MOST_CORNERS) -> Array:
    """Unit vectors all around, shape (count, 3), on a spiral."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - z * z)
    return np.column_stack((flat * np.cos(turn), flat * np.sin(turn), z))


def distance_outside(point: Array, hull: Any) -> float:
    """How far a point, shape (3,), is outside one of coal's shapes, in its frame, [m]."""
    at, result = coal.Transform3s(np.eye(3), point), coal.DistanceResult()
    coal.distance(coal.Sphere(0.0), at, hull, coal.Transform3s(), coal.DistanceRequest(), result)
    return max(0.0, float(result.min_distance))


def placed(T: SE3) -> Any:
    """A pose in coal's form."""
    return coal.Transform3s(np.array(T.R), np.array(T.p))


def convex_hull(points: Array) -> Any:
    """The convex hull of points, shape (n, 3), [m]; flat points get a thin hull."""
    _, axes = np.linalg.eigh(np.cov(points.T, bias=True))
    if np.ptp(points @ axes[:, 0]) < _THICKNESS:
        # Without a volume, coal 3.0.3 ends the process (observed).
        points = (points[:, None] + _THICKNESS * _CORNERS).reshape(-1, 3)
    listed = coal.StdVec_Vec3s()
    for point in points:
        listed.append(point)
    # With "Qt", coal 3.0.3 refuses a cylinder of 256 sides: too many neighbours of a corner.
    return coal.ConvexBase.convexHull(listed, False, "")


@lru_cache(maxsize=256)
def kept_hull(points: bytes) -> Any:
    """``convex_hull`` of points (n, 3) [m] by their bytes; remembered, do not change it."""
    return convex_hull(np.frombuffer(points).reshape(-1, 3))


def _simple(shape: Box | Sphere | Capsule) -> Any:
    if isinstance(shape, Box):
        return coal.Box(*np.maximum(shape.size, _THINNEST).tolist())
    if isinstance(shape, Sphere):
        return coal.Sphere(max(shape.radius, _THINNEST))
    return coal.Capsule(shape.radius, shape.length - 2.0 * shape.radius)


def _extent(shape: Box | Sphere | Capsule) -> Array:
    """Size along the axes, shape (3,), [m]."""
    if isinstance(shape, Box):
        return shape.size
    length = shape.length if isinstance(shape, Capsule) else 2.0 * shape.radius
    return np.array([2.0 * shape.radius, 2.0 * shape.radius, length])


def _triangles(mesh: Mesh) -> Any:
    tree, vertices = coal.BVHModelOBBRSS(), mesh.vertices
    if np.ptp(vertices, axis=0).min() < _THINNEST:
        # A broad phase of Pinocchio 4.1.0 never meets a box without a volume (observed).
        vertices = np.concatenate([vertices, vertices.min(axis=0)[None] - _THINNEST])
    tree.beginModel(len(mesh.triangles), len(vertices))
    tree.addVertices(np.array(vertices))
    tree.addTriangles(np.array(mesh.triangles))
    tree.endModel()
    return tree


def _full_corners(cloud: PointCloud) -> Array:
    """Corners of the cubes that hold a point, shape (n, 3), [m]."""
    return np.asarray((full_cubes(cloud)[:, None] + cloud.resolution * _CORNERS).reshape(-1, 3))


_MIDDLE = 32_768  # cubes are counted from here; see ``scene.CUBES``
PLACES = np.array([(2 * _MIDDLE) ** 2, 2 * _MIDDLE, 1])  # steps along x, y, z


def cube_numbers(points: Array, edge: float) -> Any:
    """The number of the cube of ``edge`` [m] that holds each point (n, 3) [m], shape (n,)."""
    return (np.floor(points / edge).astype(np.int64) + _MIDDLE) @ PLACES


def cube_middles(numbers: Any, edge: float) -> Array:
    """The middles of cubes of ``edge`` [m] by their numbers (n,), shape (n, 3), [m]."""
    return np.asarray((numbers[:, None] // PLACES % (2 * _MIDDLE) - _MIDDLE + 0.5) * edge)
