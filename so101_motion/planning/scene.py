"""What is around the arm and in its hand, as plain values.

A ``Scene`` is part of a request for a plan. It holds no clever state: it can be compared, pickled
and written to a file, and ``collision.py`` turns it into what is checked. Metres and radians, in
the base frame of the arm or, for what the gripper holds, in the tool frame.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from so101_motion.errors import ConfigError
from so101_motion.geometry import SE3, Array, frozen_array

FLOOR = "floor"
"""The name of the floor in messages."""

FLOOR_Z = -0.0024
"""Height of the table in the base frame [m]: the underside of the base plate, from the official
model's lowest point."""

MARGIN = 0.003
"""How far bodies must stay apart at every posture looked at [m]. Chosen: what the printed parts,
their backlash (about 1 deg) and cables may add near the body, and small enough for tight poses."""

LARGEST = 100.0
"""Largest size and distance of anything [m]; more was meant as millimetres."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Box:
    """A box around its own origin.

    Attributes:
        size: Edge lengths along x, y, z, shape (3,), [m].
    """

    size: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", _lengths("size", self.size, (3,)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere:
    """A ball around its own origin.

    Attributes:
        radius: [m].
    """

    radius: float

    def __post_init__(self) -> None:
        _lengths("radius", self.radius, ())


@dataclass(frozen=True, slots=True, kw_only=True)
class Capsule:
    """A cylinder along z with round ends, around its own origin.

    Attributes:
        radius: Of the cylinder and the ends [m].
        length: From tip to tip [m], at least twice the radius.
    """

    radius: float
    length: float

    def __post_init__(self) -> None:
        _lengths("radius", self.radius, ())
        _lengths("length", self.length, ())
        if self.length < 2.0 * self.radius:
            raise ConfigError(
                "length", self.length, f"a capsule is at least {2.0 * self.radius:g} m from tip to"
                " tip, twice its radius; give a longer one, or a sphere"
            )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mesh:
    """A surface of triangles.

    Attributes:
        vertices: Shape (n, 3), [m].
        triangles: Indices of vertices, shape (m, 3).
    """

    vertices: Array
    triangles: Array

    def __post_init__(self) -> None:
        vertices = _points("vertices", self.vertices)
        triangles = np.array(self.triangles, dtype=np.int64)
        if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0:
            raise ConfigError("triangles", triangles.shape, "must have shape (m, 3), m >= 1")
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            raise ConfigError(
                "triangles", int(triangles.max()), f"there are only {len(vertices)} vertices"
            )
        triangles.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointCloud:
    """Points that were seen, each a small cube of what is there.

    Attributes:
        points: Shape (n, 3), [m].
        resolution: Edge of the cube around each point [m].
    """

    points: Array
    resolution: float = 0.01

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", _points("points", self.points))
        _lengths("resolution", self.resolution, ())


Shape = Box | Sphere | Capsule | Mesh | PointCloud


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Obstacle:
    """Something the arm must not touch, or a zone it must keep out of.

    Attributes:
        name: What messages call it; different for each in a scene.
        shape: Its form.
        T_base_obstacle: Where it is.
        keep_out: Whether it is a zone of air. Nothing is different for planning; messages and
            pictures tell the two apart.
    """

    name: str
    shape: Shape
    T_base_obstacle: SE3
    keep_out: bool = False

    def __post_init__(self) -> None:
        _named(self.name)
        _placed(self.name, self.T_base_obstacle)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Attached:
    """Something the gripper holds, which moves with the tool.

    Attributes:
        name: What messages call it; different for each in a scene.
        shape: Its form.
        T_tool_object: Where it is in the hand.
        mass: [kg].
        may_touch: Names of bodies (links by their human names, obstacles, ``"floor"``) it may be
            in contact with, beside the gripper and the jaw that hold it.
    """

    name: str
    shape: Shape
    T_tool_object: SE3
    mass: float = 0.0
    may_touch: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        _named(self.name)
        _placed(self.name, self.T_tool_object)
        if not 0.0 <= self.mass < LARGEST:
            raise ConfigError("mass", self.mass, f'of "{self.name}" must be 0 to {LARGEST:g} kg')


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """Everything an arm may meet.

    Attributes:
        obstacles: What stands around it.
        attached: What it holds.
        floor_z: Height of the floor in the base frame [m]; None for no floor.
        margin: How far everything must stay apart [m].
        may_touch: Pairs of names that may be in contact.
    """

    obstacles: tuple[Obstacle, ...] = ()
    attached: tuple[Attached, ...] = ()
    floor_z: float | None = FLOOR_Z
    margin: float = MARGIN
    may_touch: frozenset[frozenset[str]] = frozenset()

    def __post_init__(self) -> None:
        if self.floor_z is not None and not abs(self.floor_z) <= LARGEST:
            raise ConfigError("floor_z", self.floor_z, "must be a finite height [m], or None")
        if not 0.0 < self.margin <= 0.1:
            raise ConfigError("margin", self.margin, "must be more than 0 and at most 0.1 m")
        names = [FLOOR, *(o.name for o in self.obstacles), *(a.name for a in self.attached)]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ConfigError("name", twice[0], "is there twice; each thing needs its own name")

    def with_obstacles(self, obstacles: Iterable[Obstacle]) -> Scene:
        """The same with further obstacles."""
        return replace(self, obstacles=(*self.obstacles, *obstacles))


def _named(name: str) -> None:
    if not name:
        raise ConfigError("name", name, "each thing needs a name, for messages to call it by")


def _placed(name: str, pose: SE3) -> None:
    if not (np.all(np.isfinite(pose.R)) and np.all(np.abs(pose.p) <= LARGEST)):
        raise ConfigError(
            "pose", pose.p.tolist(), f'"{name}" must be within {LARGEST:g} m; values are metres'
        )


def _lengths(key: str, value: object, shape: tuple[int, ...]) -> Array:
    lengths = frozen_array(value, shape)  # type: ignore[arg-type]  # whatever numpy can read
    if not np.all((lengths > 0.0) & (lengths <= LARGEST)):
        raise ConfigError(key, value, f"must be more than 0 and at most {LARGEST:g} m")
    return lengths


def _points(key: str, value: object) -> Array:
    points = frozen_array(value, (-1, 3))  # type: ignore[arg-type]
    if len(points) == 0 or not np.all(np.abs(points) <= LARGEST):
        raise ConfigError(
            key, points.shape, f"must be at least one finite point within {LARGEST:g} m"
        )
    return points
