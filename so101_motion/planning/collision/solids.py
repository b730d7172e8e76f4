"""Find the inside of meshes and point clouds, so that they are as solid as a box.

A connected part of a mesh that covers its own convex hull is that hull. What another surface, or
the cubes of a cloud, enclose is found on a grid: whatever cannot be reached from outside through
empty cells of the grid. Gaps narrower than a cell are closed by that. A surface around the whole
foot of the arm is a room, and what encloses nothing is a surface only: how deep something is in it
is not known.

The depth of a body in a convex solid is the shortest way out, as for a box. In another solid it is
the distance of the body's deepest point from the surface, known to about half a cell. Where that
would not grow farther in, because the point is halfway through a wall, it is the shortest way out
along the axes and diagonals of its frame, which may be an eighth longer than the shortest.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import coal
import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.coal_shapes import convex_hull
from so101_motion.planning.collision.scene import Mesh
from so101_motion.planning.collision.shape_files import welded

FLAT = 2e-4  # a mesh no farther from its hull than this is the hull [m]; chosen: the error of scans
SAME_AREA = 0.01  # how far its area may differ from the hull's; a side is far more
FINEST = 0.004  # smallest cell of a grid around a mesh [m]; chosen
MOST_CELLS = 1_000_000  # most cells of a grid. Chosen: searched in 20 ms
RIB = 0.0125  # of filled solids [m]: no link fits between, the thinnest is 15 mm
SMALL = 2000  # triangles of a mesh whose parts are remembered; chosen, some 100 kB each
SHALLOW = 1e-4  # depth in the outer half of the outermost cells [m]; chosen
TOUCHING = 1e-6  # a convex solid that is no farther away than this is touched [m]: coal's tolerance
SAMPLE = 0.008  # distance of points whose depth is looked up [m]; chosen


class Depth(NamedTuple):
    """How deep a body is in a solid, in the solid's frame."""

    depth: float  # [m]
    p_body: Array  # the body's deepest point, shape (3,), [m]
    p_solid: Array  # the nearest point of the surface, shape (3,), [m]
    normal: Array  # from the body into the solid, shape (3,)


class Inside:
    """The inside of a surface: cells of a grid, but for walls of one or two of them.

    Args:
        low: The corner of the grid, shape (3,), [m].
        edge: Of the cells [m].
        full: Whether each cell is full, shape (i, j, k); none at the border.
        skin: How deep the middle of a cell at the border of the solid is [cells].
    """

    def __init__(self, low: Array, edge: float, full: Any, skin: float) -> None:
        from scipy import ndimage

        self.edge = edge
        self._low, self._skin = low, skin
        self._thick = ndimage.maximum_filter(ndimage.minimum_filter(full, 3), 3)

    def depth(self, body: Any, points: Callable[[], Array], R: Array, p: Array) -> Depth | None:
        """How deep a convex body, coal's, is in it; None if not at all, or not known.

        ``points`` returns what ``points_in`` finds; R and p [m] place the body in the solid's
        frame.
        """
        found = [each for hull in self._parts[0] if (each := _depth_in(hull, body, R, p))]
        if self._parts[1] is not None:
            at = points() @ R.T + p
            if (deep := self._way_out(self._parts[1], at)) is not None:
                found.append(deep)
        return max(found, default=None, key=lambda each: each.depth)

    def _way_out(self, field: Array, at: Array) -> Depth | None:
        """The way out of solids that are not convex, for a body's points (n, 3) [m].

        Towards the surface nearest to the deepest point, if that frees all of them. Else, as
        farther in this would not grow, the shortest of the axes and diagonals.
        """
        skin = self._skin * self.edge
        depths = self._look_up(field, at)
        k = int(np.argmax(depths))
        if depths[k] <= -0.999 * skin:
            return None
        steps = 0.5 * self.edge * np.eye(3)
        rise = self._look_up(field, at[k] + steps) - self._look_up(field, at[k] - steps)
        length, deepest = float(np.linalg.norm(rise)), max(float(depths[k]), 0.0)
        if length > 0.0:
            way = -rise / length
            beyond = self._look_up(field, at + (deepest + 0.5 * self.edge) * way)
            if beyond.max() <= 0.0:
                depth = max(deepest, SHALLOW * (1.0 + float(depths[k]) / skin))
                return Depth(depth, at[k], at[k] + depth * way, -way)
        at = at[depths > -0.999 * skin]
        cells = np.rint((at - self._low) / self.edge - 0.5).astype(int)
        cells = np.clip(cells, 0, np.array(field.shape) - 1)
        along = self._exits[:, *cells.T].max(axis=1) * _LENGTHS
        found = []
        for i in np.flatnonzero(along < along.min() + 1.0):
            exits = (self._look_up(self._exits[i], at) - self._skin) * self.edge * _LENGTHS[i]
            k = int(np.argmax(exits))
            depth, way = max(float(exits[k]), SHALLOW), _DIRECTIONS[i] / _LENGTHS[i]
            found.append(Depth(depth, at[k], at[k] + depth * way, -way))
        return min(found, key=lambda each: each.depth)

    @cached_property
    def _exits(self) -> Any:
        """Cells from each to the surface along each of ``_DIRECTIONS``, shape (26, i, j, k)."""
        field: Any = self._parts[1]
        full = field > field.flat[0]
        found = np.zeros((len(_DIRECTIONS), *full.shape), np.uint16)
        for exits, way in zip(found, _DIRECTIONS.astype(int), strict=True):
            axis = int(np.argmax(np.abs(way)))
            layers, solid = np.moveaxis(exits, axis, 0), np.moveaxis(full, axis, 0)
            for i in range(1, len(layers) - 1)[:: -way[axis]]:
                ahead = np.roll(layers[i + way[axis]], -np.delete(way, axis), axis=(0, 1))
                layers[i] = np.where(solid[i], ahead + 1, 0)
        return found

    def bounds(self, points: Array) -> Any:
        """Which points (n, 3) [m] are at the surface of a solid, not of a wall of two cells."""
        from scipy import ndimage

        at = np.floor((points - self._low) / self.edge).astype(int)
        return ndimage.maximum_filter(self._thick, 3)[tuple(at.T)]

    @property
    def is_convex(self) -> bool:
        """Whether the inside consists of convex solids."""
        return self._parts[1] is None

    @cached_property
    def _parts(self) -> tuple[list[Any], Array | None]:
        """The convex parts, coal's, and the depth of the middles of the others' cells [m]."""
        from scipy import ndimage

        thick = self._thick
        label, _ = ndimage.label(thick)
        hulls, others = [], np.zeros_like(thick)
        for i, box in enumerate(ndimage.find_objects(label), 1):
            part = np.pad(label[box] == i, 1)
            begin = np.array([each.start - 1 for each in box])
            hull = self._hull(part, begin) if self._skin == 0.5 else None
            if hull is not None:
                hulls.append(hull)
            else:
                others[box] |= part[1:-1, 1:-1, 1:-1]
        if not others.any():
            return hulls, None
        field = ndimage.distance_transform_edt(others)
        return hulls, np.asarray((field - self._skin) * self.edge, dtype=np.float32)

    def _hull(self, part: Any, begin: Array) -> Any:
        """The hull of cubes, coal's, if they fill it but for a cell; else None."""
        from scipy import ndimage
        from scipy.spatial import ConvexHull

        cells = np.argwhere(part & ~ndimage.binary_erosion(part))
        corners = (cells[:, None] + np.stack(np.unravel_index(range(8), (2, 2, 2)), 1)).reshape(
            -1, 3
        )
        found = ConvexHull(np.unique(corners, axis=0))
        empty = np.argwhere(~part) + 0.5
        planes = found.equations
        for at in range(0, len(empty), 4096):
            away = empty[at : at + 4096] @ planes[:, :3].T + planes[:, 3]
            if (away < -1.0).all(axis=1).any():
                return None
        points = found.points[found.vertices] + begin
        return convex_hull(self._low + self.edge * points)

    def _look_up(self, field: Array, points: Array) -> Array:
        """The depth of points (n, 3) [m], shape (n,), [m], between the middles of cells."""
        from scipy import ndimage

        at = ((points - self._low) / self.edge - 0.5).T
        return np.asarray(ndimage.map_coordinates(field, at, float, 1, cval=field.flat[0]))


class Part(NamedTuple):
    """A part of a mesh: a convex solid, or a surface."""

    mesh: Mesh  # its triangles; of a surface, with triangles in its inside that leave no link room
    hull: Array | None  # the points of its convex hull, shape (n, 3), [m]; None for a surface
    inside: Inside | None  # its inside; None for a hull, or if it is not known


def parts_of(mesh: Mesh, foot: Array) -> Iterator[Part]:
    """The convex parts of a mesh, then other solids as one, and surfaces as another.

    ``foot``: points of the arm's base and shoulder in the mesh's frame, shape (n, 3), [m].
    """
    rest = []
    split = _split_small if len(mesh.triangles) <= SMALL else _split
    vertices, connected = split(Keyed(mesh.fingerprint(), mesh))
    for triangles, hull in connected:
        if hull is None or (foot @ hull[1][:, :3].T + hull[1][:, 3] < 0.0).all():
            rest.append(triangles)
        else:
            points, _ = hull
            yield Part(_only(vertices, triangles), points, None)
    if rest:
        yield from _others(_only(vertices, np.concatenate(rest)), foot)


@dataclass(frozen=True, slots=True)
class Keyed:
    """An argument of a cached function, equal to any with the same key."""

    key: object
    value: Any = field(compare=False)


def _split(mesh: Keyed) -> tuple[Array, list[tuple[Any, tuple[Array, Array] | None]]]:
    """The vertices of a mesh, and the triangles of each connected part with its hull."""
    vertices, triangles = welded(mesh.value.vertices, mesh.value.triangles)
    return vertices, [(each, _as_hull(vertices, each)) for each in _connected(vertices, triangles)]


_split_small = lru_cache(maxsize=64)(_split)  # scenes of one planning differ in little


def _only(vertices: Array, triangles: Any) -> Mesh:
    used: Any
    numbers: Any
    used, numbers = np.unique(triangles, return_inverse=True)
    return Mesh(vertices=vertices[used], triangles=numbers.reshape(triangles.shape))


def _connected(vertices: Array, triangles: Any) -> list[Any]:
    """The triangles of each connected part."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    a, b, c = triangles.T
    number = len(vertices)
    edges = (np.concatenate([a, b]), np.concatenate([b, c]))
    count, part = connected_components(
        coo_array((np.ones(2 * len(a), dtype=bool), edges), shape=(number, number))
    )
    order = np.argsort(part[a], kind="stable")
    ends = np.cumsum(np.bincount(part[a], minlength=count))
    return [each for each in np.split(triangles[order], ends[:-1]) if len(each)]


def _as_hull(vertices: Array, triangles: Any) -> tuple[Array, Array] | None:
    """The corners and planes of the hull that triangles cover; None if they do not."""
    from scipy.spatial import ConvexHull, QhullError

    corners = vertices[triangles]
    try:
        hull = ConvexHull(vertices[np.unique(triangles)])
    except (QhullError, ValueError):
        return None  # flat
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    if abs(float(area.sum()) - hull.area) > SAME_AREA * hull.area:
        return None
    used = np.unique(triangles)
    facets = {tuple(each) for each in np.sort(used[hull.simplices], axis=1).tolist()}
    others = [tuple(each) not in facets for each in np.sort(triangles, axis=1).tolist()]
    middles = corners.mean(axis=1)[np.array(others) & (area > 0.0)]
    planes = np.unique(hull.equations.round(9), axis=0)
    for begin in range(0, len(middles), _AT_ONCE):
        away = middles[begin : begin + _AT_ONCE] @ planes[:, :3].T + planes[:, 3]
        if away.max(axis=1).min() < -FLAT:
            return None
    return hull.points[hull.vertices], hull.equations


_AT_ONCE = 1024


def _others(mesh: Mesh, foot: Array) -> Iterator[Part]:
    """A mesh with what it encloses, without the surfaces that bound no solid, and these."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    edge = max(FINEST, math.cbrt(float(np.prod(high - low + FINEST)) / MOST_CELLS))
    points, triangle = _sampled(mesh, 0.5 * edge)
    inside, hollow = enclosed(points, edge, foot, skin=1.0)
    of_solid = np.bincount(triangle, inside.bounds(points), len(mesh.triangles)) > 0.0
    if of_solid.any():
        solid = _only(mesh.vertices, mesh.triangles[of_solid])
        yield Part(_ribbed(solid, hollow, 0.45 * edge), None, inside)
    if not of_solid.all():
        yield Part(_only(mesh.vertices, mesh.triangles[~of_solid]), None, None)


def filled(mesh: Mesh, hull: Array) -> Mesh:
    """A convex mesh with triangles in its inside; ``hull``: the corners, shape (n, 3), [m]."""
    towards = np.random.default_rng(0).standard_normal((64, 3))
    corners = hull[np.unique(np.argmax(hull @ towards.T, axis=0))]
    return _ribbed(mesh, points_in(convex_hull(corners)), 1e-6)


def _ribbed(mesh: Mesh, middles: Array, size: float) -> Mesh:
    """A mesh with a triangle of a size [m] around each point (n, 3) [m]."""
    ribs = middles[:, None] + size * np.array([[1.0, 1, 1], [-1, -1, 1], [-1, 1, -1]])
    number = len(mesh.vertices) + np.arange(3 * len(middles)).reshape(-1, 3)
    return Mesh(
        vertices=np.concatenate([mesh.vertices, ribs.reshape(-1, 3)]),
        triangles=np.concatenate([mesh.triangles, number]),
    )


def _sampled(mesh: Mesh, spacing: float) -> tuple[Array, Any]:
    """Points on the triangles, at most ``spacing`` [m] apart, (n, 3) [m]; each one's triangle."""
    corners = mesh.vertices[mesh.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    steps = np.ceil(longest / spacing).astype(int).clip(1)
    found, triangle = [], []
    for n in np.unique(steps):
        u, v = np.divmod(np.arange((n + 1) ** 2), n + 1)
        shares = np.column_stack([u, v, n - u - v])[u + v <= n] / n
        found.append(np.einsum("ij,kjc->kic", shares, corners[steps == n]).reshape(-1, 3))
        triangle.append(np.repeat(np.flatnonzero(steps == n), len(shares)))
    return np.concatenate(found), np.concatenate(triangle)


def enclosed(points: Array, edge: float, foot: Array, skin: float = 0.5) -> tuple[Inside, Array]:
    """The inside of what points (n, 3) show, and the middles of enclosed cells that fill it.

    The cells have an ``edge`` [m]; several are taken together if there are too many. ``foot`` as
    for ``parts_of``; what is around all of it is a room. The middles (m, 3) [m] are as far apart as
    no link fits between.
    """
    from scipy import ndimage

    first, last = (np.floor(each / edge) for each in (points.min(axis=0), points.max(axis=0)))
    together = max(1, math.ceil(math.cbrt(float(np.prod(last - first + 3.0)) / MOST_CELLS)))
    edge *= together
    cells = np.floor(points / edge).astype(np.int64)
    corner = cells.min(axis=0) - 1
    full = np.zeros(cells.max(axis=0) - corner + 2, dtype=bool)
    full[tuple((cells - corner).T)] = True
    label, _ = ndimage.label(~full)
    hollow = (label != label[0, 0, 0]) & ~full
    own = np.floor(foot / edge).astype(np.int64) - corner
    if (own >= 0).all() and (own < full.shape).all():
        around = np.unique(label[tuple(own.T)])
        if len(around) == 1 and around[0]:
            hollow &= label != around[0]
    low = corner * edge
    inside = Inside(low, edge, full | hollow, skin)
    every = max(1, int(RIB / edge))
    at = np.argwhere(hollow)
    at = at[(at % every == 0).all(axis=1)]
    return inside, low + edge * (at + 0.5)


def points_in(body: Any) -> Array:
    """Points all over a convex body, coal's, its corners among them, shape (n, 3), [m]."""
    from scipy.spatial import ConvexHull

    if isinstance(body, coal.ConvexBase):
        corners = np.array(body.points())
    elif isinstance(body, coal.Box):
        corners = _DIRECTIONS[np.abs(_DIRECTIONS).min(axis=1) > 0.0] * np.array(body.halfSide)
    else:  # a sphere or a capsule
        round_ = body.radius * _DIRECTIONS / _LENGTHS[:, None]
        end = np.array([0.0, 0.0, getattr(body, "halfLength", 0.0)])
        corners = np.concatenate([round_ + end, round_ - end])
    low, high = corners.min(axis=0), corners.max(axis=0)
    counts = np.ceil((high - low) / SAMPLE).astype(int).clip(1, 40)
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    planes = ConvexHull(corners).equations
    inside = (lattice @ planes[:, :3].T + planes[:, 3] <= 0.0).all(axis=1)
    return np.concatenate([corners, lattice[inside]])


_DIRECTIONS = np.array(
    [each for each in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(each)]
)
_LENGTHS = np.linalg.norm(_DIRECTIONS, axis=1)


def _depth_in(hull: Any, body: Any, R: Array, p: Array) -> Depth | None:
    """How deep a convex body placed by R and p [m] is in a hull, both coal's."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    coal.distance(body, coal.Transform3s(R, p), hull, coal.Transform3s(), request, result)
    if result.min_distance > TOUCHING:
        return None
    first, second = (np.array(e()) for e in (result.getNearestPoint1, result.getNearestPoint2))
    depth = max(-float(result.min_distance), 1e-12)  # 0 would be: not known
    return Depth(depth, first, second, np.array(result.normal))
