"""The machine's frames and bodies at one moment, seen from one arm.

A component has two frames. ``<name>_origin`` is its configured pose in its parent; ``<name>`` is
the end of its kinematics, such as the tool of an arm, or the same frame if it has no kinematics. A
component attached to ``<name>`` moves with its joints, one attached to ``<name>_origin`` does not.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import so101_description
from viam.proto.common import Geometry, Transform
from viam.proto.robot import FrameSystemConfig

from so101_motion.common.attributes import suggest
from so101_motion.common.errors import ConfigError, SurroundingsUnknown, clipped
from so101_motion.common.geometry import LARGEST, SE3
from so101_motion.planning.collision.scene import (
    FLOOR,
    LINKS,
    Attached,
    Mesh,
    Obstacle,
    Scene,
    Shape,
    ShapeFile,
)
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.frames import LONGEST_CHAIN, WORLD, Frames
from so101_motion.viam.conversion.world_state import UniqueNames, taken_in

MOST_PARTS = 1_000  # most components of a frame system; chosen, larger machines have dozens

_ORIGIN = "_origin"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """One component in the frame system."""

    name: str
    parent: str
    T_parent_origin: SE3
    geometry: Geometry | None  # that of its frame's configuration
    has_end: bool  # it has kinematics, so its end may be elsewhere than its origin
    has_joints: bool  # that end moves
    kinematics: str  # the name in them; an arm of this module has its component's name there


class FrameTree:
    """The components of a frame system; one left out goes if its parent is missing."""

    def __init__(
        self, configs: Iterable[FrameSystemConfig], left_out: Collection[str] = ()
    ) -> None:
        self.parts: dict[str, Part] = {}
        for config in configs:
            part = _part(config)
            if part.name in self.parts:
                raise SurroundingsUnknown(
                    f'two components of the machine are called "{clipped(part.name, 80)}"',
                    component=part.name,
                    remedy='rename one, or give the remote machine that has it a "prefix"',
                )
            if len(self.parts) == MOST_PARTS:
                given = f"more than {MOST_PARTS} components"
                raise ConfigError("frame system", given, "are more than can be planned around")
            self.parts[part.name] = part
        for name in list(self.parts):
            try:
                for _ in self.above(name):
                    pass
            except ConfigError:
                if name not in left_out:
                    raise
                del self.parts[name]

    def has(self, frame: str) -> bool:
        """Whether ``frame`` is the frame or the origin of a component."""
        return frame in self.parts or frame.removesuffix(_ORIGIN) in self.parts

    def above(self, name: str) -> Iterator[tuple[str, bool]]:
        """The components that ``name`` is attached to, nearest first; True with one for its end."""
        frame, steps = self.parts[name].parent, 0
        while frame != WORLD:
            holder = frame if frame in self.parts else frame.removesuffix(_ORIGIN)
            if holder not in self.parts:
                hint = suggest(frame, self.parts)
                reason = f'has the parent "{frame}", which is not a frame; {hint}'
                raise ConfigError("frame", name, reason)
            steps += 1
            if steps > LONGEST_CHAIN:
                reason = f"is attached to itself, or has more than {LONGEST_CHAIN} parents"
                raise ConfigError("frame", name, reason)
            yield holder, frame in self.parts
            frame = self.parts[holder].parent

    def is_held(self, name: str, arm: str) -> bool:
        """Whether a component moves with the tool of ``arm``."""
        return (arm, True) in self.above(name)

    def ends_needed(self) -> set[str]:
        """The components with kinematics whose end has something attached."""
        return {
            holder
            for name in self.parts
            for holder, at_end in self.above(name)
            if at_end and self.parts[holder].has_end
        }

    def T_world(self, frame: str, ends: Mapping[str, SE3]) -> SE3:
        """The pose of a frame or origin; ``ends``: poses of components' ends in their origins."""
        if frame == WORLD:
            return SE3.identity()
        name = frame if frame in self.parts else frame.removesuffix(_ORIGIN)
        T = self.parts[name].T_parent_origin
        if frame in self.parts and frame in ends:
            T = T @ ends[frame]
        for holder, at_end in self.above(name):
            part = self.parts[holder]
            T = part.T_parent_origin @ (ends[holder] @ T if at_end and holder in ends else T)
        return T


def _part(config: FrameSystemConfig) -> Part:
    frame = config.frame
    name, seen = frame.reference_frame, frame.pose_in_observer_frame
    if not name or name == WORLD:
        raise ConfigError("frame", name, "is not the name of a component")
    try:
        T_parent_origin = convert.from_pose(seen.pose)
    except ConfigError as error:
        raise ConfigError(f"frame of {name}", error.value, error.reason) from error
    is_old = config.HasField("kinematics") and len(config.kinematics.fields) > 0
    has_end = is_old or config.HasField("model")
    joints = len(config.model.joints) if config.HasField("model") else 0
    fields = config.kinematics.fields
    name_there = fields["name"].string_value if "name" in fields else ""  # indexing would add one
    return Part(
        name=name,
        parent=seen.reference_frame or WORLD,
        T_parent_origin=T_parent_origin,
        geometry=frame.physical_object if frame.HasField("physical_object") else None,
        has_end=has_end,
        has_joints=joints > 0 or (is_old and _has_joints(config)),
        kinematics=config.model.name or name_there,
    )


def _has_joints(config: FrameSystemConfig) -> bool:
    """Whether kinematics given as a struct have joints; True if that cannot be read."""
    fields = config.kinematics.fields
    if "joints" not in fields:
        return "links" not in fields  # a model that is written in another way
    return fields["joints"].WhichOneof("kind") != "list_value" or bool(
        fields["joints"].list_value.values
    )


_SAME = 1.5e-3
"""Less motion than this counts as none [m]. Chosen: a tick or two of a holding servo move its tool
by that much, and the planner keeps 3 mm from everything."""

_LEVER = 0.2
"""Distance of a body from the frame that it turns with [m]; chosen, twice a gripper's length."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """A shape of a component of the machine.

    ``T`` is its pose in the arm's base frame, or, if it is held, in the tool frame of its
    ``holder``; that is empty if it stands. Names are for messages, and not always unique.
    """

    name: str
    shape: Shape | ShapeFile
    T: SE3
    holder: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MachineView:
    """The machine as it was at one moment, seen from one arm.

    ``ends`` has the poses of the ends of components with kinematics, in their origins; the tree is
    None if the frame system is not known.
    """

    arm: str
    bodies: tuple[Body, ...] = ()
    tree: FrameTree | None = None
    ends: Mapping[str, SE3]
    T_base_tool: SE3
    T_links: Mapping[str, SE3]
    read_again: Callable[[], Awaitable[MachineView]]

    @property
    def own_frames(self) -> set[str]:
        """The names of the machine's frames, which no other thing may have."""
        names = set() if self.tree is None else set(self.tree.parts)
        return {WORLD, *names, *(f"{name}_origin" for name in (*names, self.arm)), self.arm}

    def frames(self, transforms: Iterable[Transform] = ()) -> Frames:
        if self.tree is None:
            return Frames(self.arm, self.T_base_tool, transforms)
        parents = {name: part.parent for name, part in self.tree.parts.items()}
        placed = self._placed
        return Frames(self.arm, self.T_base_tool, transforms, placed=placed, parents=parents)

    def _placed(self, frame: str) -> SE3 | None:
        """The pose of a frame of the machine in the arm's base frame; None if it is not known."""
        tree = self.tree
        if tree is None or (frame != WORLD and not tree.has(frame)):
            return None
        part = tree.parts.get(frame)
        if part is not None and part.has_end and frame not in self.ends:
            return None  # nothing is attached there, so it was not read
        return tree.T_world(f"{self.arm}_origin", self.ends).inverse @ tree.T_world(
            frame, self.ends
        )


def scene_around(scene: Scene, bodies: tuple[Body, ...]) -> Scene:
    names = UniqueNames(taken_in(scene))
    obstacles, attached = list(scene.obstacles), list(scene.attached)
    for body in bodies:
        is_far = float(np.abs(body.T.p).max()) > LARGEST
        if is_far and not isinstance(body.shape, ShapeFile):
            continue  # no shape is larger, so the arm cannot reach this one
        is_taken = body.name in (FLOOR, *LINKS)
        name = names.new(f"{body.name} (component)" if is_taken else body.name)
        if body.holder:
            attached.append(Attached(name=name, shape=body.shape, T_tool_object=body.T))
        else:
            obstacles.append(Obstacle(name=name, shape=body.shape, T_base_obstacle=body.T))
    return replace(scene, obstacles=tuple(obstacles), attached=tuple(attached))


@cache
def link_hulls() -> dict[str, tuple[str, Mesh]]:
    """The hull of each link of an arm with the name of its part, by the link's URDF name."""
    hulls = {}
    for link, part in so101_description.PARTS.items():
        hull = so101_description.load_hull(part)
        mesh = Mesh(vertices=hull.vertices, triangles=hull.faces)
        hulls[link] = (part.replace("_", " "), mesh)
    return hulls


def nearly(T: SE3, other: SE3, distance: float = _SAME) -> bool:
    """Whether a body attached to the frame has moved by less than ``distance`` [m]."""
    turned = float(np.linalg.norm(T.R - other.R)) * _LEVER
    return float(np.linalg.norm(T.p - other.p)) + turned < distance
