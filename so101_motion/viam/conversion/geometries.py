"""Convert Viam's geometries to the planner's shapes and back, and write a scene as a WorldState.

viam-server ignores the centre of a point cloud, takes the points as they are, and sends them on
with the middle of their bounds as the centre. It sends an STL file on under the label of a PLY
file. So both are recognised by what they contain.
"""

from __future__ import annotations

import math
import uuid
from collections.abc import Iterator
from typing import Any

import numpy as np
from google.protobuf import json_format
from viam.proto import common as proto
from viam.proto.common import Geometry, Transform

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.units import to_m, to_mm
from so101_motion.planning.collision.scene import (
    Box,
    Capsule,
    PointCloud,
    Scene,
    Shape,
    ShapeFile,
    Sphere,
)
from so101_motion.planning.collision.shape_files import mesh_kind, read_shape, shape_file, welded
from so101_motion.viam.conversion import convert

LONGEST_LABEL = 200  # most characters of a label; chosen, it appears in messages and pictures


def from_geometry(geometry: Geometry) -> Shape | ShapeFile:
    """The shape of a geometry, around its own centre; a mesh or a cloud as a file."""
    label = geometry.label or "a geometry without a label"
    if len(label) > LONGEST_LABEL:
        raise ConfigError("label", label, f"is longer than {LONGEST_LABEL} characters")
    try:
        return _shape(geometry, label)
    except ConfigError as error:
        raise ConfigError(error.key, error.value, f"(of {label}) {error.reason}") from error


def to_geometry(shape: Shape | ShapeFile, label: str, T: SE3 | None = None) -> Geometry:
    """A shape at ``T`` as Viam draws it, around its own centre if not given.

    viam-server refuses a geometry without a centre, but ignores that of a cloud, and reads no
    binary PLY, so a mesh becomes PLY text.
    """
    shape, T = read_shape(shape), T or SE3.identity()
    if isinstance(shape, PointCloud):
        shape, T = PointCloud(points=T @ shape.points), SE3.identity()
    return Geometry(center=convert.to_pose(T), label=label, **_form(shape))


def _form(shape: Shape) -> dict[str, Any]:
    if isinstance(shape, Box):
        x, y, z = map(_mm, shape.size)
        return {"box": proto.RectangularPrism(dims_mm=proto.Vector3(x=x, y=y, z=z))}
    if isinstance(shape, Sphere):
        return {"sphere": proto.Sphere(radius_mm=_mm(shape.radius))}
    if isinstance(shape, Capsule):
        radius_mm, length_mm = _mm(shape.radius), _mm(shape.length)
        return {"capsule": proto.Capsule(radius_mm=radius_mm, length_mm=length_mm)}
    if isinstance(shape, PointCloud):
        return {"pointcloud": proto.PointCloud(point_cloud=pcd(shape))}
    vertices, triangles = shape.vertices, shape.triangles
    if len(vertices) > len(triangles):  # as of an STL file, which repeats the corners
        vertices, triangles = welded(vertices, triangles)
    return {"mesh": proto.Mesh(content_type="ply", mesh=ply(vertices, triangles))}


def _mm(length: float) -> float:
    """Millimetres, rounded to a nanometre."""
    return round(float(to_mm(length)), 6)


_AT_ONCE = 1_000
"""Rows that are formatted at a time, so that no other thread waits for long. Chosen."""


def ply(vertices: Array, triangles: Array, *, digits: int = 6) -> bytes:
    """A mesh as PLY text in metres."""
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    corner = f"%.{digits}f"
    lines = (*_lines(f"{corner} {corner} {corner}\n", vertices), *_lines("3 %d %d %d\n", triangles))
    return "".join((head, *lines)).encode()


def _lines(form: str, rows: Array) -> Iterator[str]:
    for first in range(0, len(rows), _AT_ONCE):
        some = rows[first : first + _AT_ONCE]
        yield form * len(some) % tuple(some.ravel().tolist())


def pcd(cloud: PointCloud) -> bytes:
    """A point cloud as a PCD file in metres, as Viam's cameras send it."""
    points = cloud.points.astype("<f4")
    head = (
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {len(points)}\nDATA binary\n"
    )
    return head.encode() + points.tobytes()


def world_state_json(scene: Scene, *, arm: str = "arm") -> dict[str, Any]:
    """A scene as the JSON of a WorldState, for planning with another motion service.

    Obstacles are in the frame of the arm's base, ``<arm>_origin``, and held objects in that of its
    tool, ``<arm>``. It has no floor, no weight and no permitted contacts, and a keep-out zone is an
    obstacle in it.
    """
    geometries = [to_geometry(o.shape, o.name, o.T_base_obstacle) for o in scene.obstacles]
    around = proto.GeometriesInFrame(reference_frame=f"{arm}_origin", geometries=geometries)
    held = [
        Transform(
            reference_frame=each.name,
            pose_in_observer_frame=proto.PoseInFrame(
                reference_frame=arm, pose=convert.to_pose(each.T_tool_object)
            ),
            physical_object=to_geometry(each.shape, each.name),
        )
        for each in scene.attached
    ]
    world = proto.WorldState(obstacles=[around] if geometries else [], transforms=held)
    document: dict[str, Any] = json_format.MessageToDict(world)
    return document


def _shape(geometry: Geometry, label: str) -> Shape | ShapeFile:
    kind = geometry.WhichOneof("geometry_type")
    if kind == "box":
        dims = geometry.box.dims_mm
        return Box(size=_lengths("dims_mm", dims.x, dims.y, dims.z, least=0.0))
    if kind == "sphere":
        return Sphere(radius=float(_lengths("radius_mm", geometry.sphere.radius_mm, least=0.0)[0]))
    if kind == "capsule":
        capsule = geometry.capsule
        radius, length = _lengths("radius_mm, length_mm", capsule.radius_mm, capsule.length_mm)
        return Capsule(radius=radius, length=length)
    if kind == "mesh":
        data = geometry.mesh.mesh
        return shape_file(mesh_kind(data), data, name=label)
    if kind == "pointcloud":
        return _cloud(geometry, label)
    raise ConfigError("geometry", kind, "must be a box, sphere, capsule, mesh or point cloud")


def _lengths(key: str, *lengths_mm: float, least: float = math.ulp(0.0)) -> Array:
    """Lengths in metres; errors are in the unit of the request."""
    if not all(least <= length < math.inf for length in lengths_mm):
        from_ = "more than 0 mm" if least else "0 mm or more"
        raise ConfigError(key, list(lengths_mm), f"must be {from_} and finite")
    return to_m(np.array(lengths_mm))


def _cloud(geometry: Geometry, label: str) -> ShapeFile:
    """A cloud's file, with its centre unless that is turned; viam-server may send either."""
    centre = convert.from_pose(geometry.center)
    is_turned = not np.allclose(centre.R, np.eye(3), atol=1e-9)
    data = geometry.pointcloud.point_cloud
    return shape_file("pcd", data, name=label, centre=None if is_turned else centre.p)


_NAMESPACE = uuid.UUID("8f3b1b5e-6a0c-4d8e-9d38-5a0f1f1c9a51")


def shown_id(frame: str, label: str) -> bytes:
    return uuid.uuid5(_NAMESPACE, f"{frame}/{label}").bytes


def is_ours(thing: Transform) -> bool:
    """Whether this module shows the transform: the arm's own scene, a goal, a path."""
    frame = thing.pose_in_observer_frame.reference_frame
    return thing.uuid == shown_id(frame, thing.reference_frame)
