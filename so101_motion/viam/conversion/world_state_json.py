"""Write a scene as the JSON of a Viam WorldState, for planning with another motion service.

Viam's package is not used, because the viewer runs without it. Obstacles are in the frame of the
arm's base, ``<arm>_origin``, and held objects in that of its tool, ``<arm>``. A WorldState has no
floor, no weight and no permitted contacts, and a keep-out zone is an obstacle in it.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator

from so101_motion.common.geometry import SE3, Array
from so101_motion.common.units import to_deg, to_mm
from so101_motion.planning.collision.scene import Box, Capsule, PointCloud, Scene, Shape, Sphere
from so101_motion.planning.collision.shape_files import read_shape, welded
from so101_motion.viam.conversion.orientation import from_rotation

Json = dict[str, object]

_AT_ONCE = 1_000
"""Rows that are formatted at a time, so that no other thread waits for long. Chosen."""


def world_state_json(scene: Scene, *, arm: str = "arm") -> Json:
    world: Json = {}
    if scene.obstacles:
        geometries = [
            geometry_json(read_shape(o.shape), o.name, o.T_base_obstacle) for o in scene.obstacles
        ]
        world["obstacles"] = [{"referenceFrame": f"{arm}_origin", "geometries": geometries}]
    if scene.attached:
        world["transforms"] = [
            {
                "referenceFrame": held.name,
                "poseInObserverFrame": {"referenceFrame": arm, "pose": _pose(held.T_tool_object)},
                "physicalObject": geometry_json(read_shape(held.shape), held.name, SE3.identity()),
            }
            for held in scene.attached
        ]
    return world


def ply(vertices: Array, triangles: Array, *, digits: int = 6) -> bytes:
    """A mesh as PLY text in metres; viam-server reads no binary PLY."""
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


def geometry_json(shape: Shape, label: str, pose: SE3) -> Json:
    """A shape in Viam's JSON; meshes become PLY text, for viam-server reads no binary PLY."""
    if isinstance(shape, PointCloud):  # viam-server ignores the centre of a cloud
        points = shape.points @ pose.R.T + pose.p
        shape, pose = PointCloud(points=points), SE3.identity()
    return {"center": _pose(pose), **_form(shape), "label": label}


def _form(shape: Shape) -> Json:
    if isinstance(shape, Box):
        x, y, z = (_number(to_mm(edge)) for edge in shape.size)
        return {"box": {"dimsMm": {"x": x, "y": y, "z": z}}}
    if isinstance(shape, Sphere):
        return {"sphere": {"radiusMm": _number(to_mm(shape.radius))}}
    if isinstance(shape, Capsule):
        radius_mm, length_mm = _number(to_mm(shape.radius)), _number(to_mm(shape.length))
        return {"capsule": {"radiusMm": radius_mm, "lengthMm": length_mm}}
    if isinstance(shape, PointCloud):
        return {"pointcloud": {"pointCloud": base64.b64encode(pcd(shape)).decode()}}
    vertices, triangles = shape.vertices, shape.triangles
    if len(vertices) > len(triangles):  # as of an STL file, which repeats the corners
        vertices, triangles = welded(vertices, triangles)
    data = ply(vertices, triangles)
    return {"mesh": {"contentType": "ply", "mesh": base64.b64encode(data).decode()}}


def _pose(T: SE3) -> Json:
    vector = from_rotation(T.R)
    x, y, z = (_number(to_mm(value)) for value in T.p)
    o_x, o_y, o_z = (_number(value, digits=9) for value in vector.o)
    theta = _number(to_deg(vector.theta))
    return {"x": x, "y": y, "z": z, "oX": o_x, "oY": o_y, "oZ": o_z, "theta": theta}


def _number(value: float, *, digits: int = 6) -> float:
    """Round to a nanometre or a microdegree."""
    return round(float(value), digits) + 0.0  # no minus zero
