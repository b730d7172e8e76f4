"""Show that no path exists, so that a search for one can end.

What can be reached from an end is filled with cells (``native/flood.c``). If the cells end before
they meet the other end, there is no path. They are cells of the first three joints, with any wrist,
from either end. Cells of all joints said no of 3 of 400 solvable problems, and are not used.

Cells are checked at their middles only, so this is no strict proof. But the margins there are
smaller than a path's, and smaller cells in other places must end as well.
``benchmarks/bench_no_path.py`` holds it against solvable problems with gaps that are 2 mm wider
than what must pass.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.native.library import native
from so101_motion.planning.collision.batch_check import LineCheck, pointer
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import MARGIN
from so101_motion.planning.paths.compiled_search import Deadline, Space

JOINTS = 3  # number of joints, from the base, that a cell has; the others may stand anywhere

STEP, SMALLER, SHIFT = 0.014, 0.75, 0.37
"""Edge of a cell, as motion of the arm's furthest point [m], the share of it that smaller cells
have, and how far those are shifted, as a share of theirs. Chosen with the next two by
bench_no_path."""

KEPT = 1.0 / 3.0  # share of the margin (of the default at most) that a cell must keep
LAST = 0.15, 0.30  # spacing of wrist and roll tried for cells of the first joints [rad]
CONFIRMED = 1_000_000  # most configurations that are checked for the smaller cells; 0.5 s
_CLOSED = 1


class Closed(NamedTuple):
    """The space that can be reached from an end."""

    at_start: bool  # whether that is the start
    rim: Array  # configurations around it that are blocked, shape (n, 5), [rad]


class Infeasibility:
    """Tries to show that no path leads from a start to any of several goals, all free."""

    def __init__(
        self,
        space: Space,
        collision: CollisionModel,
        q_jaw: float,
        q_start: Array,
        goals: Sequence[Array],
    ) -> None:
        less = -(1.0 - KEPT) * min(collision.margin, MARGIN)
        self._check = collision.sampled_check(q_jaw, spacing=1.0, extra=less)
        start, ends = np.array([q_start], dtype=float), np.array(goals, dtype=float)
        make = partial(_Flood, space, self._check)
        ways = ((False, (ends, start)), (True, (start, ends)))
        kinds = [(partial(make, JOINTS, *each), is_start) for is_start, each in ways]
        self._left = [(make(1.0, 0.0), make, is_start) for make, is_start in kinds]

    def look(self, deadline: Deadline, most: int, rim: int) -> Closed | None:
        """Check up to ``most`` configurations in all from each end; None if that shows nothing.

        ``most`` includes those of earlier calls; ``rim`` bounds how many of the rim are returned.
        """
        for each in tuple(self._left):
            flood, again, is_start = each
            with self._check.until(deadline.has_passed):
                if flood.run(most) != _CLOSED:
                    continue
                if again(SMALLER, SHIFT).run(CONFIRMED) == _CLOSED:
                    return Closed(is_start, flood.rim(rim))
            self._left.remove(each)
        return None


class _Flood:
    def __init__(
        self,
        space: Space,
        check: LineCheck,
        joints: int,
        roots: Array,
        ends: Array,
        part: float,
        shift: float,
    ) -> None:
        self._library, self._checkers = native().library, check.checkers
        wrist, roll = (
            np.linspace(low, high, 1 + int(np.ceil((high - low) / spacing)))
            for low, high, spacing in zip(space.lower[3:], space.upper[3:], LAST, strict=True)
        )
        grid = np.stack(np.meshgrid(wrist, roll), axis=-1).reshape(-1, 2)
        # In an order in which a free place is soon met.
        grid = np.random.default_rng(0).permutation(grid)
        places = np.concatenate([roots[:, 3:], grid])
        size = part * STEP / space.weights
        given = np.concatenate([size, roots[0] + shift * size, space.lower, space.upper])
        handle = self._library.so101_flood_new(
            check.arms[0].batch.scene, joints, *(pointer(each) for each in given.reshape(4, 5)),
            pointer(roots), len(roots), pointer(ends), len(ends), pointer(places), len(places),
        )  # fmt: skip
        if not handle:
            raise MemoryError("no memory for the cells around an end")
        self._flood = ctypes.c_void_p(handle)
        weakref.finalize(self, self._library.so101_flood_free, self._flood)

    def run(self, most: int) -> int:
        most_in_all = ctypes.c_long(most)
        return int(self._library.so101_flood_run(self._flood, self._checkers, most_in_all))

    def rim(self, most: int) -> Array:
        rim = np.empty((most, 5))
        return rim[: self._library.so101_flood_rim(self._flood, most, pointer(rim))]
