"""Find the step nearest to a wanted one that keeps linear bounds: ``x`` with ``G x >= least``.

The most violated bound becomes active, and active bounds with negative multipliers leave again (a
dual active set method, as that of D. Goldfarb and A. Idnani, 1983, without its factor updates:
there are few rows, and one or two rounds are mostly enough). The compiled library does it
(``native/within.c``); without it, it is done here in plain numbers, with the same result.
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

_ROUNDS = 12  # as in C
_ROUNDING = 1e-9
_SINGULAR = 1e-15  # a pivot this small means that the rows are dependent [m^2]


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
        library = native().library
        if library is None:
            all_bounds = np.concatenate(bounds)
            near = np.argsort(all_bounds[:, 6], kind="stable")[:MOST]
            x, active = _nearest_within(step, all_bounds[near, :5], all_bounds[near, 5])
            return x, [int(near[i]) for i in active]
        n = sum(map(len, bounds))
        if n > len(self._bounds):
            self._make_room(n)
        self._step[:], n = step, 0
        for each in bounds:
            self._bounds[n : n + len(each)] = each
            n += len(each)
        found = library.so101_nearest_within(self._address, n)
        if found == 0:
            return step, ()
        active = list(map(int, self._active[: abs(found)].tolist()))
        return (self._step.copy() if found > 0 else None), active

    def _make_room(self, bounds: int) -> None:
        given = np.zeros(5 + MOST + 7 * bounds)
        self._step, self._active = given[:5], given[5 : 5 + MOST]
        self._bounds = given[5 + MOST :].reshape(-1, 7)
        self._address = ctypes.c_void_p(given.ctypes.data)


def _nearest_within(step: Array, G: Array, least: Array) -> tuple[Array | None, Sequence[int]]:
    gram: list[list[float]] = (G @ G.T).tolist()
    wanted: list[float] = (least - G @ step).tolist()  # what each row lacks, were nothing done
    active, lack, x = list[int](), wanted, step
    if not wanted:
        return step, active
    for _ in range(_ROUNDS):
        worst = max(range(len(lack)), key=lack.__getitem__)
        if lack[worst] <= _ROUNDING or worst in active:
            return x, active
        active.append(worst)
        while True:
            pulls = _solved([[*(gram[i][j] for j in active), wanted[i]] for i in active])
            if pulls is None:
                return None, active
            weakest = min(range(len(pulls)), key=pulls.__getitem__)
            if pulls[weakest] >= 0.0:
                break
            if len(active) == 1:  # there is no such step
                return None, active
            del active[weakest]
        x = step + pulls @ G[active]
        lack = (least - G @ x).tolist()
    return None, active


def _solved(rows: list[list[float]]) -> list[float] | None:
    """Solve a symmetric system, whose right side is the last column; None if it is singular."""
    n = len(rows)
    for i, row in enumerate(rows):
        if not row[i] > _SINGULAR:
            return None
        for below in rows[i + 1 :]:
            share = below[i] / row[i]
            for j in range(i, n + 1):
                below[j] -= share * row[j]
    found = [0.0] * n
    for i in range(n - 1, -1, -1):
        rest = sum(rows[i][j] * found[j] for j in range(i + 1, n))
        found[i] = (rows[i][n] - rest) / rows[i][i]
    return found
