"""Write the SO-100's URDF and hulls: ``python -m urdf.make_so100 FOLDER``.

``FOLDER`` is ``Simulation/SO100`` of a checkout of TheRobotStudio/SO-ARM100, commit fda892cb
(Apache-2.0); no mesh of it is copied. Origins, masses, inertias and limits are the official file's,
in frames like those of ``so101.urdf``: each joint turns about its own z, and at zero the upper arm
stands up while forearm and gripper point forward. Run ``make_allowed_pairs`` afterwards.
"""

import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, Final

import numpy as np
import pinocchio as pin

from . import PARTS
from .make_hulls import fitted_hull, stl_triangles, to_obj
from .robots import BUILT_IN, JOINTS

_X, _Y, _Z = np.eye(3)

AXES: Final = {
    "base": (-_Y, _Z),
    "shoulder": (-_Z, _Y),
    "upper_arm": (-_Y, _X),
    "lower_arm": (-_Z, _X),
    "wrist": (_Y, _X),
    "gripper": (-_X, _Y),
    "jaw": (_X, _Z),
}
"""The axes of an official link frame that are x and z of ours."""

ZEROS: Final = (0.0, 1.8, -np.pi / 2, 1.0 - np.pi / 2, 0.0, 0.0)
"""The official angles at our zero [rad]."""

FLOOR: Final = -0.0024  # underside of the base in ``base_link``, as in so101.urdf [m]
CORNERS: Final = 40  # of a hull, at most; chosen
STALL, SPEED = 1.91, 4.71  # as in so101.urdf [N m, rad/s]; the official file has no true figures
INERTIA: Final = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")

TIP: Final = (-0.0079, 0.0, -0.1001)
"""``jaw_tip`` in ``gripper_link`` [m]: on the inner face of the official fixed jaw, 6.3 mm behind
its tip, as on the SO-101."""


def _turned(part: str) -> Any:
    """``T_official_ours`` of a link's frame."""
    x, z = AXES[part]
    drop = -FLOOR if part == "base" else 0.0  # the official base stands on z = 0
    return pin.SE3(np.column_stack([x, np.cross(z, x), z]), np.array([0.0, 0.0, drop]))


def _row(values: Any) -> str:
    return " ".join(f"{each:.9g}" for each in np.round(np.asarray(values, float), 9) + 0.0)


def _origin(T: Any) -> str:
    R = np.round(T.rotation)  # the official quarter turns are rounded to five digits
    exact = R if np.allclose(R, T.rotation, atol=1e-4) else T.rotation
    return f'<origin xyz="{_row(T.translation)}" rpy="{_row(pin.rpy.matrixToRpy(exact))}"/>'


def _link(folder: Path, link: str, part: str, official: ET.Element) -> list[str]:
    T = _turned(part).inverse()
    inertial = official.find("inertial")
    assert inertial is not None
    given = {each.tag: each.attrib for each in inertial}
    a, b, c, d, e, f = (float(given["inertia"][key]) for key in INERTIA)
    mass, at = float(given["mass"]["value"]), np.array(given["origin"]["xyz"].split(), float)
    body = T.act(pin.Inertia(mass, at, np.array([[a, b, c], [b, d, e], [c, e, f]])))
    values = body.inertia[np.triu_indices(3)]
    terms = " ".join(f'{k}="{v:.6g}"' for k, v in zip(INERTIA, values, strict=True))
    files = [mesh.attrib["filename"] for mesh in official.iterfind("visual/geometry/mesh")]
    points = np.concatenate([stl_triangles(folder / each).reshape(-1, 3) for each in files])
    hull = fitted_hull(points @ T.rotation.T + T.translation, CORNERS)
    file = BUILT_IN["so100"].with_name(f"{part}_hull.obj")
    file.write_text(to_obj(hull, link, "make_so100"), encoding="ascii")
    return [
        f'  <link name="{link}">',
        f'    <inertial><origin xyz="{_row(body.lever)}"/><mass value="{mass:g}"/>',
        f"      <inertia {terms}/></inertial>",
        f'    <collision><geometry><mesh filename="{file.name}"/></geometry></collision>',
        "  </link>",
    ]


def _joint(name: str, parent: str, child: str, zero: float, official: ET.Element) -> list[str]:
    origin, axis, limit = (official.find(key) for key in ("origin", "axis", "limit"))
    assert origin is not None
    assert axis is not None
    assert limit is not None
    xyz, rpy = (np.array(origin.attrib[key].split(), float) for key in ("xyz", "rpy"))
    turn = pin.exp3(np.array(axis.attrib["xyz"].split(), float) * zero)
    there = pin.SE3(pin.rpy.rpyToMatrix(*rpy) @ turn, xyz)
    T = _turned(PARTS[parent]).inverse() * there * _turned(PARTS[child])
    lower, upper = (float(limit.attrib[key]) - zero for key in ("lower", "upper"))
    bounds = f'lower="{lower:.6g}" upper="{upper:.6g}" effort="{STALL}" velocity="{SPEED}"'
    return [
        f'  <joint name="{name}" type="revolute">',
        f'    <parent link="{parent}"/><child link="{child}"/>',
        f"    {_origin(T)}",
        f'    <axis xyz="0 0 1"/><limit {bounds}/>',
        "  </joint>",
    ]


def _fixed(name: str, p: Any) -> list[str]:
    """A frame of the gripper at ``p`` [m], with z along the approach."""
    return [
        f'  <link name="{name}"/>',
        f'  <joint name="{name}_fixed" type="fixed">',
        f'    <parent link="gripper_link"/><child link="{name}"/>',
        f'    <origin xyz="{_row(p)}" rpy="0 {np.pi} 0"/>',
        "  </joint>",
    ]


def main() -> None:
    """Write both."""
    folder = Path(sys.argv[1])
    official = ET.parse(folder / "so100.urdf").getroot()
    links = {each.attrib["name"]: each for each in official.findall("link")}
    joints = {each.attrib["name"]: each for each in official.findall("joint")}
    text = [
        '<?xml version="1.0"?>',
        "<!-- SO-100 follower arm. Metres, radians, kilograms, newton-metres. Written by",
        "  make_so100.py from Simulation/SO100/so100.urdf of TheRobotStudio/SO-ARM100, commit",
        "  fda892cb (Apache-2.0). The base's mass and inertia are approximate there. -->",
        '<robot name="so100">',
    ]
    for link, part in PARTS.items():
        text += _link(folder, link, part, links[part])
    names = list(PARTS)
    text += [*_fixed("tool", (0.0, 0.0, 0.0)), *_fixed("jaw_tip", TIP)]
    for name, parent, child, zero in zip(JOINTS, names[:-1], names[1:], ZEROS, strict=True):
        text += _joint(name, parent, child, zero, joints[name])
    BUILT_IN["so100"].with_name("so100.urdf").write_text("\n".join([*text, "</robot>\n"]))


if __name__ == "__main__":
    main()
