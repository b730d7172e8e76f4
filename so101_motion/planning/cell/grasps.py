"""How a gripper may take hold of a thing: across two opposite sides of the box around it.

The jaws close along one axis of the box, from any other side, near its middle or near an end. Which
of these can be had, and do not run into the hand that holds the thing already, others decide.
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

THICKEST = 0.06
"""What the jaws can take between them at the most [m]; chosen, they open to 90 mm."""

DEEP = 0.015
"""How far the jaws reach into a thing at most, up to the place on the pad [m]; chosen."""

FROM_END = 0.012
"""How far from an end of a thing it is taken there [m]; chosen, the jaws are 20 mm wide."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grasp:
    """A way to take hold of a thing.

    Attributes:
        T_object_grip: Where the middle of the grip is on it: z along the approach, x across the
            jaws.
        thickness: How thick it is there [m].
    """

    T_object_grip: SE3
    thickness: float


def grasps_of(shape: Shape | ShapeFile) -> Iterator[Grasp]:
    """The ways to take hold of a thing by the box around it; none if it is too thick everywhere."""
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
