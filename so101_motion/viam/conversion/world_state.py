"""Turn a request's WorldState, and the contacts it allows, into the planner's scene.

Obstacles stay where they are when the request comes. The physical object of a transform that is
attached to the tool is held: it moves along and may touch the hand.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import replace
from itertools import product

from viam.proto.common import Geometry, WorldState
from viam.proto.service.motion import CollisionSpecification

from so101_motion.common.attributes import suggest
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import FLOOR, HOLDERS, LINKS, Attached, Obstacle, Scene
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.frames import Frames
from so101_motion.viam.conversion.geometries import from_geometry

MOST_THINGS = 1_000
"""Most geometries of a request, and transforms. Chosen: 2,000 boxes take the planner seconds."""


async def scene_with(scene: Scene, world: WorldState | None, frames: Frames) -> Scene:
    """Add a request's world state to ``scene``."""
    if world is None:
        return scene
    bodies = [each for each in world.transforms if each.HasField("physical_object")]
    _refuse_many(len(world.transforms))
    _refuse_many(sum(len(group.geometries) for group in world.obstacles) + len(bodies))
    groups = [(each, await frames.T_base(each.reference_frame)) for each in world.obstacles]
    placed = [(each, await frames.T_base(each.reference_frame)) for each in bodies]
    held = {each.reference_frame for each in bodies if await frames.is_held(each.reference_frame)}

    def built() -> Scene:
        names = UniqueNames(taken_in(scene))
        obstacles, attached = list(scene.obstacles), list(scene.attached)
        for group, T_base_frame in groups:
            obstacles += [_obstacle(names, entry, T_base_frame) for entry in group.geometries]
        for transform, T_base_frame in placed:
            frame = transform.reference_frame
            thing = _obstacle(names, transform.physical_object, T_base_frame, frame)
            if frame in held:
                T_tool_object = frames.tool.inverse @ thing.T_base_obstacle
                held_thing = Attached(
                    name=thing.name, shape=thing.shape, T_tool_object=T_tool_object
                )
                attached.append(held_thing)
            else:
                obstacles.append(thing)
        return replace(scene, obstacles=tuple(obstacles), attached=tuple(attached))

    return await asyncio.to_thread(built)  # thousands take a second; the loop answers Stop


def _refuse_many(count: int) -> None:
    if count > MOST_THINGS:
        raise ConfigError(
            "world_state",
            f"{count} geometries",
            f"are more than the {MOST_THINGS} that are planned around; leave out what the arm"
            " cannot reach, or send a point cloud",
        )


async def allowing(scene: Scene, specifications: CollisionSpecification, frames: Frames) -> Scene:
    """``scene`` with the contacts that a request allows.

    A part of the arm is called ``<arm>:<part>``. The name of the arm means all its parts; the name
    of a gripper, or of anything else attached to the tool, means the hand.
    """
    if len(specifications.allows) > MOST_THINGS:
        given = f"{len(specifications.allows)} pairs"
        reason = f"are more than the {MOST_THINGS} that are read"
        raise ConfigError("collision_specification", given, reason)
    pairs = set(scene.may_touch)
    things = {FLOOR, *(o.name for o in scene.obstacles), *(a.name for a in scene.attached)}
    for allow in specifications.allows:
        first, second = [await _bodies(n, things, frames) for n in (allow.frame1, allow.frame2)]
        pairs.update(frozenset(pair) for pair in product(first, second) if len(set(pair)) == 2)
    return replace(scene, may_touch=frozenset(pairs))


async def _bodies(name: str, things: set[str], frames: Frames) -> tuple[str, ...]:
    """The planner's names of the bodies that Viam calls ``name``."""
    if name in things:
        return (name,)
    group = tuple(each for each in things if each.startswith((f"{name}:", f"{name} (")))
    component, _, part = name.partition(":")
    part = part.removesuffix("_link").replace("_", " ")
    if component == frames.arm:
        return (part,) if part in LINKS else LINKS
    if await frames.is_held(component):
        return (*HOLDERS, *group)
    if group:  # the geometries of a component
        return group
    raise ConfigError("collision_specification", name, suggest(name, (frames.arm, *things)))


def _obstacle(
    names: UniqueNames, entry: Geometry, T_base_frame: SE3, default: str = ""
) -> Obstacle:
    has_centre = entry.HasField("center")
    centre = convert.from_pose(entry.center) if has_centre else SE3.identity()
    return Obstacle(
        name=names.new(entry.label or default),
        shape=from_geometry(entry),
        T_base_obstacle=T_base_frame @ centre,
    )


def taken_in(scene: Scene) -> set[str]:
    """The names of everything in a scene, the arm's own links and the floor included."""
    held = (each.name for each in scene.attached)
    return {FLOOR, *LINKS, *held, *(each.name for each in scene.obstacles)}


class UniqueNames:
    """Makes names unique; labels may be missing, and repeated except through viam-server."""

    def __init__(self, taken: Iterable[str]) -> None:
        self._taken = set(taken)
        self._last: dict[str, int] = {}

    def new(self, wanted: str) -> str:
        base, name = wanted or "obstacle", wanted or "obstacle 1"
        number = self._last.get(base, 1)
        while name in self._taken:
            number += 1
            name = f"{base} {number}"
        self._last[base] = number
        self._taken.add(name)
        return name
