"""The search and the shortening of the compiled library, in the form of ours.

``native/search.c`` does what ``rrt_connect.py`` and ``shorten.py`` do, with the same checks and
random numbers of its own: the same request and seed give the same path on every machine with the
library, another one without it.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cached_property, lru_cache

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.batch_check import BatchSampledCheck, pointer
from so101_motion.planning.paths.rrt_connect import Deadline, Space, Tree

ROOM = 256
"""Waypoints of a path while it is shortened, at first; more are made room for."""

SEEDS = 64
"""So many different seeds; a search uses a few."""


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
        random: Seeds,
    ) -> None:
        self._space, self._checker, self._random = space, checker, random
        self._library = checker.batch.library
        self._roots = (1, len(goals))
        self._search = ctypes.c_void_p()
        given = (space.lower, space.upper, space.weights, q_start, *goals)
        packed = np.concatenate(given, dtype=np.float64)
        first: int = packed.ctypes.data
        at = (ctypes.c_void_p(first + k * 5 * packed.itemsize) for k in range(5))
        handle = self._library.so101_search_new(*at, len(goals), random.next())
        if not handle:
            raise MemoryError("no memory for a search")
        self._search = ctypes.c_void_p(handle)

    def __del__(self) -> None:
        self._library.so101_search_free(self._search)

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
        tree = Tree(list(points[:roots]), self._space, self._random.generator)
        for q, parent in zip(points[roots:], parents[roots:].tolist(), strict=True):
            tree.add(q, parent)
        return tree


def compiled_shortened(
    points: Sequence[Array],
    checker: BatchSampledCheck,
    random: Seeds,
    deadline: Deadline,
    *,
    only_skip: bool = False,
) -> list[Array]:
    """``shortened``, or only ``skipped``, compiled."""
    batch = checker.batch
    given, seed = np.array(points), random.next()
    room, count = ROOM, 0
    while count == 0:  # too little room for the pieces of so long a path
        out = np.empty((room, 5))
        with batch.until(deadline.has_passed):
            count = batch.library.so101_shorten(
                batch.scene,
                ctypes.byref(checker.checker),
                pointer(given),
                len(given),
                pointer(out),
                room,
                seed,
                int(only_skip),
            )
            batch.raise_error()
        room *= 4
    if count < 0:
        raise MemoryError("no memory to shorten a path")
    return list(out[:count])


class Seeds:
    """Seeds for the library, one after the other, the same for the same ``seed``."""

    def __init__(self, seed: int) -> None:
        self._seed, self._values, self._used = seed, _seeds(seed), 0

    def again(self) -> Seeds:
        """The same seeds from the first one on."""
        return Seeds(self._seed)

    def next(self) -> ctypes.c_uint64:
        """The next seed."""
        self._used += 1
        return ctypes.c_uint64(self._values[self._used % SEEDS - 1])

    @cached_property
    def generator(self) -> np.random.Generator:
        """A source of random numbers, for what is not compiled."""
        return np.random.default_rng(self._seed)


@lru_cache(maxsize=16)
def _seeds(seed: int) -> list[int]:
    """Made once: numpy needs as long for a new source as the library for many a search."""
    return [int(value) for value in np.random.default_rng(seed).integers(2**63, size=SEEDS)]
