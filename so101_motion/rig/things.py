"""Make the world of simulated and emulated things from a scene, and keep it up with its edits."""

from __future__ import annotations

from typing import Any

import numpy as np

from so101_motion.common.geometry import SE3
from so101_motion.drivers.things import FRICTION, Support, Thing, Things
from so101_motion.planning.collision.coal_shapes import held_shape, hull_points
from so101_motion.planning.collision.scene import Obstacle, Scene
from so101_motion.planning.collision.shape_files import read_shape
from so101_motion.planning.kinematics.model import RobotModel

_SPACING = 0.004  # of the points on a thing's surface [m]; chosen: a finger's tip is 5 mm wide


def things_in(scene: Scene, *, friction: float = FRICTION) -> Things:
    """The items of a scene as things that lie where it says; its other obstacles carry them.

    Args:
        scene: The scene.
        friction: Coefficient of friction between the fingers and each thing.
    """
    things = Things(RobotModel.load(), floor_z=scene.floor_z)
    keep_up(things, Scene(floor_z=scene.floor_z), scene, friction=friction)
    return things


def keep_up(things: Things, before: Scene, now: Scene, *, friction: float = FRICTION) -> None:
    """Do to the things what a person does who edits a scene: add, move, take away.

    What was held is left where it truly is: the scene says where the arm believes to have put it,
    or that it was lost.
    """
    known = {item.name: item for item in before.items}
    held = {each.name for each in before.attached}
    for item in now.items:
        if item.name not in things.names or not (
            item.name in held or item.is_same(known.get(item.name))
        ):
            things.put(_thing(item, friction))
    there = {item.name for item in now.items} | {each.name for each in now.attached}
    for name in known.keys() & set(things.names) - there:
        things.take_away(name)
    things.surround(
        now.floor_z,
        [_support(each) for each in now.obstacles if each.mass is None and not each.keep_out],
    )


def _thing(item: Obstacle, friction: float) -> Thing:
    """An item as its convex hull, of one density."""
    import trimesh  # slow to import

    hull = trimesh.convex.convex_hull(hull_points(read_shape(item.shape)))
    com, normals = hull.center_mass, hull.face_normals
    offsets = np.einsum("ij,ij->i", normals, hull.triangles[:, 0])
    feet = com + (offsets - normals @ com)[:, None] * normals  # below it, when it lies on each face
    lies = (feet @ normals.T <= offsets + 1e-6).all(axis=1)
    subdivide: Any = trimesh.remesh.subdivide_to_size
    spread, _ = subdivide(hull.vertices, hull.faces, _SPACING)
    cells = (spread / (0.5 * _SPACING)).round()  # thin triangles have many points close together
    _, apart = np.unique(cells, axis=0, return_index=True)
    assert item.mass is not None
    return Thing(
        name=item.name,
        points=np.concatenate([hull.vertices, spread[apart]]),
        com=com,
        faces=normals[lies],
        mass=item.mass,
        T_base=item.T_base_obstacle,
        friction=friction,
    )


def _support(obstacle: Obstacle) -> Support:
    """The box around an obstacle, along its own axes."""
    _, points = held_shape(read_shape(obstacle.shape))
    low, high = points.min(axis=0), points.max(axis=0)
    T = obstacle.T_base_obstacle @ SE3.from_translation(0.5 * (low + high))
    return Support(size=high - low, T_base=T)
