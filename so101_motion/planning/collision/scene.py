"""The scene: obstacles, held objects and the floor, as plain values.

A ``Scene`` is part of a request for a plan. It is a plain value: it can be compared, pickled and
written to a file; ``bodies.py`` turns it into bodies and pairs to check. Metres and radians, in the
base frame of the arm or, for held objects, in the tool frame.

Everything in a scene has its own name, the links of the arm included, so that a message can say
which two bodies would touch, and a scene which two may.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np
import so101_description
from numpy.typing import NDArray

from so101_motion.common.attributes import (
    ABOVE_ZERO,
    HEAVIEST,
    checked_kind,
    checked_number,
    suggest,
)
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import (
    LARGEST,
    SE3,
    Array,
    Brief,
    freeze,
    given_array,
    in_metres,
    pose,
)
from so101_motion.common.public import Public

FLOOR = "floor"  # the name of the floor in messages

LINKS = tuple(part.replace("_", " ") for part in so101_description.PARTS.values())
"""Names of the links of the arm in messages, from the base outwards."""

HOLDERS = frozenset({"gripper", "jaw"})  # they may touch what they hold
MOST_HELD = 24  # with the links, the bits of a mask
FLOOR_Z = -0.0024  # the table [m]: the underside of the official base plate

MARGIN = 0.003
"""Distance that bodies must keep at every checked configuration [m]. Chosen: the error of printed
parts, backlash (about 1 deg) and cables near the body, and small enough for tight poses."""

MARGIN_TOLERANCE = 0.2  # share of a margin that a motion beside its proven path may lack; chosen
SMALLEST_SEEN = 0.002
LARGEST_SEEN = 10.0  # larger things are in another unit [m]; chosen
FEW_POINTS = 10  # a cloud of fewer points may be a speck; chosen
CUBES = 32_000  # most cubes from a cloud's origin: octrees are 16 levels deep


class _Form(Brief):
    """Base class of shapes; has their fingerprint."""

    __slots__ = ("_fingerprint",)
    _fingerprint: bytes

    def fingerprint(self) -> bytes:
        """Bytes that differ for different shapes; cached, because a large shape takes 10 ms."""
        try:
            return self._fingerprint
        except AttributeError:
            known = hashlib.sha256(type(self).__name__.encode(), usedforsecurity=False)
            _add(known, *(getattr(self, each.name) for each in fields(self)))  # type: ignore[arg-type]  # a dataclass
            object.__setattr__(self, "_fingerprint", known.digest())
            return self._fingerprint


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Box(_Form):
    """A box around its own origin.

    Attributes:
        size: Edge lengths along x, y, z, shape (3,), [m]; 0 for a plate, a line or a point.
    """

    size: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", _lengths("size", self.size, (3,), least=0.0))
        if self.size.min() > 1.0:
            in_metres("size", self.size, LARGEST_SEEN)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere(_Form):
    """A ball around its own origin.

    Attributes:
        radius: [m]; 0 for a point.
    """

    radius: float

    def __post_init__(self) -> None:
        radius = in_metres("radius", _lengths("radius", self.radius, (), least=0.0), LARGEST_SEEN)
        object.__setattr__(self, "radius", float(radius))


@dataclass(frozen=True, slots=True, kw_only=True)
class Capsule(_Form):
    """A cylinder along z with round ends, around its own origin.

    Attributes:
        radius: Of the cylinder and the ends [m].
        length: From tip to tip [m], at least twice the radius.
    """

    radius: float
    length: float

    def __post_init__(self) -> None:
        for key in ("radius", "length"):
            object.__setattr__(self, key, _length(key, getattr(self, key)))
        if self.length < 2.0 * self.radius:
            raise ConfigError(
                "length", self.length, f"a capsule is at least {2.0 * self.radius:g} m from tip to"
                " tip, twice its radius; give a longer one, or a sphere"
            )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Mesh(_Form):
    """A surface of triangles; which way they face does not matter.

    What it encloses is solid (``solids.py``), unless the arm stands in it: then it is a room. A
    held mesh is replaced by its convex hull.

    Attributes:
        vertices: Shape (n, 3), [m].
        triangles: Indices of vertices, shape (m, 3).
    """

    vertices: Array
    triangles: NDArray[Any]

    def __post_init__(self) -> None:
        vertices = _points("vertices", self.vertices)
        try:
            with np.errstate(invalid="ignore"):  # compared below
                triangles = np.array(self.triangles, dtype=np.int64)
            if not np.array_equal(triangles, self.triangles):
                raise ValueError("not whole numbers")
        except (TypeError, ValueError, OverflowError) as error:
            raise ConfigError("triangles", self.triangles, "must be numbers of vertices") from error
        if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0:
            raise ConfigError("triangles", triangles.shape, "must have shape (m, 3), m >= 1")
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            outside = int(triangles.max() if triangles.min() >= 0 else triangles.min())
            raise ConfigError(
                "triangles", outside, f"is not a vertex; there are {len(vertices)}, counted from 0"
            )
        triangles.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PointCloud(_Form):
    """Points that a camera saw; each cube of a grid that holds a point is an obstacle.

    So is what the cubes enclose (``solids.py``). A held cloud is replaced by the convex hull of its
    cubes.

    Attributes:
        points: Shape (n, 3), [m].
        resolution: Edge of the cubes [m].
    """

    points: Array
    resolution: float = 0.01

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", _points("points", self.points))
        object.__setattr__(self, "resolution", _length("resolution", self.resolution))
        finest = float(np.abs(self.points).max()) / CUBES
        if self.resolution < finest:
            raise ConfigError(
                "resolution",
                self.resolution,
                f"is too fine for points so far from their origin; make it {finest:.2g} m or more",
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Cylinder(Mesh):
    """A cylinder along z with flat ends, around its own origin: a mesh whose sides contain it.

    Attributes:
        radius: [m].
        length: [m].
    """

    radius: float
    length: float
    vertices: Array = field(init=False, repr=False)
    triangles: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for key in ("radius", "length"):
            object.__setattr__(self, key, _length(key, getattr(self, key)))
        turns = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
        ring = self.radius / np.cos(np.pi / _SIDES) * np.array([np.cos(turns), np.sin(turns)])
        z = np.full(_SIDES, 0.5 * self.length)
        i, j = np.arange(_SIDES), np.roll(np.arange(_SIDES), -1)
        fan = np.array([[0, k, k + 1] for k in range(1, _SIDES - 1)])
        sides = [np.column_stack([i, j, j + _SIDES]), np.column_stack([i, j + _SIDES, i + _SIDES])]
        ends = [fan[:, ::-1], fan + _SIDES]
        vertices = np.concatenate([np.vstack([ring, -z]).T, np.vstack([ring, z]).T])
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", np.concatenate([*sides, *ends]))
        Mesh.__post_init__(self)


_SIDES = 32  # of a cylinder. Chosen: its corners stand out by 0.5 % of the radius

Shape = Box | Sphere | Capsule | Mesh | PointCloud


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShapeFile(_Form):
    """A mesh or a point cloud as an unread file; ``shape_files.py`` makes these and reads them.

    Attributes:
        kind: ``"ply"``, ``"stl"`` or ``"pcd"``.
        data: The bytes of the file; its lengths are metres.
        name: Its name in messages.
        centre: If the middle of a cloud's points is here, shape (3,), [m], it is subtracted from
            them; None to take them as they are.
    """

    kind: str
    data: NDArray[np.uint8]
    name: str
    centre: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Obstacle(Brief):
    """Something the arm must not touch, or a zone it must keep out of.

    Attributes:
        name: Its name in messages; unique in a scene.
        shape: Its shape.
        T_base_obstacle: Its pose.
        keep_out: Whether it is a zone of empty space. Planning treats both alike; messages and
            pictures tell them apart.
        mass: Its mass [kg], more than 0, if it is an item, which the gripper may take; None for
            all else. Until it is held it is an obstacle like any other.
    """

    name: str
    shape: Shape | ShapeFile
    T_base_obstacle: SE3
    keep_out: bool = False
    mass: float | None = None

    def __post_init__(self) -> None:
        _named(self.name)
        _place(self, "T_base_obstacle")
        refuse_odd_size(self.name, self.shape)
        if self.mass is not None:
            _weighed(self.name, self.mass)
            if self.keep_out or not self.mass:
                reason = "a zone is empty space" if self.keep_out else "an item weighs more"
                raise ConfigError("mass", self.mass, f'of "{self.name}" cannot be: {reason}')

    def is_same(self, other: Obstacle | None) -> bool:
        """Whether it is the other one, at the same place."""
        return (
            other is not None
            and (self.name, self.mass) == (other.name, other.mass)
            and self.shape.fingerprint() == other.shape.fingerprint()
            and np.allclose(self.T_base_obstacle.matrix, other.T_base_obstacle.matrix, atol=1e-9)
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Attached(Brief):
    """An object that the gripper holds; it moves with the tool.

    Attributes:
        name: Its name in messages; unique in a scene.
        shape: Its shape.
        T_tool_object: Its pose in the tool frame.
        mass: Its mass [kg].
        may_touch: Names of bodies (links by their human names, obstacles, ``"floor"``) it may
            touch, besides the gripper and the jaw that hold it.
        passed_to: The name of another arm whose gripper and jaw may touch it as well, because it
            takes the object; empty for none.
        fixed: Whether it is a part of a tool, which is never let go of.
        holder: The arm that holds it, in a scene that several share; else empty.
    """

    name: str
    shape: Shape | ShapeFile
    T_tool_object: SE3
    mass: float = 0.0
    may_touch: frozenset[str] = frozenset()
    passed_to: str = ""
    fixed: bool = False
    holder: str = ""

    def __post_init__(self) -> None:
        _named(self.name)
        _place(self, "T_tool_object", 2.0)
        refuse_odd_size(self.name, self.shape)
        _weighed(self.name, self.mass)


TCP_FRAME = "tcp"
"""The name of the frame at a tool's point, also in goals."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tool(Public):
    """What is fixed to the gripper for good: a camera on its mount, a pen, a longer finger.

    Attributes:
        name: What people call it.
        parts: Its bodies, as if they were held; they move with the tool frame, not with the jaw.
        frames: Its frames by name, in the tool frame; its point is ``TCP_FRAME``.
        source: Where its figures come from; empty if that is not told.
    """

    name: str
    parts: tuple[Attached, ...] = ()
    frames: Mapping[str, SE3]
    source: str = ""

    def on(self, scene: Scene) -> Scene:
        """``scene`` with this tool's parts; the same if it has them."""
        count = len(self.parts)
        if scene.attached[:count] == self.parts:
            return scene
        names = {part.name for part in self.parts}
        others = (each for each in scene.attached if each.name not in names)
        return replace(scene, attached=(*self.parts, *others))

    def off(self, scene: Scene) -> Scene:
        """``scene`` without this tool's parts."""
        left = tuple(each for each in scene.attached if each not in self.parts)
        return replace(scene, attached=left)


def as_seen_by(name: str, attached: tuple[Attached, ...]) -> tuple[Attached, ...]:
    """The objects an arm holds, with ``passed_to`` only for those passed to the arm ``name``."""
    if all(each.passed_to in ("", name) for each in attached):
        return attached
    return tuple(
        each if each.passed_to == name else replace(each, passed_to="") for each in attached
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class StandingArm(Brief):
    """Another SO-101 as an obstacle, at one or several configurations.

    Attributes:
        name: Its name in messages; unique in a scene.
        T_base_arm: Pose of its base.
        q: Its five joints and its jaw, shape (n, 6), n >= 1, [rad].
        attached: The objects it holds; those with a ``passed_to`` are passed to this scene's arm.
        room: Distance to keep from it beyond the margin [m].
    """

    name: str
    T_base_arm: SE3
    q: Array
    attached: tuple[Attached, ...] = ()
    room: float = 0.0

    def __post_init__(self) -> None:
        _named(self.name)
        _place(self, "T_base_arm")
        freeze(self, q=(-1, 6))

    def called(self, body: str) -> str:
        """The name of one of its links, or of an object it holds, in messages."""
        return f"{self.name}'s {body}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Scene(Brief):
    """The surroundings of an arm, and the objects it holds.

    Attributes:
        obstacles: The obstacles around it.
        arms: Other arms as obstacles.
        attached: The objects it holds.
        floor_z: Height of the floor in the base frame [m]; None for no floor.
        margin: Distance that all bodies must keep [m].
        may_touch: Pairs of names that may be in contact.
        digest: Equal for scenes that are equal, and different for others.
    """

    obstacles: tuple[Obstacle, ...] = ()
    arms: tuple[StandingArm, ...] = ()
    attached: tuple[Attached, ...] = ()
    floor_z: float | None = FLOOR_Z
    margin: float = MARGIN
    may_touch: frozenset[frozenset[str]] = frozenset()
    digest: bytes = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for key, kind in (("obstacles", Obstacle), ("attached", Attached)):
            given = getattr(self, key)
            if not (isinstance(given, list | tuple) and all(isinstance(e, kind) for e in given)):
                raise ConfigError(key, given, f"must be a tuple of {kind.__name__}(name=..., ...)")
            object.__setattr__(self, key, tuple(given))
        if self.floor_z is not None:
            in_metres("floor_z", np.array(checked_number("floor_z", self.floor_z, unit="m")))
        checked_number("margin", self.margin, lower=ABOVE_ZERO, upper=0.1, unit="m")
        if len(self.attached) > MOST_HELD:
            reason = f"are too many; {MOST_HELD} can be held at once: join some in one mesh"
            raise ConfigError("attached", f"{len(self.attached)} things", reason)
        self._check_names()
        object.__setattr__(self, "digest", _digest(self))

    def _check_names(self) -> None:
        names = {FLOOR, *LINKS}
        for name in (*(each.name for each in self.obstacles), *(e.name for e in self.attached)):
            if name in names:
                own = ", as part of the arm or its floor" if name in (FLOOR, *LINKS) else ""
                why = f"is there twice{own}; each thing needs its own name"
                raise ConfigError("name", name, why)
            names.add(name)
        for pair in self.may_touch:
            if len(pair) != 2:
                raise ConfigError("may_touch", sorted(pair), "must be the names of two things")
        wanted = {name for pair in self.may_touch for name in pair}
        wanted.update(name for held in self.attached for name in held.may_touch)
        unknown = sorted(wanted - names)
        if unknown:
            raise ConfigError(
                "may_touch",
                unknown[0],
                f"is not in this scene; there are {', '.join(sorted(names))}",
            )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Scene) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def called(self, name: str) -> str:
        """The name of a body as part of a sentence, such as ``"the wrist"``."""
        if name == FLOOR or name in LINKS:
            return f"the {name}"
        if any(name.startswith(each.called("")) for each in self.arms):
            return name
        zone = any(each.keep_out and each.name == name for each in self.obstacles)
        return f"the keep-out zone '{name}'" if zone else f"'{name}'"

    def with_obstacles(self, obstacles: Iterable[Obstacle]) -> Scene:
        """A copy with further obstacles."""
        return replace(self, obstacles=(*self.obstacles, *obstacles))

    @property
    def items(self) -> tuple[Obstacle, ...]:
        """What the gripper may take."""
        return tuple(each for each in self.obstacles if each.mass is not None)

    def taking(self, name: str, T_base_tool: SE3) -> Scene:
        """A copy in which the gripper holds an obstacle, which stays where it is.

        Args:
            name: The obstacle's name; ``ConfigError`` if there is none.
            T_base_tool: Where the tool is when it takes it.
        """
        item = one_named(name, self.obstacles)
        held = Attached(
            name=name,
            shape=item.shape,
            T_tool_object=T_base_tool.inverse @ item.T_base_obstacle,
            mass=item.mass or 0.0,
        )
        others = tuple(each for each in self.obstacles if each is not item)
        return replace(self, obstacles=others, attached=(*self.attached, held))

    def putting(self, name: str, T_base_item: SE3) -> Scene:
        """A copy in which what the gripper holds is an item at a pose.

        Args:
            name: The held object's name; ``ConfigError`` if there is none, or it is a tool's.
            T_base_item: Where it is put.
        """
        held = one_named(name, self.attached)
        if held.fixed:
            raise ConfigError("name", name, "is part of the tool and cannot be let go of")
        item = Obstacle(
            name=name, shape=held.shape, T_base_obstacle=T_base_item, mass=held.mass or None
        )
        others = tuple(each for each in self.attached if each is not held)
        return replace(self, obstacles=(*self.obstacles, item), attached=others)


def checked_scene(given: Scene) -> Scene:
    """A scene of a calling program; ``ConfigError`` for anything else."""
    return checked_kind("scene", given, Scene, "a Scene, such as Scene(obstacles=(post,))")


_T = TypeVar("_T", Obstacle, Attached)


def one_named(name: str, things: Iterable[_T]) -> _T:
    """The thing of that name; ``ConfigError`` if there is none."""
    named = {each.name: each for each in things}
    if name not in named:
        raise ConfigError("name", name, f"is not here; {suggest(name, named)}")
    return named[name]


def _named(name: str) -> None:
    if not isinstance(name, str) or not name:
        raise ConfigError("name", name, "each obstacle needs a name: messages use it")


def _weighed(name: str, mass: float) -> None:
    if checked_number(f"mass of {name}", mass, lower=0.0, unit="kg") > HEAVIEST:
        reason = (
            f"is more than {HEAVIEST:g} kg: did you mean grams? {mass:g} g is {mass / 1000:g} kg"
        )
        raise ConfigError(f"mass of {name}", mass, reason)


def _place(thing: Obstacle | Attached | StandingArm, key: str, most: float = LARGEST) -> None:
    """Check where a thing is; the matrix of a pose becomes an ``SE3``."""
    object.__setattr__(thing, key, pose(f"{key} of {thing.name}", getattr(thing, key), most))


def refuse_odd_size(name: str, shape: Shape | ShapeFile) -> None:
    """Refuse a thing under 2 mm or over 10 m in all directions: its unit is another one.

    A point (a sphere or box without a size) and a few points that were seen are no specks.
    """
    checked_kind(f"shape of {name}", shape, _Form, "a shape, such as Box(size=(x, y, z))")
    if isinstance(shape, ShapeFile):
        return  # when it is read
    if isinstance(shape, Mesh | PointCloud):
        points = shape.vertices if isinstance(shape, Mesh) else shape.points
        extent = np.ptp(points, axis=0)
        is_speck = isinstance(shape, Mesh) or len(points) >= FEW_POINTS
    elif isinstance(shape, Box):
        extent, is_speck = shape.size, bool(shape.size.any())
    else:
        extent = np.full(3, 2.0 * shape.radius)
        extent[2] = extent[2] if isinstance(shape, Sphere) else shape.length
        is_speck = shape.radius > 0.0
    if is_speck and extent.max() < SMALLEST_SEEN:
        reason = f'is the largest extent of "{name}"; is it in metres? add "scale": 1000'
        raise ConfigError("size", f"{1000.0 * extent.max():.3g} mm", reason)
    if extent.min() > LARGEST_SEEN:
        reason = f'is the smallest extent of "{name}"; is it in millimetres? add "scale": 0.001'
        raise ConfigError("size", f"{extent.min():.3g} m", reason)


def _length(key: str, value: object) -> float:
    return float(_lengths(key, value, ()))


def _lengths(key: str, value: object, shape: tuple[int, ...], least: float = ABOVE_ZERO) -> Array:
    lengths = _numbers(key, value, shape)
    if not np.all((lengths >= least) & (lengths <= LARGEST)):
        from_, most = "more than 0" if least else "0 or more", lengths.max()
        asks = f"; {most:g} m: did you mean millimetres?" if LARGEST < most < np.inf else ""
        reason = f"must be {from_} and at most {LARGEST:g} m{asks}"
        raise ConfigError(key, lengths.tolist(), reason)
    return lengths


def _numbers(key: str, value: object, shape: tuple[int, ...]) -> Array:
    return given_array(key, value, shape, f"length{'s' if shape else ''} in metres")  # type: ignore[arg-type]  # any


def _points(key: str, value: object) -> Array:
    points = _numbers(key, value, (-1, 3))
    if len(points) == 0 or not np.all(np.abs(points) <= LARGEST):
        raise ConfigError(
            key, points.shape, f"must be at least one finite point within {LARGEST:g} m; if lengths"
            ' are in millimetres where metres are expected, add "scale": 0.001'
        )  # fmt: skip
    return points


def _digest(scene: Scene) -> bytes:
    """A fingerprint of everything in a scene, in its order."""
    known = hashlib.sha256(usedforsecurity=False)

    def add_held(held: Attached) -> None:
        _add(known, "held", held.name, held.mass, sorted(held.may_touch), held.passed_to)
        _add(known, held.T_tool_object.R, held.T_tool_object.p, held.shape.fingerprint())

    _add(known, scene.floor_z, scene.margin, sorted(sorted(pair) for pair in scene.may_touch))
    for each in scene.obstacles:
        _add(known, "obstacle", each.name, each.keep_out, each.mass)
        _add(known, each.T_base_obstacle.R, each.T_base_obstacle.p, each.shape.fingerprint())
    for held in scene.attached:
        add_held(held)
    for arm in scene.arms:
        _add(known, "arm", arm.name, arm.T_base_arm.R, arm.T_base_arm.p, arm.q, arm.room)
        for held in arm.attached:
            add_held(held)
    return known.digest()


def _add(known: Any, *values: object) -> None:
    """Add values to a hash."""
    for value in values:
        if isinstance(value, np.ndarray):
            known.update(repr(value.shape).encode())
            known.update(np.ascontiguousarray(value).data)
        else:
            known.update(repr(value).encode() + b";")
