"""A Viam WorldState as the planner's scene.

Obstacles stand where they are when the request comes. The physical object of a transform belongs
to its frame: if that hangs from the tool, it is held and moves along, and it may touch the hand
that holds it; otherwise it is an obstacle.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

from viam.proto.common import Geometry, WorldState
from viam.proto.service.motion import CollisionSpecification

from so101_motion.config import suggest
from so101_motion.errors import ConfigError
from so101_motion.geometry import SE3
from so101_motion.models import convert
from so101_motion.models.frames import Frames
from so101_motion.models.geometries import from_geometry
from so101_motion.planning.scene import FLOOR, HOLDERS, LINKS, Attached, Obstacle, Scene


async def scene_with(scene: Scene, world: WorldState | None, frames: Frames) -> Scene:
    """``scene`` and what a request says is around.

    Args:
        scene: What is known of the surroundings.
        world: What the request says.
        frames: Where its frames are; knows its transforms already.

    Raises:
        ConfigError: Something cannot be meant, or its frame is not known.
    """
    if world is None:
        return scene
    names = _Names(scene)
    obstacles, attached = list(scene.obstacles), list(scene.attached)
    for group in world.obstacles:
        T_base_frame = await frames.T_base(group.reference_frame)
        obstacles += [_obstacle(names, entry, T_base_frame) for entry in group.geometries]
    for transform in world.transforms:
        if not transform.HasField("physical_object"):
            continue
        frame, entry = transform.reference_frame, transform.physical_object
        T_base_frame = await frames.T_base(frame)
        if await frames.is_held(frame):
            T_tool_frame = frames.tool.inverse @ T_base_frame
            attached.append(
                Attached(
                    name=names.new(entry.label or frame),
                    shape=from_geometry(entry),
                    T_tool_object=T_tool_frame @ _centre(entry),
                )
            )
        else:
            obstacles.append(_obstacle(names, entry, T_base_frame, frame))
    return replace(scene, obstacles=tuple(obstacles), attached=tuple(attached))


async def allowing(scene: Scene, specifications: CollisionSpecification, frames: Frames) -> Scene:
    """``scene`` with the contacts that a request allows.

    A part of the arm is called ``<arm>:<part>``; the name of the arm means all its parts, and that
    of a gripper or whatever else hangs from the tool means the hand.

    Args:
        scene: The surroundings, those of the request included.
        specifications: The pairs of frames that may touch.
        frames: The frames of the request.

    Raises:
        ConfigError: A name is neither a frame nor a thing in the scene.
    """
    pairs = set(scene.may_touch)
    for allow in specifications.allows:
        first, second = [await _bodies(n, scene, frames) for n in (allow.frame1, allow.frame2)]
        pairs.update(frozenset(pair) for pair in product(first, second) if len(set(pair)) == 2)
    return replace(scene, may_touch=frozenset(pairs))


async def _bodies(name: str, scene: Scene, frames: Frames) -> tuple[str, ...]:
    """What the planner calls the bodies that Viam calls ``name``."""
    things = {FLOOR, *(o.name for o in scene.obstacles), *(a.name for a in scene.attached)}
    if name in things:
        return (name,)
    component, _, part = name.partition(":")
    part = part.removesuffix("_link").replace("_", " ")
    if component == frames.arm:
        return (part,) if part in LINKS else LINKS
    if await frames.is_held(component):
        return tuple(HOLDERS)
    raise ConfigError("collision_specification", name, suggest(name, (frames.arm, *things)))


def _obstacle(names: _Names, entry: Geometry, T_base_frame: SE3, default: str = "") -> Obstacle:
    return Obstacle(
        name=names.new(entry.label or default),
        shape=from_geometry(entry),
        T_base_obstacle=T_base_frame @ _centre(entry),
    )


def _centre(entry: Geometry) -> SE3:
    return convert.from_pose(entry.center) if entry.HasField("center") else SE3.identity()


class _Names:
    """Names for things; viam-server allows several without a label, and any label at all."""

    def __init__(self, scene: Scene) -> None:
        self._taken = {
            FLOOR,
            *LINKS,
            *(o.name for o in scene.obstacles),
            *(a.name for a in scene.attached),
        }

    def new(self, wanted: str) -> str:
        base, name, number = wanted or "obstacle", wanted or "obstacle 1", 1
        while name in self._taken:
            number += 1
            name = f"{base} {number}"
        self._taken.add(name)
        return name
