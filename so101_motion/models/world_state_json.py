"""A scene as the JSON of a Viam WorldState, for whoever plans with another motion service.

Plain values in the form that protobuf gives such a message in JSON (millimetres, degrees,
orientation vectors; binary as base64), made without Viam's package, which a page does not load.
Obstacles are seen from the arm's base, ``<arm>_origin``, and what is held from its tool, ``<arm>``.

A WorldState cannot say everything that a scene can: it has no floor, no weight, no permitted
contacts, and a keep-out zone is an obstacle in it like any other.
"""

from __future__ import annotations

import base64

from so101_motion.geometry import SE3
from so101_motion.models.orientation import from_rotation
from so101_motion.planning.scene import Box, Capsule, Mesh, PointCloud, Scene, Shape, Sphere
from so101_motion.units import to_deg, to_mm

Json = dict[str, object]


def world_state_json(scene: Scene, *, arm: str = "arm") -> Json:
    """The WorldState that says what is around an arm and in its hand.

    Args:
        scene: What is.
        arm: What the machine calls the arm.
    """
    world: Json = {}
    if scene.obstacles:
        geometries = [_geometry(o.shape, o.name, o.T_base_obstacle) for o in scene.obstacles]
        world["obstacles"] = [{"referenceFrame": f"{arm}_origin", "geometries": geometries}]
    if scene.attached:
        world["transforms"] = [
            {
                "referenceFrame": held.name,
                "poseInObserverFrame": {"referenceFrame": arm, "pose": _pose(held.T_tool_object)},
                "physicalObject": _geometry(held.shape, held.name, SE3.identity()),
            }
            for held in scene.attached
        ]
    return world


def ply(mesh: Mesh) -> bytes:
    """A mesh as a PLY file in metres, which is what Viam reads."""
    import trimesh

    made = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    return bytes(made.export(file_type="ply"))  # type: ignore[arg-type]  # a ply is bytes


def pcd(cloud: PointCloud) -> bytes:
    """A point cloud as a PCD file in metres, as Viam's cameras send it."""
    points = cloud.points.astype("<f4")
    head = (
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {len(points)}\nDATA binary\n"
    )
    return head.encode() + points.tobytes()


def _geometry(shape: Shape, label: str, pose: SE3) -> Json:
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
    return {"mesh": {"contentType": "ply", "mesh": base64.b64encode(ply(shape)).decode()}}


def _pose(T: SE3) -> Json:
    vector = from_rotation(T.R)
    x, y, z = (_number(to_mm(value)) for value in T.p)
    o_x, o_y, o_z = (_number(value, digits=9) for value in vector.o)
    theta = _number(to_deg(vector.theta))
    return {"x": x, "y": y, "z": z, "oX": o_x, "oY": o_y, "oZ": o_z, "theta": theta}


def _number(value: float, *, digits: int = 6) -> float:
    """As one would write it: a nanometre and a microdegree are enough."""
    return round(float(value), digits) + 0.0  # no minus zero
