"""Read the files that are loaded on the World tab: scenes, meshes, point clouds."""

from __future__ import annotations

import json
from pathlib import PurePath

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.files.scene_file import scene_from
from so101_motion.planning.collision.coal_shapes import full_cubes
from so101_motion.planning.collision.scene import Mesh, PointCloud, Scene
from so101_motion.planning.collision.shape_files import MESHES, file_mesh, holds_faces, read_cloud

ENDINGS = (".json", ".pcd", ".xyz", *(f".{kind}" for kind in MESHES))
"""Endings of the files that can be loaded."""

MOST_TRIANGLES = 50_000
"""A mesh with more would make pages and plans slow; chosen: ten times a simplified part."""

MOST_CUBES = 50_000  # the same for the cubes of a point cloud; chosen
VOXEL = 0.01  # edge of a cloud's cubes by default [m]; chosen, as for Viam's clouds


def read_loaded(
    name: str, content: bytes, *, voxel: float = VOXEL, scale: float = 1.0
) -> Scene | Mesh | PointCloud:
    """The content of a file; ``ConfigError``, which begins with its name, if it cannot be used.

    Meshes are in millimetres, unless their format declares a unit, and are put around the middle
    of their bounding box. Point clouds are in metres and stay where they are, seen from the arm's
    base; ``voxel`` is the edge of their cubes [m]. Both are multiplied by ``scale``.
    """
    kind = PurePath(name).suffix.lower()
    if kind not in ENDINGS:
        raise ConfigError(
            "file", name, f"is neither a scene (.json), a mesh (.{', .'.join(MESHES)}) nor"
            " points (.ply, .pcd, .xyz); of a part, export STL or GLB"
        )  # fmt: skip
    try:
        if kind == ".json":
            return _scene(name, content)
        if kind[1:] in MESHES and (kind != ".ply" or holds_faces(content)):
            return _mesh(kind[1:], content, scale)
        return thinned(scale * read_cloud(kind[1:], content), voxel)
    except ConfigError as error:
        if error.key == "file":
            raise
        raise ConfigError("file", name, error.reason) from error


def thinned(points: Array, voxel: float) -> PointCloud:
    """A cloud with one point for each cube of edge ``voxel`` [m], which is all that planning uses.

    ``ConfigError`` if there are too many cubes, or impossible points.
    """
    points = full_cubes(PointCloud(points=points, resolution=voxel))
    if len(points) > MOST_CUBES:
        raise ConfigError(
            "points", len(points), f"fills {len(points)} cubes, at most {MOST_CUBES} can be used;"
            " choose a larger cube size, or cut it to what the arm can reach"
        )  # fmt: skip
    return PointCloud(points=points, resolution=voxel)


def _scene(name: str, content: bytes) -> Scene:
    try:
        text = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ConfigError("file", name, f"is not JSON: {error}") from error
    return scene_from(text, folder=None)  # a browser must not have files of ours read


def _mesh(kind: str, content: bytes, scale: float) -> Mesh:
    mesh = file_mesh(kind, content, scale=scale, most=MOST_TRIANGLES)
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2.0
    return Mesh(vertices=mesh.vertices - middle, triangles=mesh.triangles)
