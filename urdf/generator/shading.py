"""Vertex normals that make a coarse mesh of a soft-edged part look round.

Plain averaging tilts the normals of large flat faces next to a bevel, and they shimmer. Here each
flat face counts with its whole area, so it keeps its own normal and the bevel alone bends: a
single row of facets then reads as a rounded edge. Across a crease nothing is averaged.
"""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int64]


def shaded(
    vertices: Array, faces: Faces, *, crease: float = math.radians(48.0)
) -> tuple[Array, Array, Faces]:
    """Split the vertices of a mesh along its creases and give each a normal.

    Args:
        vertices: Shape (n, 3).
        faces: Vertex indices, shape (m, 3).
        crease: Flat faces that meet at more than this are not blended, [rad]. 48 degrees lets a
            single 45 degree bevel read as a round edge and keeps a right angle sharp.

    Returns:
        Vertices and unit normals, shape (k, 3) each with k >= n, and the faces.
    """
    edges = vertices[faces[:, 1:]] - vertices[faces[:, :1]]
    cross = np.cross(edges[:, 0], edges[:, 1])
    double_area = np.linalg.norm(cross, axis=1)
    # Slivers keep the mesh closed but have no direction: they borrow one at the end.
    sliver = double_area < 1e-6
    slivers, faces = faces[sliver], faces[~sliver]
    cross, double_area = cross[~sliver], double_area[~sliver]
    normals = cross / double_area[:, None]

    # Triangles of one plane form one flat face.
    height = np.sum(normals * vertices[faces[:, 0]], axis=1)
    key = np.round(np.column_stack([normals * 500.0, height * 50.0])).astype(np.int64)
    _, flat = np.unique(key, axis=0, return_inverse=True)
    flat = flat.ravel()
    area = np.bincount(flat, weights=double_area)
    flat_normal = np.zeros((len(area), 3))
    np.add.at(flat_normal, flat, cross)
    flat_normal /= np.linalg.norm(flat_normal, axis=1, keepdims=True)

    # Every (vertex, flat face) incidence once; corners point at their incidence.
    incidences, corner = np.unique(
        np.column_stack([faces.ravel(), np.repeat(flat, 3)]), axis=0, return_inverse=True
    )
    own = np.zeros((len(incidences), 3))
    first = np.searchsorted(incidences[:, 0], np.arange(len(vertices)))
    last = np.searchsorted(incidences[:, 0], np.arange(len(vertices)), side="right")
    for begin, end in zip(first, last, strict=True):
        meeting = incidences[begin:end, 1]
        directions = flat_normal[meeting]
        near = directions @ directions.T > math.cos(crease)
        own[begin:end] = (near * area[meeting]) @ directions
    own /= np.linalg.norm(own, axis=1, keepdims=True)

    # Incidences of one vertex with the same normal become one vertex again.
    rows = np.column_stack([incidences[:, 0], np.round(own * 200.0).astype(np.int64)])
    _, representative, merged = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    merged = merged.ravel()
    return (
        vertices[incidences[representative, 0]],
        own[representative],
        np.concatenate([merged[corner.ravel()].reshape(-1, 3), merged[first[slivers]]]),
    )
