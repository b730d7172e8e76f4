"""Edit scenes: each function takes a scene and returns the changed one.

Renaming or removing a thing also updates references to it (``may_touch``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from itertools import count
from typing import Any

import numpy as np

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array
from so101_motion.files.user_storage import LONGEST_NAME, checked_name
from so101_motion.planning.collision.coal_shapes import hull_points
from so101_motion.planning.collision.scene import (
    FLOOR,
    FLOOR_Z,
    LINKS,
    Attached,
    Box,
    Capsule,
    Mesh,
    Obstacle,
    Scene,
    Shape,
    Sphere,
)
from so101_motion.planning.collision.shape_files import read_shape

Thing = Obstacle | Attached


NEW_SHAPES: dict[str, Shape] = {
    "box": Box(size=np.full(3, 0.04)),
    "sphere": Sphere(radius=0.02),
    "capsule": Capsule(radius=0.015, length=0.12),
}
"""Shapes that a button adds, by name; chosen: the jaws can take them."""

_DISTANCE, _APART = 0.26, 0.10
_ASIDE = tuple(math.radians(a) for a in (-35, 35, -60, 60, -85, 85, -110, 110, -10, 10))
"""Where a new thing goes: on an arc around the base [rad], aside of where the arm mostly is."""


def things(scene: Scene) -> tuple[Thing, ...]:
    return (*scene.obstacles, *scene.attached)


def thing_named(scene: Scene, name: str) -> Thing:
    """The thing of that name; ``ConfigError`` if it is not there."""
    for thing in things(scene):
        if thing.name == name:
            return thing
    raise ConfigError("name", name, "is not in the scene any more")


def pose_of(thing: Thing) -> SE3:
    """The pose of a thing: in the base frame, or in the tool's if it is held."""
    return thing.T_base_obstacle if isinstance(thing, Obstacle) else thing.T_tool_object


def holder_of(thing: Thing | None) -> str:
    """The arm that holds a thing; empty for none, and where there is only one arm."""
    return thing.holder if isinstance(thing, Attached) else ""


def moved(thing: Thing, pose: SE3) -> Thing:
    """A copy of a thing at another pose; the frame is as for ``pose_of``."""
    if isinstance(thing, Obstacle):
        return replace(thing, T_base_obstacle=pose)
    return replace(thing, T_tool_object=pose)


def with_thing(scene: Scene, changed: Thing) -> Scene:
    """``scene`` with ``changed`` in place of the thing of the same name and kind."""
    name = changed.name
    if isinstance(changed, Obstacle):
        obstacles = (changed if each.name == name else each for each in scene.obstacles)
        return replace(scene, obstacles=tuple(obstacles))
    attached = (changed if each.name == name else each for each in scene.attached)
    return replace(scene, attached=tuple(attached))


def resized(shape: Shape, **to: Any) -> Shape:
    """A shape with these dimensions [m], named as its own; those it does not have are ignored."""
    own = {each.name for each in fields(shape)}
    return replace(shape, **{name: value for name, value in to.items() if name in own})


def reshaped(thing: Thing, shape: Shape) -> Thing:
    """``thing`` with another shape. An obstacle's lowest point stays at its height."""
    changed = replace(thing, shape=shape)
    if isinstance(thing, Obstacle) and isinstance(changed, Obstacle):
        pose = thing.T_base_obstacle
        low = [
            float((hull_points(read_shape(each.shape)) @ pose.R[2]).min())
            for each in (thing, changed)
        ]
        return moved(changed, SE3.from_translation((0.0, 0.0, low[0] - low[1])) @ pose)
    return changed


def added(
    scene: Scene,
    shape: Shape,
    *,
    name: str,
    place: SE3 | None = None,
    held_at: Sequence[Array] = (),
) -> Scene:
    """``scene`` with one more obstacle, ``name`` and a number, where there is room on the floor.

    It is at ``place``, seen from the base, if that is known, and clear of things held at some
    points, shape (3,) each, [m].
    """
    floor = FLOOR_Z if scene.floor_z is None else scene.floor_z
    low, high = _extent(shape)
    z = floor + 0.001 - low  # a hair above, or it would flicker
    spots = [
        np.array([_DISTANCE * math.cos(a), _DISTANCE * math.sin(a), z + level * (high - low)])
        for level in range(4)
        for a in _ASIDE
    ]
    taken = [*(each.T_base_obstacle.p for each in scene.obstacles), *held_at]
    room = (p for p in spots if all(np.linalg.norm(p - other) > _APART for other in taken))
    place = place or SE3.from_translation(np.round(next(room, spots[0]), 3))
    return scene.with_obstacles(
        [Obstacle(name=free_name(scene, name), shape=shape, T_base_obstacle=place)]
    )


def free_name(scene: Scene, wanted: str) -> str:
    taken = {FLOOR, *LINKS, *(each.name for each in things(scene))}
    stem = without_blanks(wanted)[: LONGEST_NAME - 4] or "thing"
    return next(name for k in count(1) if (name := f"{stem} {k}") not in taken)


def without_blanks(name: str) -> str:
    return " ".join(name.split())


def renamed(scene: Scene, name: str, new: str) -> Scene:
    """``scene`` with a thing renamed; ``ConfigError`` if the name cannot be used."""
    new = checked_name(without_blanks(new), what="obstacle")
    thing_named(scene, name)
    if new != name and new in (FLOOR, *LINKS, *(each.name for each in things(scene))):
        raise ConfigError("name", new, "is taken; each thing needs its own name")
    return _called(scene, lambda each: new if each == name else each)


def without(scene: Scene, name: str) -> Scene:
    thing_named(scene, name)
    return _called(scene, lambda each: None if each == name else each)


def held(scene: Scene, name: str, T_base_tool: SE3, holder: str = "") -> Scene:
    """``scene`` with an obstacle attached where it is; ``ConfigError`` for a zone or a held one.

    The ``holder`` is an arm's name, or empty where there is only one.
    """
    thing = thing_named(scene, name)
    if not isinstance(thing, Obstacle):
        raise ConfigError("name", name, "is in the gripper already")
    if thing.keep_out:
        raise ConfigError("name", name, "is a keep-out zone, which cannot be held")
    taken = scene.taking(name, T_base_tool)
    *others, new = taken.attached
    return replace(taken, attached=(*others, replace(new, holder=holder)))


def let_go(scene: Scene, name: str, T_base_tool: SE3) -> Scene:
    """``scene`` with a held thing detached where it is; ``ConfigError`` if it is not held."""
    thing = thing_named(scene, name)
    if not isinstance(thing, Attached):
        raise ConfigError("name", name, "is not in the gripper")
    return scene.putting(name, T_base_tool @ thing.T_tool_object)


def _called(scene: Scene, call: Callable[[str], str | None]) -> Scene:
    """``scene`` with each name replaced by ``call(name)``, and removed where that is None."""

    def those(names: frozenset[str]) -> frozenset[str]:
        return frozenset(new for each in names if (new := call(each)) is not None)

    return replace(
        scene,
        obstacles=tuple(
            replace(each, name=new)
            for each in scene.obstacles
            if (new := call(each.name)) is not None
        ),
        attached=tuple(
            replace(each, name=new, may_touch=those(each.may_touch))
            for each in scene.attached
            if (new := call(each.name)) is not None
        ),
        may_touch=frozenset(pair for pair in map(those, scene.may_touch) if len(pair) == 2),
    )


def _extent(shape: Shape) -> tuple[float, float]:
    """The lowest and the highest z of a shape in its own frame [m]."""
    if isinstance(shape, Box):
        half = float(shape.size[2]) / 2.0
    elif isinstance(shape, Sphere):
        half = shape.radius
    elif isinstance(shape, Capsule):
        half = shape.length / 2.0
    else:
        z = (shape.vertices if isinstance(shape, Mesh) else shape.points)[:, 2]
        return float(z.min()), float(z.max())
    return -half, half
