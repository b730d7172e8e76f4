"""List grasps of an object: the jaws close across two opposite sides of the box around it.

The jaws close along one axis of the box, from any other side, near its middle or near an end.
``handover.py`` decides which of these can be reached and keep off the hand that holds the object.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.coal_shapes import held_shape
from so101_motion.planning.collision.scene import Shape, ShapeFile
from so101_motion.planning.collision.shape_files import read_shape

THICKEST = 0.06  # thickest object that is grasped [m]; chosen: the jaws open to 90 mm
DEEP = 0.015  # largest distance from the object's edge to the middle of the grip [m]; chosen
FROM_END = 0.012  # distance of a grasp from the object's end [m]; chosen: jaws are 20 mm wide


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grasp:
    """A grasp of an object."""

    # the middle of the grip in the object's frame: z along the approach, x across the jaws
    T_object_grip: SE3
    thickness: float  # the object's thickness there [m]


def grasps_of(shape: Shape | ShapeFile) -> Iterator[Grasp]:
    """The grasps of an object by the box around it; none if it is too thick everywhere."""
    _, points = held_shape(read_shape(shape))
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    for across, along, aside in permutations(range(3)):
        if 2.0 * half[across] > THICKEST:
            continue
        reach = half[along] - min(DEEP, half[along])
        end = half[aside] - FROM_END
        offsets = (0.0, end, -end) if end > FROM_END else (0.0,)
        for sign, flip, offset in product((1.0, -1.0), (1.0, -1.0), offsets):
            p = middle.copy()
            p[along] += sign * reach
            p[aside] += offset
            x, z = flip * _unit(across), -sign * _unit(along)
            R = np.column_stack([x, np.cross(z, x), z])
            yield Grasp(T_object_grip=SE3(R, p), thickness=2.0 * float(half[across]))


def _unit(axis: int) -> Array:
    return np.asarray(np.eye(3)[axis])
