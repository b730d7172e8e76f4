"""Find the step nearest to a wanted one that keeps linear bounds: ``x`` with ``G x >= least``.

The most violated bound becomes active, and active bounds with negative multipliers leave again (a
dual active set method, as that of D. Goldfarb and A. Idnani, 1983, without its factor updates:
there are few rows, and one or two rounds are mostly enough). The compiled library does it
(``native/within.c``).
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.native.library import native

MOST = 8
"""At most so many bounds are used, those with the least room; chosen, and the same in C."""

_ROOM = 64
"""Up to so many bounds need no new memory; chosen."""


class BoundedStep:
    """Finds the step nearest to a wanted one. Belongs to one thread."""

    def __init__(self) -> None:
        self._make_room(_ROOM)

    def nearest(self, step: Array, bounds: Sequence[Array]) -> tuple[Array | None, Sequence[int]]:
        """Find the step nearest to ``step`` that keeps the bounds, and which bounds are active.

        Args:
            step: The wanted step, shape (5,).
            bounds: Arrays of shape (k, 7). Each bound has five factors of the step, the smallest
                value of their product, and the room it leaves; those with the least room are used.

        Returns:
            The step and the numbers of the active bounds, counted through all arrays. ``step``
            itself if no bound is active; None if no step is found.
        """
        n = sum(map(len, bounds))
        if n > len(self._bounds):
            self._make_room(n)
        self._step[:], n = step, 0
        for each in bounds:
            self._bounds[n : n + len(each)] = each
            n += len(each)
        found = native().library.so101_nearest_within(self._address, n)
        if found == 0:
            return step, ()
        active = list(map(int, self._active[: abs(found)].tolist()))
        return (self._step.copy() if found > 0 else None), active

    def _make_room(self, bounds: int) -> None:
        given = np.zeros(5 + MOST + 7 * bounds)
        self._step, self._active = given[:5], given[5 : 5 + MOST]
        self._bounds = given[5 + MOST :].reshape(-1, 7)
        self._address = ctypes.c_void_p(given.ctypes.data)
