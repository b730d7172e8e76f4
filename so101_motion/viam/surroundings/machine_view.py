"""The machine's bodies and frames at one moment, seen from one arm."""

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

    component: str
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
