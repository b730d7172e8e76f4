"""Write geometries and 3D models of arm and gripper for Viam's 3D viewer.

It draws the 3D model of the same label at the geometry's own pose. So the arm's geometries are
labelled ``<arm>:<part>`` with the model's key as ``<part>``, and a model's origin is the centre of
its box; our files have theirs in the link frame, and the shift is written into their header. A
gripper's parts are sent as meshes with every answer, so that the jaw moves: visual meshes made
coarse, as PLY, which is all that viam-server reads.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import so101_description
from so101_description import Surface
from viam.proto.common import Geometry, Mesh

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision import scene
from so101_motion.planning.collision.coal_shapes import held_shape
from so101_motion.planning.collision.scene import Attached, Tool
from so101_motion.planning.collision.shape_files import coarse, read_shape
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.geometries import ply, to_geometry
from so101_motion.viam.conversion.kinematics import LINKS, URDF_LINK, Box, link_box, part_boxes

GLB = "model/gltf-binary"  # content type of the arm's 3D models
TOOL_MARKER = "tool"  # the part that shows the tool frame, when it is asked for

MARKER_BOX = Box(center=np.zeros(3), size=np.full(3, 0.001))
"""The geometry of the marker [m]; small, because the marker is not a body."""

# The arm


def arm_geometries(
    name: str, T_base_links: Mapping[str, SE3], T_base_tool: SE3 | None
) -> list[Geometry]:
    """The arm's parts as boxes where they are now, and the tool marker if it has a place."""
    geometries = [
        _box(f"{name}:{part}", T_base_links[URDF_LINK[part]], link_box(part)) for part in LINKS
    ]
    if T_base_tool is not None:
        geometries.append(_box(f"{name}:{TOOL_MARKER}", T_base_tool, MARKER_BOX))
    return geometries


def _box(label: str, T_base_part: SE3, box: Box) -> Geometry:
    center = T_base_part @ SE3.from_translation(box.center)
    return to_geometry(scene.Box(size=box.size), label, center)


def arm_models(*, with_tool: bool) -> dict[str, Mesh]:
    """The arm's parts as binary glTF, keyed as in the geometries' labels."""
    drawn = ((part, so101_description.ROBOT.visual_file(URDF_LINK[part])) for part in LINKS)
    models = {
        part: Mesh(content_type=GLB, mesh=_centered_glb(part, file))
        for part, file in drawn
        if file is not None
    }
    if with_tool:
        marker = (so101_description.MESH_DIR / "axes.glb").read_bytes()
        models[TOOL_MARKER] = Mesh(content_type=GLB, mesh=marker)
    return models


@cache
def _centered_glb(part: str, file: Path) -> bytes:
    return shifted_glb(file.read_bytes(), -link_box(part).center)


def shifted_glb(data: bytes, shift: Array) -> bytes:
    """Move everything in a binary glTF file, whose nodes have no transforms, by ``shift`` [m].

    Source: glTF 2.0 specification, section 4.4, binary glTF layout.
    """
    magic, version, _ = struct.unpack_from("<III", data)
    length, kind = struct.unpack_from("<II", data, 12)
    document = json.loads(data[20 : 20 + length])
    for node in document["nodes"]:
        node["translation"] = [float(value) for value in shift]
    header = json.dumps(document, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 4)
    chunks = struct.pack("<II", len(header), kind) + header + data[20 + length :]
    return struct.pack("<III", magic, version, 12 + len(chunks)) + chunks


# The gripper

GRID = {"low": 0.008, "high": 0.0015}
"""Vertices closer than this are welded into one [m]; chosen: a few and some dozen kilobytes."""

_MOVING = {"follower": "jaw", "leader": "leader_trigger"}


def gripper_geometries(
    kind: str, detail: str, T_tool_body: SE3, T_tool_moving: SE3
) -> list[Geometry]:
    """The gripper's parts as meshes, in the tool frame of the arm it is fixed to."""
    fixed = [
        Geometry(center=convert.to_pose(T_tool_body), mesh=mesh, label=f"gripper_body_{i}")
        for i, mesh in enumerate(_body_meshes(kind, detail))
    ]
    moving = Geometry(
        center=convert.to_pose(T_tool_moving),
        mesh=_moving_mesh(kind, detail),
        label="gripper_moving",
    )
    return [*fixed, moving]


@cache
def _body_meshes(kind: str, detail: str) -> tuple[Mesh, ...]:
    if kind == "follower":
        return (_ply(so101_description.load_visual("gripper"), GRID[detail]),)
    return tuple(_ply(surfaces, GRID[detail]) for surfaces in _leader_body())


@cache
def _leader_body() -> tuple[tuple[Surface, ...], tuple[Surface, ...]]:
    surfaces = so101_description.load_visual("leader_body")
    servo = tuple(surface for surface in surfaces if surface.name in ("servo", "horn"))
    return tuple(surface for surface in surfaces if surface not in servo), servo


@cache
def _moving_mesh(kind: str, detail: str) -> Mesh:
    return _ply(so101_description.load_visual(_MOVING[kind]), GRID[detail])


def _ply(surfaces: Sequence[Surface], grid: float) -> Mesh:
    """Surfaces as one PLY mesh in metres, its vertices merged on a grid."""
    meshes = [surface.mesh for surface in surfaces]
    vertices, faces = coarse([(mesh.vertices, mesh.faces) for mesh in meshes], grid)
    return Mesh(content_type="ply", mesh=ply(vertices, faces, digits=5))


def tool_geometries(tool: Tool) -> list[Geometry]:
    """The bodies of what is fixed to the gripper, in the tool frame."""
    return [to_geometry(each.shape, each.name, each.T_tool_object) for each in tool.parts]


def box_around(part: Attached) -> Box:
    """The box around a part of a tool, in the part's own frame."""
    _, corners = held_shape(read_shape(part.shape))
    return Box.around(corners)


def gripper_placements(model: RobotModel, q_jaw: float) -> tuple[SE3, SE3]:
    """Where a gripper's fixed and moving parts are, in the tool frame, for a jaw angle [rad]."""
    links = model.link_placements(np.zeros(5), q_jaw)
    T_tool_base = model.frame(np.zeros(5), "tool").inverse
    return T_tool_base @ links[URDF_LINK["gripper"]], T_tool_base @ links[URDF_LINK["jaw"]]


def gripper_boxes(kind: str) -> tuple[tuple[str, Box], ...]:
    """Boxes that enclose a gripper, each in the frame of its part, under its part's label.

    Several boxes of one part are numbered: a link of a kinematic model carries one geometry.
    """
    if kind == "follower":
        parts = {"gripper_body_0": part_boxes("gripper"), "gripper_moving": part_boxes("jaw")}
    else:
        handle, servo = _leader_body()
        trigger = so101_description.load_visual(_MOVING[kind])
        parts = {
            "gripper_body_0": (_enclosing(handle),),
            "gripper_body_1": (_enclosing(servo),),
            "gripper_moving": (_enclosing(trigger),),
        }
    return tuple(
        (label if i == 0 else f"{label}_{i}", box)
        for label, boxes in parts.items()
        for i, box in enumerate(boxes)
    )


def _enclosing(surfaces: Sequence[Surface]) -> Box:
    return Box.around(np.concatenate([surface.mesh.vertices for surface in surfaces]))
