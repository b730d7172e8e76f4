"""The search and the shortening of the compiled library, in the form of ours.

``native/search.c`` does what ``rrt_connect.py`` and ``shorten.py`` do, with the same checks and
random numbers of its own: the same request and seed give the same path on every machine with the
library, another one without it.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from math import ceil, dist

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.batch_check import BatchSampledCheck, pointer
from so101_motion.planning.paths.rrt_connect import Deadline, Space, Tree
from so101_motion.planning.paths.shorten import CUTS, PIECE


class CompiledSearch:
    """``TreeSearch``, compiled.

    Args:
        space: Where configurations are drawn from.
        checker: What is free.
        q_start: A free configuration, shape (5,), [rad].
        goals: Free configurations, at least one, each of shape (5,), [rad].
        random: The source of its seed.
    """

    def __init__(
        self,
        space: Space,
        checker: BatchSampledCheck,
        q_start: Array,
        goals: Sequence[Array],
        random: np.random.Generator,
    ) -> None:
        self._space, self._checker, self._random = space, checker, random
        self._library = checker.batch.library
        self._roots = (1, len(goals))
        at = [
            np.ascontiguousarray(each, dtype=np.float64)
            for each in (space.lower, space.upper, space.weights, q_start, goals)
        ]
        self._library.so101_search_new.restype = ctypes.c_void_p
        handle = self._library.so101_search_new(*map(pointer, at), len(goals), seed_of(random))
        if not handle:
            raise MemoryError("no memory for a search")
        self._search = ctypes.c_void_p(handle)
        weakref.finalize(self, self._library.so101_search_free, self._search)

    def run(self, deadline: Deadline, most: int | None = None) -> tuple[list[Array], int] | None:
        """Waypoints (5,) to a goal, and its index; None if not found in time or ``most`` rounds."""
        if deadline.has_passed():  # the library asks only now and then
            return None
        batch, checker = self._checker.batch, ctypes.byref(self._checker.checker)
        with batch.until(deadline.has_passed):
            count = self._library.so101_search_run(batch.scene, self._search, checker, most or 0)
            batch.raise_error()
        if count < 0:
            raise MemoryError("no memory for a search")
        if count == 0:
            return None
        points = np.empty((count, 5))
        goal = self._library.so101_search_path(self._search, pointer(points))
        return list(points), int(goal)

    @cached_property
    def from_start(self) -> Tree:
        """The tree that grew from the start."""
        return self._tree(0)

    @cached_property
    def from_goals(self) -> Tree:
        """The tree that grew from the goals."""
        return self._tree(1)

    def _tree(self, which: int) -> Tree:
        count = self._library.so101_search_tree(self._search, which, None, None)
        points, parents = np.empty((count, 5)), np.empty(count, dtype=np.int32)
        self._library.so101_search_tree(self._search, which, pointer(points), pointer(parents))
        roots = self._roots[which]
        tree = Tree(list(points[:roots]), self._space, self._random)
        for q, parent in zip(points[roots:], parents[roots:].tolist(), strict=True):
            tree.add(q, parent)
        return tree


def compiled_shortened(
    points: Sequence[Array],
    checker: BatchSampledCheck,
    random: np.random.Generator,
    deadline: Deadline,
    *,
    only_skip: bool = False,
) -> list[Array]:
    """``shortened``, or only ``skipped``, compiled."""
    batch = checker.batch
    given = np.array(points)
    pieces = sum(ceil(dist(a, b) / PIECE) + 1 for a, b in pairwise(given))
    out = np.empty((pieces + CUTS + 2, 5))
    with batch.until(deadline.has_passed):
        count = batch.library.so101_shorten(
            batch.scene,
            ctypes.byref(checker.checker),
            pointer(given),
            len(given),
            pointer(out),
            len(out),
            seed_of(random),
            int(only_skip),
        )
        batch.raise_error()
    if count <= 0:
        raise MemoryError("no memory to shorten a path")
    return [np.array(each) for each in out[:count]]


def seed_of(random: np.random.Generator) -> ctypes.c_uint64:
    """A seed for the library."""
    return ctypes.c_uint64(int(random.integers(2**63)))
