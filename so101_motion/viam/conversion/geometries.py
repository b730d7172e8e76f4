"""Convert Viam's geometries to the planner's shapes and back.

viam-server ignores the centre of a point cloud, takes the points as they are, and sends them on
with the middle of their bounds as the centre. It sends an STL file on under the label of a PLY
file. So both are recognised by what they contain.
"""

from __future__ import annotations

import math
import uuid

import numpy as np
from google.protobuf import json_format
from viam.proto.common import Geometry, Transform

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.units import to_m
from so101_motion.planning.collision.scene import Box, Capsule, Shape, ShapeFile, Sphere
from so101_motion.planning.collision.shape_files import mesh_kind, read_shape, shape_file
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.world_state_json import geometry_json

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


def to_geometry(shape: Shape | ShapeFile, label: str) -> Geometry:
    """A shape as Viam draws it, around its own centre; every mesh as PLY text.

    viam-server refuses a geometry without a centre, and reads no binary PLY.
    """
    geometry = Geometry()
    json_format.ParseDict(geometry_json(read_shape(shape), label, SE3.identity()), geometry)
    return geometry


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
