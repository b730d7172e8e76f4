"""Write kinematics for viam-server: the arm as SVA JSON or URDF, the gripper as SVA JSON.

All is read from the robot description but the names, which are the published module's, because the
frame systems of existing machines refer to them. viam-server requires the rest: one leaf, an
``<origin>`` on every joint and a ``<limit>`` on every revolute one (without them it panics), one
collision geometry a link. In SVA a link is the path from one joint to the next, and its geometry
sits in the frame the link starts in. A gripper is a chain of links without joints, one a box.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import so101_description

from so101_motion.common.geometry import SE3, Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_mm
from so101_motion.viam.conversion.orientation import from_rotation

LINKS = ("base", "shoulder", "upper_arm", "lower_arm", "wrist")
"""The published module's names of the five links that carry a geometry."""

TCP = {"follower": np.array(so101_description.ROBOT.tcp), "leader": np.zeros(3)}
"""Tool centre point in the arm's tool frame [m]: between the jaws; the published module's."""

URDF_LINK = {part: link for link, part in so101_description.PARTS.items()}
_TOOL_JOINT = "tool_fixed"
_ROUND = 9  # decimals written; a nanometre


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Box:
    """An axis-aligned box in the frame of its part; both shape (3,), [m]."""

    center: Array
    size: Array

    @classmethod
    def around(cls, points: Array) -> Box:
        lower, upper = points.min(axis=0), points.max(axis=0)
        return cls(center=(lower + upper) / 2, size=upper - lower)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Segment:
    """One link of the chain, from its own frame to the next joint [m, rad]; ``joint`` ends it."""

    link: str
    xyz: tuple[float, ...]
    rpy: tuple[float, ...]
    joint: str | None
    lower: float
    upper: float
    box: Box | None


@cache
def chain() -> tuple[Segment, ...]:
    """The arm from the base to the tool, read from the robot description."""
    joints = {
        joint.attrib["name"]: joint
        for joint in ET.parse(so101_description.URDF_PATH).getroot().findall("joint")
    }
    segments = [
        _segment(link, joints[joint], number=str(i), box=link_box(link))
        for i, (link, joint) in enumerate(zip(LINKS, ARM_JOINTS, strict=True), start=1)
    ]
    return (*segments, _segment("tool", joints[_TOOL_JOINT], number=None, box=None))


def _segment(link: str, joint: ET.Element, *, number: str | None, box: Box | None) -> Segment:
    origin, limit = joint.find("origin"), joint.find("limit")
    if origin is None or (number is not None and limit is None):
        raise ValueError(f"joint {joint.attrib['name']} of the description lacks origin or limit")
    bounds = limit.attrib if limit is not None else {"lower": "0", "upper": "0"}
    return Segment(
        link=link,
        xyz=tuple(map(float, origin.attrib["xyz"].split())),
        rpy=tuple(map(float, origin.attrib["rpy"].split())),
        joint=number,
        lower=float(bounds["lower"]),
        upper=float(bounds["upper"]),
        box=box,
    )


@cache
def part_boxes(part: str) -> tuple[Box, ...]:
    """The boxes fitted to a part, in its link's frame; one around its hull if none are."""
    robot, link = so101_description.ROBOT, URDF_LINK[part]
    if robot.boxes is None:
        return (Box.around(robot.hull(link).vertices),)
    rows = json.loads(robot.boxes.read_text())["sets"]["boxes"][link]
    return tuple(Box(center=np.array(row[:3]), size=np.array(row[3:])) for row in rows)


def link_box(part: str) -> Box:
    boxes = part_boxes(part)
    corners = [box.center + side * box.size / 2 for box in boxes for side in (-1, 1)]
    return Box.around(np.array(corners))


# SVA


def arm_sva(name: str) -> bytes:
    """The arm in Viam's own format: millimetres and degrees, Euler angles in radians."""
    links, joints, parent = [], [], "world"
    for segment in chain():
        link = _link(segment.link, parent, np.array(segment.xyz), segment.rpy)
        if segment.box is not None:
            link["geometry"] = _sva_box(segment.box, SE3.identity())
        links.append(link)
        if segment.joint is not None:
            joints.append({
                "id": segment.joint,
                "type": "revolute",
                "parent": segment.link,
                "axis": {"x": 0, "y": 0, "z": 1},
                "min": to_deg(segment.lower),
                "max": to_deg(segment.upper),
            })  # fmt: skip
            parent = segment.joint
    return _sva(name, links, joints)


def gripper_sva(
    name: str, kind: str, parts: Iterable[tuple[str, SE3, Box]], T_tool_tcp: SE3 | None = None
) -> bytes:
    """A gripper, from label, placement in the tool frame, and box of each part.

    ``T_tool_tcp`` is its point; None for that between the jaws.
    """
    links: list[dict[str, Any]] = []
    parent = "world"
    for label, T_tool_part, box in parts:
        links.append(_link(label, parent, np.zeros(3)) | {"geometry": _sva_box(box, T_tool_part)})
        parent = label
    tcp = SE3.from_translation(TCP[kind]) if T_tool_tcp is None else T_tool_tcp
    return _sva(name, [*links, _link("tcp", parent, tcp.p, tcp.rpy.tolist())], [])


def _sva(name: str, links: list[dict[str, Any]], joints: list[dict[str, Any]]) -> bytes:
    model = {"name": name, "kinematic_param_type": "SVA", "links": links, "joints": joints}
    return json.dumps(model, indent=1).encode()


def _link(name: str, parent: str, xyz: Array, rpy: Iterable[float] = (0, 0, 0)) -> dict[str, Any]:
    turn = dict(zip(("roll", "pitch", "yaw"), rpy, strict=True))
    return {
        "id": name,
        "parent": parent,
        "translation": _xyz_mm(xyz),
        "orientation": {"type": "euler_angles", "value": turn},
    }


def _sva_box(box: Box, T_parent_box: SE3) -> dict[str, Any]:
    vector = from_rotation(T_parent_box.R)
    x, y, z = (round(float(to_mm(edge)), _ROUND) for edge in box.size)
    turn = {**dict(zip("xyz", vector.o, strict=True)), "th": to_deg(vector.theta)}
    return {
        "type": "box",
        "x": x,
        "y": y,
        "z": z,
        "translation": _xyz_mm(T_parent_box @ box.center),
        "orientation": {"type": "ov_degrees", "value": turn},
    }


def _xyz_mm(p: Array) -> dict[str, float]:
    return {key: round(float(to_mm(value)), _ROUND) for key, value in zip("xyz", p, strict=True)}


# URDF


def arm_urdf(name: str) -> bytes:
    """The arm as URDF: metres and radians, one box a link, one leaf.

    The fixed turn of the tool needs a link of its own, ``tool_mount``, because in URDF the origin
    belongs to a joint and not to the link before it.
    """
    robot = ET.Element("robot", name=name)
    segments = chain()
    links = (*(segment.link for segment in segments[:-1]), "tool_mount", "tool")
    for link in links:
        _urdf_link(robot, link, next((s.box for s in segments if s.link == link), None))
    for segment, parent, child in zip(segments, links[:-1], links[1:], strict=True):
        _urdf_joint(robot, segment, parent, child)
    ET.indent(robot)
    return bytes(ET.tostring(robot, encoding="utf-8", xml_declaration=True))


def _urdf_link(robot: ET.Element, name: str, box: Box | None) -> None:
    link = ET.SubElement(robot, "link", name=name)
    if box is None:
        return
    collision = ET.SubElement(link, "collision")
    ET.SubElement(collision, "origin", xyz=_words(box.center), rpy="0 0 0")
    geometry = ET.SubElement(collision, "geometry")
    ET.SubElement(geometry, "box", size=_words(box.size))


def _urdf_joint(robot: ET.Element, segment: Segment, parent: str, child: str) -> None:
    kind = "fixed" if segment.joint is None else "revolute"
    joint = ET.SubElement(robot, "joint", name=segment.joint or "tool_joint", type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=_words(segment.xyz), rpy=_words(segment.rpy))
    if segment.joint is not None:
        ET.SubElement(joint, "axis", xyz="0 0 1")
        ET.SubElement(
            joint, "limit", lower=repr(segment.lower), upper=repr(segment.upper),
            effort="1.91", velocity="4.71",
        )  # fmt: skip


def _words(values: Iterable[float]) -> str:
    return " ".join(f"{round(float(value), 12):.12g}" for value in values)
