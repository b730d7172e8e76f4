"""Pack the bodies of a scene into arrays for the compiled library.

Bodies are convex: the points of a hull and a radius by which it is widened. The mesh of an obstacle
becomes its triangles, a cloud its cubes; all of them are leaves of one tree (``native/scene.c``).
"""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
from numpy.typing import NDArray

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.bodies import Bodies, Body, Cubes, Hull, Standing
from so101_motion.planning.collision.scene import FLOOR, LINKS, Box, Capsule, Mesh, Sphere

_CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))


def packed(model: Any, bodies: Bodies, floor_z: float) -> tuple[list[Any], dict[int, int]]:
    """The arguments of ``so101_new`` in its order, and our pair for each pair of the library."""
    objects = bodies.bodies
    names = [each.name for each in objects]
    movers = [
        i for i, each in enumerate(objects) if i not in bodies.standing and each.name != FLOOR
    ]
    place = {i: k for k, i in enumerate(movers)}
    hulls = [_hull(objects[i]) for i in movers]
    pairs, with_floor = [], 0
    masks = dict.fromkeys(bodies.standing, 0)
    rows = {i: k * len(movers) for k, i in enumerate(bodies.standing, 1)}
    own, others = list[int](), dict[int, int]()
    for k, (a, b) in enumerate(bodies.indices.tolist()):
        if names[b] == FLOOR:
            with_floor |= 1 << place[a]
            others[place[a]] = k
        elif b in masks:
            masks[b] |= 1 << place[a]
            others[rows[b] + place[a]] = k
        else:
            is_own = names[a] in LINKS and names[b] in LINKS
            pairs.append((place[a], place[b], 0 if is_own else 1))
            own.append(k)
    pair_of = dict(enumerate(own)) | {len(own) + number: k for number, k in others.items()}
    shapes: list[tuple[Array, float]] = []
    at, shape, mask = [np.zeros((0, 3))], [np.zeros(0, int)], [np.zeros(0, int)]
    obstacle = [np.zeros(0, int)]
    for o, (i, standing) in enumerate(bodies.standing.items()):
        T = objects[i].placement
        forms, places = _pieces(standing, np.array(T.rotation), np.array(T.translation))
        at.append(places)
        shape.append(len(shapes) + np.arange(len(places)) % len(forms))
        mask.append(np.full(len(places), masks[i]))
        obstacle.append(np.full(len(places), o))
        shapes += forms
    arguments = [
        _offsets(model),
        len(movers),
        np.array([objects[i].joint for i in movers], np.int32),
        _starts([points for points, _ in hulls]),
        np.concatenate([points for points, _ in hulls]),
        np.array([radius for _, radius in hulls]),
        len(pairs),
        np.array(pairs, np.int32).reshape(-1, 3),
        ctypes.c_uint32(with_floor),
        floor_z,
        len(shapes),
        _starts([points for points, _ in shapes]),
        np.concatenate([np.zeros((0, 3)), *(points for points, _ in shapes)]),
        np.array([radius for _, radius in shapes]),
        sum(map(len, at)),
        np.concatenate(at),
        np.concatenate(shape).astype(np.int32),
        np.concatenate(mask).astype(np.uint32),
        np.concatenate(obstacle).astype(np.int32),
        len(masks),
    ]
    return arguments, pair_of


def _offsets(model: Any) -> Array:
    """Pose of each joint in the one before: rotation by rows, then translation, shape (6, 12)."""
    placements = [model.jointPlacements[joint] for joint in range(1, 7)]
    rows = [np.concatenate((np.array(T.rotation).ravel(), T.translation)) for T in placements]
    return np.ascontiguousarray(rows)


def _starts(points: Sequence[Array]) -> NDArray[np.int32]:
    return np.cumsum([0, *(len(each) for each in points)]).astype(np.int32)


def _points_of(shape: Any) -> tuple[Array, float]:
    """The points of a convex shape of coal's and the radius around them."""
    radius = float(shape.getSweptSphereRadius())
    if isinstance(shape, coal.Box):
        return 2.0 * _CORNERS * np.array(shape.halfSide), radius
    if isinstance(shape, coal.Sphere):
        return np.zeros((1, 3)), radius + float(shape.radius)
    if isinstance(shape, coal.Capsule):
        ends = np.outer((-1.0, 1.0), (0.0, 0.0, shape.halfLength))
        return ends, radius + float(shape.radius)
    return np.array(shape.points()), radius


def _hull(body: Body) -> tuple[Array, float]:
    """The points of a body in its joint's frame, shape (n, 3), and the radius around them [m]."""
    points, radius = _points_of(body.shape)
    T = body.placement
    return np.ascontiguousarray(points @ np.array(T.rotation).T + np.array(T.translation)), radius


def _pieces(standing: Standing, R: Array, p: Array) -> tuple[list[tuple[Array, float]], Array]:
    """The convex pieces of an obstacle, rotated, and their places, shape (n, 3), [m].

    There is one piece for all places, or one for each.
    """
    if isinstance(standing, Cubes):
        return [(standing.edge * _CORNERS @ R.T, 0.0)], standing.middles @ R.T + p
    if isinstance(standing, Mesh):
        corners = standing.vertices[standing.triangles] @ R.T
        middles = corners.mean(axis=1)
        return [(each, 0.0) for each in corners - middles[:, None]], middles + p
    if isinstance(standing, Hull):
        middle = standing.points.mean(axis=0)
        return [((standing.points - middle) @ R.T, standing.radius)], (R @ middle + p)[None]
    return [_rounded_form(standing, R)], p[None]


def _rounded_form(standing: Box | Sphere | Capsule, R: Array) -> tuple[Array, float]:
    if isinstance(standing, Box):
        return _CORNERS * standing.size @ R.T, 0.0
    if isinstance(standing, Sphere):
        return np.zeros((1, 3)), standing.radius
    ends = np.outer((-1.0, 1.0), R[:, 2]) * (0.5 * standing.length - standing.radius)
    return ends, standing.radius
