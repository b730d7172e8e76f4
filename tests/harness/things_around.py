"""A cube under an arm's open fingers, and the two poses between which it can be lifted."""

import numpy as np

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import FLOOR_Z, Box, Obstacle, Scene
from so101_motion.planning.kinematics.model import RobotModel

DOWN = np.radians([-5.0, -0.35, 29.0, 61.35, 0.0])
UP = np.radians([-5.0, -7.9, 11.5, 86.4, 0.0])
"""The fingers point down, their tips 9 mm over the table and 60 mm higher."""

_MODEL = RobotModel.load()


def hand(q):
    return _MODEL.frame(q, "gripper_link")


def under(q, size, *, beside=0.007, height=None):
    """A pose on the table under the fingers.

    ``beside`` is from the fixed finger to the thing's side.
    """
    T = hand(q) @ SE3.from_translation((-0.0078 + beside + size[0] / 2.0, 0.0, -0.09))
    return SE3(T.R, [*T.p[:2], FLOOR_Z + (size[2] if height is None else height) / 2.0])


def cube(edge=0.025, mass=0.03, *, beside=0.007, name="cube"):
    size = np.full(3, edge)
    T = under(DOWN, size, beside=beside)
    return Obstacle(name=name, shape=Box(size=size), T_base_obstacle=T, mass=mass)


def around(*obstacles):
    return Scene(obstacles=obstacles)
