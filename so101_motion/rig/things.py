"""Make the world of simulated and emulated things from a scene, and keep it up with its edits."""

from __future__ import annotations

import numpy as np

from so101_motion.common.geometry import SE3, Array
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
    things = Things((), RobotModel.load(), floor_z=scene.floor_z)
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
    from scipy.spatial import ConvexHull  # slow to import

    points = hull_points(read_shape(item.shape))
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    volumes = np.abs(np.linalg.det(corners - points.mean(axis=0)))
    middles = (corners.sum(axis=1) + points.mean(axis=0)) / 4.0
    com = volumes @ middles / volumes.sum()
    normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
    feet = com - (normals @ com + offsets)[:, None] * normals  # below it, when it lies on each face
    lies = (feet @ normals.T + offsets <= 1e-6).all(axis=1)
    assert item.mass is not None
    return Thing(
        name=item.name,
        points=np.concatenate([points, _spread(corners)]),
        com=com,
        faces=normals[lies],
        mass=item.mass,
        T_base=item.T_base_obstacle,
        friction=friction,
    )


def _spread(triangles: Array) -> Array:
    """Points on triangles (n, 3, 3), at most ``_SPACING`` apart."""
    found = []
    for a, b, c in triangles:
        n = int(np.linalg.norm([b - a, c - a, c - b], axis=1).max() / _SPACING) + 2
        i, j = np.meshgrid(np.arange(n), np.arange(n))
        u, v = i[i + j < n] / (n - 1), j[i + j < n] / (n - 1)
        found.append(a + u[:, None] * (b - a) + v[:, None] * (c - a))
    points = np.concatenate(found)
    cells = (points / (0.5 * _SPACING)).round()  # thin triangles have many points close together
    return np.asarray(points[np.unique(cells, axis=0, return_index=True)[1]])


def _support(obstacle: Obstacle) -> Support:
    """The box around an obstacle, along its own axes."""
    _, points = held_shape(read_shape(obstacle.shape))
    low, high = points.min(axis=0), points.max(axis=0)
    T = obstacle.T_base_obstacle @ SE3.from_translation(0.5 * (low + high))
    return Support(size=high - low, T_base=T)
