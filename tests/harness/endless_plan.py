"""A plan that is searched in vain until its time is up: a wall and a roof are in the way."""

import numpy as np

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Box, Obstacle, Scene

Q_START = np.radians([60.0, 0.0, 0.0, 0.0, 0.0])
Q_GOAL = -Q_START
SCENE = Scene(
    obstacles=tuple(
        Obstacle(name=name, shape=Box(size=size), T_base_obstacle=SE3.from_translation(at))
        for name, size, at in (
            ("wall", (0.6, 0.02, 1.2), (0.39, 0.0, 0.6)),
            ("roof", (1.0, 1.0, 0.02), (0.0, 0.0, 0.3)),
        )
    )
)
