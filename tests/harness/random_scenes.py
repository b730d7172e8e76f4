"""Random scenes: obstacles of every kind, and something in the hand."""

import numpy as np

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import (
    FLOOR_Z,
    Attached,
    Box,
    Capsule,
    Mesh,
    Obstacle,
    PointCloud,
    Scene,
    Sphere,
)


def obstacle(name, shape, at, **more):
    """What stands there without being turned; a shape that is three numbers is a box's size."""
    shape = Box(size=shape) if isinstance(shape, tuple) else shape
    return Obstacle(name=name, shape=shape, T_base_obstacle=SE3.from_translation(at), **more)


# On the way between these two stands a post.
POST = Scene(obstacles=(obstacle("post", (0.06, 0.06, 0.4), (0.28, 0.0, 0.2)),))
LEFT, RIGHT = np.array([0.8, 0.0, 0.2, 0.9, 0.0]), np.array([-0.8, 0.0, 0.2, 0.9, 0.0])


def random_shape(rng, size):
    kind = rng.integers(5)
    if kind == 0:
        return Box(size=rng.uniform(0.3, 1.0, 3) * size)
    if kind == 1:
        return Sphere(radius=0.5 * size)
    if kind == 2:
        return Capsule(radius=0.2 * size, length=size)
    points = rng.uniform(-0.5, 0.5, (12, 3)) * size
    if kind == 3:
        return Mesh(vertices=points, triangles=rng.permuted(np.arange(12)).reshape(-1, 3))
    return PointCloud(points=points, resolution=0.2 * size)


def random_pose(rng, lower, upper):
    return SE3.from_rpy(rng.uniform(-3.0, 3.0, 3), rng.uniform(lower, upper))


def random_scene(rng, margin=0.003, *, held=False, count=None):
    obstacles = tuple(
        Obstacle(
            name=f"thing {k}",
            shape=random_shape(rng, rng.uniform(0.03, 0.15)),
            T_base_obstacle=random_pose(rng, (-0.1, -0.4, 0.0), (0.45, 0.4, 0.45)),
        )
        for k in range(rng.integers(1, 7) if count is None else count)
    )
    attached = (
        Attached(
            name="tool",
            shape=random_shape(rng, rng.uniform(0.02, 0.08)),
            T_tool_object=random_pose(rng, (-0.02, -0.02, 0.08), (0.02, 0.02, 0.12)),
        ),
    )
    return Scene(
        obstacles=obstacles,
        attached=attached if held else (),
        floor_z=FLOOR_Z if rng.random() < 0.7 else None,
        margin=margin,
    )
