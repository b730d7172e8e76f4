"""Random things on a table, one to be picked and put to a free place; each problem by its seed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from so101_motion.common.geometry import SE3, Array, rotation_by
from so101_motion.planning.collision.scene import (
    FLOOR_Z,
    Box,
    Cylinder,
    Mesh,
    Obstacle,
    Scene,
    Shape,
)
from so101_motion.planning.picking.grasps import item_hull
from so101_motion.planning.picking.pick_plan import Place

KINDS = ("cube", "cylinder", "mesh")
OTHERS = 8
NEAREST, FARTHEST, ASIDE = 0.13, 0.29, math.radians(70.0)
APART = 0.06
"""Least distance of two places [m]; things touch each other at most at their corners."""

START = np.radians([0.0, -80.0, 60.0, 70.0, 0.0])
"""The gripper is 168 mm above the table there, clear of everything that lies on it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """One of the items, ``"item"``, is to be brought to a place."""

    kind: str
    size_mm: tuple[float, ...]
    scene: Scene
    place: Place


def problem(seed: int) -> Problem:
    """The problem of a seed; its item is of the kind ``KINDS[seed % 3]``."""
    random = np.random.default_rng(seed)
    places = list[Array]()
    while len(places) < OTHERS + 2:
        far, azimuth = random.uniform(NEAREST, FARTHEST), random.uniform(-ASIDE, ASIDE)
        p = far * np.array([math.cos(azimuth), math.sin(azimuth)])
        if all(np.linalg.norm(p - other) >= APART for other in places):
            places.append(p)
    kinds = [KINDS[seed % 3], *random.choice(KINDS, OTHERS)]
    shapes = [_shape(random, kind) for kind in kinds]
    things = tuple(
        _lying(random, shape, p, f"thing {k}" if k else "item")
        for k, (shape, p) in enumerate(zip(shapes, places[1:], strict=True))
    )
    size = np.ptp(item_hull(shapes[0]).points, axis=0)
    return Problem(
        kind=kinds[0],
        size_mm=tuple(np.round(1e3 * size, 1).tolist()),
        scene=Scene(obstacles=things),
        place=Place(p=np.array([*places[0], 0.0])),
    )


def _shape(random: np.random.Generator, kind: str) -> Shape:
    size = random.uniform(0.01, 0.05)
    if kind == "cube":
        return Box(size=np.full(3, size))
    if kind == "cylinder":
        return Cylinder(radius=0.5 * size, length=random.uniform(0.01, 0.05))
    from scipy.spatial import ConvexHull

    points = random.normal(size=(14, 3))
    points *= (
        0.5
        * size
        * random.uniform(0.7, 1.0, (14, 1))
        / np.linalg.norm(points, axis=1, keepdims=True)
    )
    hull = ConvexHull(points)
    # It lies on its largest face, with its origin in the middle.
    corners = hull.points[hull.simplices]
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    normal = hull.equations[int(areas.argmax()), :3]
    axis = np.cross(normal, (0.0, 0.0, -1.0))
    length = float(np.linalg.norm(axis))
    angle = math.atan2(length, -normal[2])
    R = rotation_by(axis * (angle / length)) if length > 1e-9 else np.eye(3)
    vertices = hull.points[hull.vertices] @ R.T
    number = {int(old): new for new, old in enumerate(hull.vertices)}
    triangles = [[number[int(each)] for each in row] for row in hull.simplices]
    return Mesh(vertices=vertices, triangles=np.array(triangles))


def _lying(random: np.random.Generator, shape: Shape, p: Array, name: str) -> Obstacle:
    turn = random.uniform(-math.pi, math.pi)
    z = FLOOR_Z - float(item_hull(shape).points[:, 2].min())
    T = SE3.from_rpy((0.0, 0.0, turn), (*p, z))
    return Obstacle(name=name, shape=shape, T_base_obstacle=T, mass=0.03)
