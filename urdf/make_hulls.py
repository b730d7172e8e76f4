"""Make the collision hulls: ``python -m urdf.make_hulls``, after ``make_meshes``.

One convex hull a link, on the safe side of the real arm. What we know of the official solids is
the fine set of boxes in ``boxes.json``, fitted so that together they cover each link; the hull
spans the corners of a link's boxes and the vertices of what we draw. It therefore contains both
exactly, which a test proves by half-spaces. A dozen boxes have few corners that matter: no hull
needs more than 40 vertices, so none is thinned and nothing is lost. Coordinates are whole
micrometres throughout and written as such, so writing loses nothing either.
"""

import itertools
import json
from typing import Final

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from . import BOXES_PATH, MESH_DIR, PARTS, TriangleMesh, load_visual

_CORNERS: Final = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))


def box_corners(link: str, *, boxes: str = "boxes_fine") -> NDArray[np.float64]:
    """Read the corners of the boxes that cover a link.

    Args:
        link: A key of ``PARTS``.
        boxes: The set in ``boxes.json``.

    Returns:
        Shape (8 n, 3), in the link's frame, [m].
    """
    sets = json.loads(BOXES_PATH.read_text(encoding="utf-8"))["sets"]
    rows = np.array(sets[boxes][link], dtype=np.float64)
    corners = rows[:, None, :3] + _CORNERS * rows[:, None, 3:]
    return np.asarray(corners.reshape(-1, 3), dtype=np.float64)


def hull_of(link: str) -> TriangleMesh:
    """Span a link's boxes and visual.

    Args:
        link: A key of ``PARTS``.

    Returns:
        The convex hull in the link's frame.
    """
    drawn = [surface.mesh.vertices for surface in load_visual(PARTS[link])]
    points = np.concatenate([box_corners(link), *drawn])
    mesh = Manifold.hull_points(points * 1e3).to_mesh64()
    return TriangleMesh(
        vertices=np.round(np.asarray(mesh.vert_properties)[:, :3] * 1e-3, 6) + 0.0,
        faces=np.asarray(mesh.tri_verts, dtype=np.int32),
    )


def to_obj(hull: TriangleMesh, link: str) -> str:
    """Write a hull as Wavefront OBJ text."""
    lines = [f"# Convex hull of {link}, metres, link frame; written by urdf/make_hulls.py"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in hull.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in hull.faces + 1]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Make all seven hulls."""
    for link, part in PARTS.items():
        hull = hull_of(link)
        (MESH_DIR / f"{part}_hull.obj").write_text(to_obj(hull, link), encoding="ascii")
        print(f"{part:12}{len(hull.vertices):4d} vertices{len(hull.faces):5d} triangles")


if __name__ == "__main__":
    main()
