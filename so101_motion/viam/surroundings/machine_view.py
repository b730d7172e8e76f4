"""What was read of the machine: its bodies and frames at one moment, seen from one arm."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import so101_description
from viam.proto.common import Transform

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import (
    FLOOR,
    LARGEST,
    LINKS,
    Attached,
    Mesh,
    Obstacle,
    Scene,
    Shape,
    ShapeFile,
)
from so101_motion.viam.conversion.frames import WORLD, Frames
from so101_motion.viam.conversion.world_state import UniqueNames, taken_in
from so101_motion.viam.surroundings.frame_tree import FrameTree

_SAME = 1.5e-3
"""Who has moved less is taken to stand where it stood [m]. Chosen: a tick or two of a servo that
holds move its tool by that much, and the planner keeps 3 mm from everything."""

_LEVER = 0.2
"""How far what turns with a frame is from it [m]; chosen, twice the length of a gripper."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """One thing of the machine.

    Attributes:
        component: The component it belongs to.
        name: What messages call it; more than one thing may have it.
        shape: Its form.
        T: Where it is: in the base frame of the arm, of what is held in its holder's tool frame.
        holder: The arm with whose tool it moves; empty if it stands.
    """

    component: str
    name: str
    shape: Shape | ShapeFile
    T: SE3
    holder: str = ""

    @property
    def held(self) -> bool:
        """Whether it moves with a tool."""
        return bool(self.holder)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MachineView:
    """The machine as it was at one moment, seen from one arm.

    Attributes:
        arm: The arm's short name.
        bodies: What stands around it and what it holds.
        tree: The frame system; None if nothing is known of it.
        ends: Where the ends of components with kinematics are in their origins.
        T_base_tool: Where the arm's tool is.
        T_links: Where its links are in its base frame, by their URDF names.
        read_again: Gives the machine as it is when it is called.
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
        """The frames of the machine, which nothing else may be called."""
        names = set() if self.tree is None else set(self.tree.parts)
        return {WORLD, *names, *(f"{name}_origin" for name in (*names, self.arm)), self.arm}

    def frames(self, transforms: Iterable[Transform] = ()) -> Frames:
        """The same frames, and those that ``transforms`` bring along.

        Raises:
            ConfigError: A transform is not valid.
        """
        if self.tree is None:
            return Frames(self.arm, self.T_base_tool, transforms)
        parents = {name: part.parent for name, part in self.tree.parts.items()}
        placed = self._placed
        return Frames(self.arm, self.T_base_tool, transforms, placed=placed, parents=parents)

    def _placed(self, frame: str) -> SE3 | None:
        """Where a frame of the machine is in the arm's base frame; None if it is not known."""
        tree = self.tree
        if tree is None or (frame != WORLD and not tree.has(frame)):
            return None
        part = tree.parts.get(frame)
        if part is not None and part.has_end and frame not in self.ends:
            return None  # nothing hangs from there, so it was not asked for
        return tree.T_world(f"{self.arm}_origin", self.ends).inverse @ tree.T_world(
            frame, self.ends
        )


def scene_around(scene: Scene, bodies: tuple[Body, ...]) -> Scene:
    """A scene with what the machine has added to it.

    Raises:
        ConfigError: Something cannot be planned with.
    """
    names = UniqueNames(taken_in(scene))
    obstacles, attached = list(scene.obstacles), list(scene.attached)
    for body in bodies:
        is_far = float(np.abs(body.T.p).max()) > LARGEST
        if is_far and not isinstance(body.shape, ShapeFile):
            continue  # no shape is larger, so this one cannot be met
        is_taken = body.name in (FLOOR, *LINKS)
        name = names.new(f"{body.name} (component)" if is_taken else body.name)
        if body.held:
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
    """Whether nothing that hangs there has moved by as much as ``distance`` [m]."""
    turned = float(np.linalg.norm(T.R - other.R)) * _LEVER
    return float(np.linalg.norm(T.p - other.p)) + turned < distance
