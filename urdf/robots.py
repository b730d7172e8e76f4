"""A kind of arm as data: a JSON file that names its URDF and what a URDF does not say.

A process drives one kind. The environment variable ``SO101_ROBOT`` names it: ``so101`` (the
default), ``so100``, or the path of such a file; README.md describes the format.
"""

import json
import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from .mesh_readers import Surface, TriangleMesh, read_glb, read_obj

VARIABLE: Final = "SO101_ROBOT"
SCHEMA: Final = "so101/robot/1"

_HERE: Final = Path(__file__).resolve().parent
BUILT_IN: Final = {"so101": _HERE / "so101.json", "so100": _HERE / "so100" / "so100.json"}

JOINTS: Final = (
    "shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"
)  # fmt: skip

_CUBE: Final = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2.0
_CUBE_FACES: Final = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
])  # fmt: skip
_PLASTIC: Final = (0.8, 0.8, 0.78)  # colour of a link that is drawn as its hull; chosen


class RobotFileError(ValueError):
    """A robot file, or its URDF, cannot be used; the message says which and why."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Robot:
    """One kind of arm.

    Attributes:
        name: What people call it.
        urdf: Its URDF, with the links and joints of ``so101.urdf``.
        allowed_pairs: What ``make_allowed_pairs.py`` found; None to check all but neighbours.
        boxes: Boxes fitted to its links; None for the boxes around its hulls.
        limits: The smallest and largest angle of each of the six joints, from the URDF [rad].
        stops: Where the mechanical stops are [rad]; empty if not known.
        roll_upright: The wrist_roll with the jaws upright [rad].
        poses: Named configurations of the five joints, home, ready and rest [rad].
        tcp: Between the jaws, in the tool frame, [m].
        stall: Stall torque of its servos by their rated supply, [V] to [N m].
    """

    name: str
    urdf: Path
    allowed_pairs: Path | None
    boxes: Path | None
    limits: Mapping[str, tuple[float, float]]
    stops: Mapping[str, tuple[float, float]]
    roll_upright: float
    poses: Mapping[str, tuple[float, ...]]
    tcp: tuple[float, float, float]
    stall: Mapping[float, float]

    def hull(self, link: str) -> TriangleMesh:
        """Everything of a link's ``<collision>``, in the link's frame; its hull is checked."""
        meshes = [self._shape(each) for each in self._elements(link, "collision")]
        if not meshes:
            raise RobotFileError(f'{self.urdf}: link "{link}" has no <collision> to check')
        starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
        return TriangleMesh(
            vertices=np.concatenate([mesh.vertices for mesh in meshes]),
            faces=np.concatenate(faces).astype(np.int32),
        )

    def visual_file(self, link: str) -> Path | None:
        """The binary glTF that the URDF draws a link with; None if it names no such file."""
        for visual in self._elements(link, "visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is not None and mesh.attrib["filename"].endswith(".glb"):
                return self.urdf.parent / mesh.attrib["filename"]
        return None

    def visual(self, link: str) -> tuple[Surface, ...]:
        """What is drawn of a link: its glTF, else its hull."""
        file = self.visual_file(link)
        if file is not None:
            return read_glb(file)
        mesh = self.hull(link)
        corners = mesh.vertices[mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        flat = TriangleMesh(
            vertices=corners.reshape(-1, 3),
            faces=np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3),
        )
        return (
            Surface(name="print", mesh=flat, normals=np.repeat(normals, 3, axis=0), color=_PLASTIC),
        )

    def _elements(self, link: str, kind: str) -> list[ET.Element]:
        return ET.parse(self.urdf).getroot().findall(f"link[@name='{link}']/{kind}")

    def _shape(self, element: ET.Element) -> TriangleMesh:
        mesh, box = element.find("geometry/mesh"), element.find("geometry/box")
        if mesh is not None and mesh.attrib["filename"].endswith(".obj"):
            shape = read_obj(self.urdf.parent / mesh.attrib["filename"])
        elif box is not None:
            size = np.array(box.attrib["size"].split(), float)
            shape = TriangleMesh(vertices=_CUBE * size, faces=_CUBE_FACES.astype(np.int32))
        else:
            raise RobotFileError(f"{self.urdf}: a <collision> must be a box or an .obj mesh")
        origin = element.find("origin")
        if origin is None:
            return shape
        xyz, rpy = (
            np.array(origin.get(key, "0 0 0").split(), dtype=np.float64) for key in ("xyz", "rpy")
        )
        return TriangleMesh(vertices=shape.vertices @ _rotation(rpy).T + xyz, faces=shape.faces)


def _rotation(rpy: NDArray[np.float64]) -> NDArray[np.float64]:
    """URDF's roll, pitch and yaw about fixed axes as a matrix, shape (3, 3)."""
    (a, b, c), (sa, sb, sc) = np.cos(rpy), np.sin(rpy)
    return np.array([
        [b * c, sa * sb * c - a * sc, a * sb * c + sa * sc],
        [b * sc, sa * sb * sc + a * c, a * sb * sc - sa * c],
        [-sb, sa * b, a * b],
    ])  # fmt: skip


def load_robot(which: str) -> Robot:
    """Read a robot file.

    Args:
        which: A key of ``BUILT_IN``, or a path.

    Raises:
        RobotFileError: There is no such file, or something in it is missing or wrong.
    """
    file = BUILT_IN.get(which, Path(which))
    try:
        given = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(given, dict) or given.get("schema") != SCHEMA:
            raise ValueError(f'must be an object with the schema "{SCHEMA}"')
        urdf = file.parent / given["urdf"]
        extras = [
            file.parent / given[key] if key in given else None for key in ("allowed_pairs", "boxes")
        ]
        x, y, z = (float(value) / 1e3 for value in given["tcp_mm"])
        return Robot(
            name=str(given["name"]),
            urdf=urdf,
            allowed_pairs=extras[0],
            boxes=extras[1],
            limits=_limits(urdf),
            stops=_angles(given.get("stops_deg", {}), JOINTS, 2),
            roll_upright=math.radians(float(given.get("roll_upright_deg", 0.0))),
            poses=_angles(given["poses_deg"], ("home", "ready", "rest"), 5),
            tcp=(x, y, z),
            stall={float(volts): float(most) for volts, most in given["stall_nm"].items()},
        )
    except KeyError as error:
        raise RobotFileError(f"robot file {file}: {error.args[0]} is missing") from error
    except (OSError, ValueError, TypeError, AttributeError, ET.ParseError) as error:
        known = ", ".join(BUILT_IN)
        raise RobotFileError(
            f"robot file {file} ({VARIABLE}: {known}, or a path): {error}"
        ) from error


def chosen_robot() -> Robot:
    """The kind of arm of this process; see ``VARIABLE``."""
    return load_robot(os.environ.get(VARIABLE) or "so101")


def _limits(urdf: Path) -> dict[str, tuple[float, float]]:
    joints = {each.get("name"): each for each in ET.parse(urdf).getroot().findall("joint")}
    found = {}
    for name in JOINTS:
        joint = joints.get(name)
        limit, axis = (None, None) if joint is None else (joint.find("limit"), joint.find("axis"))
        if limit is None:
            raise ValueError(f"{urdf.name} has no joint {name} with a limit")
        if axis is None or axis.attrib["xyz"].split() != ["0", "0", "1"]:
            raise ValueError(f'{urdf.name}: joint {name} must turn about its own z: axis "0 0 1"')
        found[name] = float(limit.attrib["lower"]), float(limit.attrib["upper"])
    return found


def _angles(given: Any, names: tuple[str, ...], count: int) -> dict[str, Any]:
    """Tuples of ``count`` angles by name, from degrees."""
    if given and set(given) != set(names):
        raise ValueError(f"must give {', '.join(names)}; has {', '.join(given)}")
    rows = {name: tuple(math.radians(float(x)) for x in row) for name, row in given.items()}
    if any(len(row) != count for row in rows.values()):
        raise ValueError(f"each of {', '.join(names)} must be {count} angles in degrees")
    return rows
