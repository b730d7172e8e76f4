"""Turn points that a camera saw into cubes, without the arm itself and the floor.

A camera that looks at the arm sees the arm, and a plan with the arm as an obstacle would begin in
contact. So points inside or near the hull of a link are removed, as are those of held objects. Near
is as far as noise, the edge of a cube and the planner's margin require. Single points in the air
are noise. Points hardly above the floor belong to the floor, whose height is known.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import so101_description
from numpy.typing import NDArray

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.coal_shapes import (
    PLACES,
    cube_middles,
    cube_numbers,
    held_shape,
)
from so101_motion.planning.collision.scene import MARGIN, Attached
from so101_motion.planning.collision.shape_files import read_shape

Mask = NDArray[np.bool_]

EDGE = 0.01  # of the cubes [m]; chosen, the precision of depth cameras
THIN = EDGE / 4.0  # smaller cubes with one point each [m]; chosen, a camera's noise

OWN = EDGE * 3.0**0.5 + MARGIN + 1e-3
"""Points nearer to the arm than this belong to it [m], so that every cube keeps the margin."""

LOW = 0.01  # points no higher above the floor belong to it [m]; chosen: noise of a depth camera
FEWEST = 3  # fewer points in a cube and the 26 around it are noise; chosen: surfaces show dozens
REACH = 0.7  # reach of the arm from its base's origin, rounded up, without held objects [m]


class _Hull(NamedTuple):
    """A convex body: p is inside where ``normals @ p <= offsets``, in its own frame."""

    normals: Array
    offsets: Array
    middle: Array
    radius: float


def seen_cubes(
    points: Array,
    *,
    T_base_links: Mapping[str, SE3],
    T_base_tool: SE3,
    held: Iterable[Attached] = (),
    floor_z: float | None = None,
) -> Array:
    """The middles of the cubes of edge ``EDGE`` that hold obstacles, shape (n, 3), [m].

    ``points`` (m, 3) [m] were seen while the links, by their URDF names, and the tool were there;
    ``floor_z`` is None for no floor.
    """
    carried = _carried(held, T_base_tool)
    far = max(
        (float(np.linalg.norm(T.p - T_base_tool.p)) + h.radius for T, h in carried), default=0
    )
    points = points[np.einsum("ij,ij->i", points, points) < (REACH + far) ** 2]  # not for NaN
    if floor_z is not None:
        points = points[points[:, 2] > floor_z + LOW]
    points = _thinned(points)
    own = of_the_arm(points, T_base_links=T_base_links, T_base_tool=T_base_tool, held=held)
    keys, counts = np.unique(cube_numbers(points[~own], EDGE), return_counts=True)
    keys = keys[_in_company(keys, counts)]
    return cube_middles(keys, EDGE)


def of_the_arm(
    points: Array,
    *,
    T_base_links: Mapping[str, SE3],
    T_base_tool: SE3,
    held: Iterable[Attached] = (),
) -> Mask:
    """Whether each point belongs to the arm or to an object it holds, shape (m,).

    Arguments and units as for ``seen_cubes``.
    """
    own = np.zeros(len(points), dtype=bool)
    links = [(T, _link_hulls()[link]) for link, T in T_base_links.items()]
    for T, hull in (*links, *_carried(held, T_base_tool)):
        own |= _is_in(points, T, hull)
    return own


def _carried(held: Iterable[Attached], T_base_tool: SE3) -> list[tuple[SE3, _Hull]]:
    return [(T_base_tool @ each.T_tool_object, _box_around(each)) for each in held]


def _is_in(points: Array, T: SE3, hull: _Hull) -> Mask:
    """Whether points are in a body or nearer to it than ``OWN``, shape (n,)."""
    away = points - T @ hull.middle
    inside = np.einsum("ij,ij->i", away, away) < (hull.radius + OWN) ** 2
    local = (points[inside] - T.p) @ T.R
    inside[inside] = (local @ hull.normals.T <= hull.offsets + OWN).all(axis=1)
    return np.asarray(inside)


def _thinned(points: Array) -> Array:
    """One point of each small cube, because cameras see a surface many times over."""
    _, first = np.unique(cube_numbers(points, THIN), return_index=True)
    return points[first]


def _in_company(keys: Any, counts: Any) -> Mask:
    """Whether each cube and those around it hold enough points, shape (n,); ``keys`` sorted."""
    around = np.zeros(len(keys), dtype=np.int64)
    for step in itertools.product((-1, 0, 1), repeat=3):
        wanted = keys + np.array(step) @ PLACES
        at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        around += np.where(keys[at] == wanted, counts[at], 0) if len(keys) else 0
    return np.asarray(around >= FEWEST)


@cache
def _link_hulls() -> dict[str, _Hull]:
    from scipy.spatial import ConvexHull

    hulls = {}
    for link, part in so101_description.PARTS.items():
        vertices = np.asarray(so101_description.load_hull(part).vertices, dtype=np.float64)
        planes = ConvexHull(vertices).equations
        hulls[link] = _hull(planes[:, :3], -planes[:, 3], vertices)
    return hulls


def _box_around(held: Attached) -> _Hull:
    _, points = held_shape(read_shape(held.shape))
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    return _hull(normals, (points @ normals.T).max(axis=0), points)


def _hull(normals: Array, offsets: Array, points: Array) -> _Hull:
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    radius = float(np.linalg.norm(points - middle, axis=1).max())
    return _Hull(normals, offsets, middle, radius)
