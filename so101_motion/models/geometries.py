"""Viam's geometries as the planner's shapes and back: millimetres and metres, bytes and meshes."""

from __future__ import annotations

import io
import math

import numpy as np
from viam.proto.common import Capsule as ViamCapsule
from viam.proto.common import Geometry, RectangularPrism, Vector3
from viam.proto.common import Mesh as ViamMesh
from viam.proto.common import PointCloud as ViamCloud
from viam.proto.common import Sphere as ViamSphere

from so101_motion.errors import ConfigError
from so101_motion.geometry import Array
from so101_motion.models.world_state_json import pcd, ply
from so101_motion.planning.scene import Box, Capsule, Mesh, PointCloud, Shape, Sphere
from so101_motion.units import to_m, to_mm

MESH_TYPES = ("ply", "stl")
"""Kinds of mesh that viam-server sends."""


def from_geometry(geometry: Geometry) -> Shape:
    """The shape of a geometry, around its own centre.

    Raises:
        ConfigError: It has none, or one that cannot be meant; the message has its label.
    """
    try:
        return _shape(geometry)
    except ConfigError as error:
        label = geometry.label or "a geometry without a label"
        raise ConfigError(error.key, error.value, f"(of {label}) {error.reason}") from error


def to_geometry(shape: Shape, label: str) -> Geometry:
    """A shape as Viam draws it, around its own centre."""
    if isinstance(shape, Box):
        x, y, z = (float(edge) for edge in to_mm(shape.size))
        return Geometry(label=label, box=RectangularPrism(dims_mm=Vector3(x=x, y=y, z=z)))
    if isinstance(shape, Sphere):
        return Geometry(label=label, sphere=ViamSphere(radius_mm=to_mm(shape.radius)))
    if isinstance(shape, Capsule):
        radius_mm, length_mm = to_mm(shape.radius), to_mm(shape.length)
        capsule = ViamCapsule(radius_mm=radius_mm, length_mm=length_mm)
        return Geometry(label=label, capsule=capsule)
    if isinstance(shape, PointCloud):
        return Geometry(label=label, pointcloud=ViamCloud(point_cloud=pcd(shape)))
    return Geometry(label=label, mesh=ViamMesh(content_type="ply", mesh=ply(shape)))


def _shape(geometry: Geometry) -> Shape:
    kind = geometry.WhichOneof("geometry_type")
    if kind == "box":
        dims = geometry.box.dims_mm
        return Box(size=_lengths("dims_mm", dims.x, dims.y, dims.z))
    if kind == "sphere":
        return Sphere(radius=float(_lengths("radius_mm", geometry.sphere.radius_mm)[0]))
    if kind == "capsule":
        capsule = geometry.capsule
        radius, length = _lengths("radius_mm, length_mm", capsule.radius_mm, capsule.length_mm)
        return Capsule(radius=radius, length=length)
    if kind == "mesh":
        return _mesh(geometry.mesh.content_type, geometry.mesh.mesh)
    if kind == "pointcloud":
        return PointCloud(points=_points(geometry.pointcloud.point_cloud))
    raise ConfigError("geometry", kind, "must be a box, sphere, capsule, mesh or point cloud")


def _lengths(key: str, *lengths_mm: float) -> Array:
    """In metres; refused in the unit they came in."""
    if not all(0.0 < length < math.inf for length in lengths_mm):
        raise ConfigError(key, list(lengths_mm), "must be more than 0 mm and finite")
    return to_m(np.array(lengths_mm))


def _mesh(content_type: str, data: bytes) -> Mesh:
    """A mesh file's triangles; Viam's mesh files are in metres."""
    import trimesh  # many formats, and slow to import

    kind = content_type.rpartition("/")[2].lower()
    if kind not in MESH_TYPES:
        raise ConfigError("mesh.content_type", content_type, f"must be {' or '.join(MESH_TYPES)}")
    try:
        mesh = trimesh.load_mesh(io.BytesIO(data), file_type=kind)
        return Mesh(vertices=np.asarray(mesh.vertices), triangles=np.asarray(mesh.faces))
    except ConfigError:
        raise
    except Exception as error:  # its readers raise whatever they trip over
        raise ConfigError("mesh", f"{len(data)} bytes", f"is no {kind} file: {error}") from error


_PCD_TYPES = {("F", 4): "<f4", ("F", 8): "<f8", ("I", 4): "<i4", ("U", 4): "<u4"} | {
    (kind, size): f"<{code}{size}" for kind, code in (("I", "i"), ("U", "u")) for size in (1, 2)
}


def _points(data: bytes) -> Array:
    """The points of a PCD file, as Viam's cameras send it: ascii or binary, in metres."""
    head, _, body = data.partition(b"\nDATA ")
    kind, _, body = body.partition(b"\n")
    try:
        fields = dict(
            (words[0], words[1:])
            for line in head.decode("ascii").splitlines()
            if (words := line.split()) and not line.startswith("#")
        )
        names, count = fields["FIELDS"], int(fields["POINTS"][0])
        columns = [names.index(axis) for axis in "xyz"]
        if kind.strip() == b"ascii":
            table = np.array(body.split(), dtype=np.float64).reshape(count, -1)
            return np.asarray(table[:, columns])
        if kind.strip() != b"binary":
            raise ValueError(f"DATA {kind.decode('ascii', 'replace')} is not read here")
        sizes = [int(size) for size in fields["SIZE"]]
        counts = [int(n) for n in fields.get("COUNT", ["1"] * len(names))]
        record = np.dtype(
            [
                (f"{i}", _PCD_TYPES[letter, size], (n,))
                for i, (letter, size, n) in enumerate(
                    zip(fields["TYPE"], sizes, counts, strict=True)
                )
            ]
        )
        rows = np.frombuffer(body, record, count)
        return np.stack([rows[f"{i}"][:, 0].astype(np.float64) for i in columns], axis=1)
    except (KeyError, ValueError, IndexError) as error:
        raise ConfigError(
            "point_cloud", f"{len(data)} bytes", f"is no PCD file: {error}"
        ) from error
