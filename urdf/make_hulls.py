"""Fit the collision hulls to the official meshes: ``python -m urdf.make_hulls FOLDER``.

``FOLDER`` is ``Simulation/SO101`` of a checkout of TheRobotStudio/SO-ARM100 (Apache-2.0); nothing
of it is copied into this project. For each link the script keeps some dozen corners of a convex
hull that contains all its official parts, servos included, and stands out of *their* hull by as
little as so many corners allow: half a millimetre. The official hulls have up to 4,000 corners,
most of them on rounded edges; so the corners here are in places where the official parts have none.

How. Begin with corners of the official hull, each time the one furthest outside of what those
before span. Then move all of them together by small steps, a linear program each: every facet has
to reach the official point that stands out of it most, and no corner may stand out of the official
planes by more than is necessary. If the hull still misses a point at the end, it is enlarged about
its middle by a few micrometres. Coordinates are whole micrometres.

What is drawn is cut to these hulls: run ``make_meshes`` and ``make_allowed_pairs`` afterwards.
"""

import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Final

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import csr_matrix
from scipy.spatial import ConvexHull

from . import MESH_DIR, PARTS, TriangleMesh

Points = NDArray[np.float64]

CORNERS: Final = {
    "base": 52,
    "shoulder": 60,
    "upper_arm": 60,
    "lower_arm": 60,
    "wrist": 60,
    "gripper": 60,
    "jaw": 44,
}
"""How many corners a hull may have. Chosen: with these each stands out by half a millimetre."""

_STEPS: Final = 0.8 ** np.arange(18)
"""How far a corner may move in each round, as a share of the gap at the beginning. Chosen."""

_LACK_COUNTS: Final = 3.0
"""Weight of a micrometre that is missing against one that stands out. Chosen."""

_STL: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def official_triangles(folder: Path) -> dict[str, Points]:
    """Read the triangles of every link's official parts.

    Args:
        folder: With ``so101_new_calib.urdf`` and its meshes, binary STL.

    Returns:
        By the link's name, in the link's frame, shape (n, 3, 3), [m].
    """
    found = {}
    for link in ET.parse(folder / "so101_new_calib.urdf").getroot().findall("link"):
        triangles = []
        for visual in link.findall("visual"):
            origin, mesh = visual.find("origin"), visual.find("geometry/mesh")
            assert origin is not None
            assert mesh is not None
            xyz, rpy = (np.array(origin.attrib[k].split(), float) for k in ("xyz", "rpy"))
            corners = stl_triangles(folder / mesh.attrib["filename"])
            triangles.append(corners @ pin.rpy.rpyToMatrix(*rpy).T + xyz)
        if triangles:
            found[link.attrib["name"]] = np.concatenate(triangles)
    return found


def stl_triangles(file: Path) -> Points:
    """The triangles of a binary STL file, shape (n, 3, 3), in its unit."""
    return np.fromfile(file, _STL, offset=84)["corners"].astype(np.float64)


def fitted_hull(official: Points, corners: int) -> TriangleMesh:
    """Find a hull of few corners around points.

    Args:
        official: What it shall contain, shape (n, 3), [m].
        corners: How many corners it may have.

    Returns:
        The hull; it contains every point.
    """
    points = official[ConvexHull(official).vertices]
    planes = ConvexHull(points).equations
    fitted = _moved(_first_corners(points, corners), points, planes)
    hull = ConvexHull(np.round(_swollen(fitted, points), 6) + 0.0)
    number = np.full(len(fitted), -1)
    number[hull.vertices] = np.arange(len(hull.vertices))
    faces = hull.simplices.copy()
    a, b, c = (hull.points[faces[:, i]] for i in range(3))
    inwards = np.sum(np.cross(b - a, c - a) * hull.equations[:, :3], axis=1) < 0.0
    faces[inwards] = faces[inwards, ::-1]
    return TriangleMesh(vertices=hull.points[hull.vertices], faces=number[faces].astype(np.int32))


def _first_corners(points: Points, count: int) -> Points:
    """Points whose hull is nearly that of all: the furthest outside, one after the other."""
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    chosen = list(dict.fromkeys(np.argmax(points @ axes.T, axis=0).tolist()))
    while len(chosen) < count:
        planes = ConvexHull(points[chosen]).equations
        outside = points @ planes[:, :3].T + planes[:, 3]
        chosen.append(int(np.argmax(outside.max(axis=1))))
    return points[chosen]


def _moved(corners: Points, points: Points, planes: Points) -> Points:
    """Move corners until their hull contains the points and hardly stands out of the planes."""
    best, least = corners, np.inf
    for step in _STEPS * _lack(corners, points):
        corners = _step(corners, points, planes, step)
        lack, excess = _lack(corners, points), _excess(corners, planes)
        if excess + _LACK_COUNTS * lack < least:
            best, least = corners, excess + _LACK_COUNTS * lack
    return best


def _step(corners: Points, points: Points, planes: Points, step: float) -> Points:
    """One linear program: moves of the corners, then what stands out, then what lacks."""
    hull = ConvexHull(corners)
    n = corners.size
    rows: list[NDArray[np.float64]] = []
    bounds: list[float] = []
    for triangle, (*normal, _) in zip(hull.simplices, hull.equations, strict=True):
        furthest = points[np.argmax(points @ normal)]
        for shares in _shares(corners[triangle], furthest):
            row = np.zeros(n + 2)
            row[(3 * triangle[:, None] + np.arange(3)).ravel()] = -np.outer(shares, normal).ravel()
            row[n + 1] = -1.0
            rows.append(row)
            bounds.append(float((shares @ corners[triangle] - furthest) @ normal))
    outside = corners @ planes[:, :3].T + planes[:, 3]
    for i, k in zip(*np.nonzero(outside > -2.5 * step), strict=True):
        row = np.zeros(n + 2)
        row[3 * i : 3 * i + 3] = planes[k, :3]
        row[n] = -1.0
        rows.append(row)
        bounds.append(float(-outside[i, k]))
    solved = linprog(
        np.array([*np.zeros(n), 1.0, _LACK_COUNTS]),
        A_ub=csr_matrix(np.array(rows)),
        b_ub=bounds,
        bounds=[(-step, step)] * n + [(0.0, None)] * 2,
    )
    return corners if solved.x is None else corners + solved.x[:n].reshape(-1, 3)


def _shares(triangle: Points, point: Points) -> list[Points]:
    """Barycentric weights of the constrained places of a triangle: its middle, and a point."""
    middle = np.full(3, 1.0 / 3.0)
    there, *_ = np.linalg.lstsq(np.vstack([triangle.T, np.ones(3)]), np.append(point, 1.0))
    return [middle, there] if there.min() > -0.05 else [middle]


def _lack(corners: Points, points: Points) -> float:
    """How far points stand out of the corners' hull, at the most [m]."""
    planes = ConvexHull(corners).equations
    return float((points @ planes[:, :3].T + planes[:, 3]).max())


def _excess(corners: Points, planes: Points) -> float:
    """How far corners stand out of planes, at the most [m]."""
    return float((corners @ planes[:, :3].T + planes[:, 3]).max())


def _swollen(corners: Points, points: Points) -> Points:
    """The corners, moved outwards until their hull contains the points despite rounding."""
    middle = corners.mean(axis=0)
    planes = ConvexHull(corners - middle).equations
    room = -planes[:, 3]
    needed = ((points - middle) @ planes[:, :3].T).max(axis=0) + 2e-6
    return np.asarray(middle + (corners - middle) * max(1.0, float((needed / room).max())))


def to_obj(hull: TriangleMesh, link: str, script: str = "make_hulls") -> str:
    """Write a hull as Wavefront OBJ text."""
    lines = [f"# Convex hull of {link}, metres, link frame; written by urdf/{script}.py"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in hull.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in hull.faces + 1]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Make all seven hulls, or those of the parts that are named after the folder."""
    folder, *parts = sys.argv[1:]
    triangles = official_triangles(Path(folder))
    for link, part in PARTS.items():
        if parts and part not in parts:
            continue
        official = triangles[link].reshape(-1, 3)
        hull = fitted_hull(official, CORNERS[part])
        (MESH_DIR / f"{part}_hull.obj").write_text(to_obj(hull, link), encoding="ascii")
        planes = ConvexHull(official).equations
        excess = 1e3 * _excess(hull.vertices, planes)
        print(f"{part:12}{len(hull.vertices):4d} corners, {excess:.3f} mm beyond the official hull")


if __name__ == "__main__":
    main()
