"""The arm as data: its URDF, its meshes, its collision hulls, and cheap readers for them.

It is the SO-101 unless ``robots.py`` is told of another kind of arm.

Nothing here computes kinematics or collisions, and nothing but numpy is imported. The ``make_*``
scripts that wrote the data live in the same folder and need the development dependencies; README.md
says where every figure comes from.
"""

import itertools
import json
from pathlib import Path
from typing import Final

from .mesh_readers import Surface, TriangleMesh, read_glb
from .robots import Robot, RobotFileError, chosen_robot, load_robot

__all__ = [
    "GROUND",
    "MARKERS",
    "MESH_DIR",
    "PARTS",
    "ROBOT",
    "TOOLS_PATH",
    "URDF_PATH",
    "Robot",
    "RobotFileError",
    "Surface",
    "TriangleMesh",
    "load_allowed_pairs",
    "load_hull",
    "load_robot",
    "load_visual",
]

_HERE: Final = Path(__file__).resolve().parent

ROBOT: Final = chosen_robot()
"""The kind of arm of this process."""

URDF_PATH: Final = ROBOT.urdf
MESH_DIR: Final = _HERE / "meshes"
TOOLS_PATH: Final = _HERE / "tools.json"

PARTS: Final[dict[str, str]] = {
    "base_link": "base",
    "shoulder_link": "shoulder",
    "upper_arm_link": "upper_arm",
    "lower_arm_link": "lower_arm",
    "wrist_link": "wrist",
    "gripper_link": "gripper",
    "moving_jaw_so101_v1_link": "jaw",
}
"""The name under which a link's meshes are stored, in order from the base outwards."""

_LINKS: Final = {part: link for link, part in PARTS.items()}

GROUND: Final = "ground"
"""The name of the table under the arm in pairs of links."""

MARKERS: Final = ("axes", "leader_body", "leader_trigger")
"""Meshes that belong to no link: the tool marker and the leader's handle."""


def load_visual(part: str) -> tuple[Surface, ...]:
    """Read the visual mesh of a part.

    Args:
        part: A value of ``PARTS`` or one of ``MARKERS``.

    Returns:
        One surface per material, in the part's link frame.

    Raises:
        ValueError: No such part.
    """
    known = (*PARTS.values(), *MARKERS)
    if part not in known:
        raise ValueError(f"no part {part!r}; known: {', '.join(known)}")
    return read_glb(MESH_DIR / f"{part}.glb") if part in MARKERS else ROBOT.visual(_LINKS[part])


def load_hull(part: str) -> TriangleMesh:
    """Read the convex hull that stands for a link in collision checks.

    It contains everything known of the official part; see README.md.

    Args:
        part: A value of ``PARTS``.

    Returns:
        The hull, in the link's frame.

    Raises:
        ValueError: No such part.
    """
    if part not in PARTS.values():
        raise ValueError(f"no part {part!r}; known: {', '.join(PARTS.values())}")
    return ROBOT.hull(_LINKS[part])


def load_allowed_pairs() -> frozenset[frozenset[str]]:
    """Read the pairs of links that a collision check may leave out.

    Returns:
        Pairs of link names (or ``GROUND``): those that touch by design, and those whose hulls
        never met in the samples of ``make_allowed_pairs.py``.
    """
    if ROBOT.allowed_pairs is None:
        links = list(PARTS)
        return frozenset(frozenset(pair) for pair in itertools.pairwise(links))
    rows = json.loads(ROBOT.allowed_pairs.read_text(encoding="utf-8"))["pairs"]
    return frozenset(frozenset((row["first"], row["second"])) for row in rows if row["allowed"])
