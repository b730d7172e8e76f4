"""Number the cubes of a grid, so that points in the same cube are found by sorting."""

from __future__ import annotations

from typing import Any

import numpy as np

from so101_motion.common.geometry import Array

_MIDDLE = 32_768
"""Cubes are counted from here in each direction, so that none has a negative number; see
``scene.CUBES``."""

PLACES = np.array([(2 * _MIDDLE) ** 2, 2 * _MIDDLE, 1])
"""Difference of the numbers of neighbouring cubes along x, y, z."""


def cube_numbers(points: Array, edge: float) -> Any:
    """The number of the cube of ``edge`` [m] that holds each point (n, 3) [m], shape (n,)."""
    return (np.floor(points / edge).astype(np.int64) + _MIDDLE) @ PLACES


def cube_middles(numbers: Any, edge: float) -> Array:
    """The middles of cubes of ``edge`` [m] by their numbers (n,), shape (n, 3), [m]."""
    return np.asarray((numbers[:, None] // PLACES % (2 * _MIDDLE) - _MIDDLE + 0.5) * edge)
