"""Search for a collision-free path, and shorten it: ``native/search.c`` does both.

The same request and seed give the same path on every machine; only giving up depends on time.
Distances are joint angles weighted by how far each joint moves the arm, so that a metre of motion
counts the same for every joint.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.batch_check import LineCheck, pointer

ROOM = 256  # initial room for the waypoints of a path while it is shortened; grows if needed
SEEDS = 64  # number of seeds that are made at once; then they come again, each 1 higher


STEP, TRIES = 0.20, 16  # of a tree, as weighted distance [m], and at a time; as in the library


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Space:
    """The space from which configurations are drawn."""

    lower: Array  # smallest joint angles, shape (5,), [rad]
    upper: Array  # largest joint angles, shape (5,), [rad]
    weights: Array  # how far each joint moves the arm per angle, shape (5,), [m/rad]

    def around(self, first: Array, second: Array, distance: float) -> Space:
        """The part within ``distance`` [rad] of two configurations (5,) in each joint."""
        return replace(
            self,
            lower=np.maximum(self.lower, np.minimum(first, second) - distance),
            upper=np.minimum(self.upper, np.maximum(first, second) + distance),
        )


class Deadline:
    """The time at which a search ends, ``budget`` [s] after its creation."""

    def __init__(self, budget: float) -> None:
        self.budget = budget
        self._end = time.perf_counter() + budget

    def earlier(self, share: float) -> Deadline:
        """Another, after a share of the time that is left."""
        return Deadline(share * (self._end - time.perf_counter()))

    def has_passed(self) -> bool:
        """Whether the time is up."""
        return time.perf_counter() > self._end


class CompiledSearch:
    """A search from a start (n,) [rad] to any of several free goals; ``random`` gives its seed."""

    def __init__(
        self,
        space: Space,
        checker: LineCheck,
        q_start: Array,
        goals: Sequence[Array],
        random: Seeds,
    ) -> None:
        self._space, self._checker, self._random = space, checker, random
        self._library, self._joints = self._checker.library, len(space.lower)
        self._search = ctypes.c_void_p()
        given = (space.lower, space.upper, space.weights, q_start, *goals)
        packed = np.concatenate(given, dtype=np.float64)
        first: int = packed.ctypes.data
        row = self._joints * packed.itemsize
        at = (ctypes.c_void_p(first + k * row) for k in range(5))
        handle = self._library.so101_search_new(self._joints, *at, len(goals), random.next())
        if not handle:
            raise MemoryError("no memory for a search")
        self._search = ctypes.c_void_p(handle)

    def __del__(self) -> None:
        self._library.so101_search_free(self._search)

    def run(self, deadline: Deadline, most: int | None = None) -> tuple[list[Array], int] | None:
        """Waypoints (n,) to a goal, and its index; None if not found in time or ``most`` rounds."""
        if deadline.has_passed():  # the library asks only now and then
            return None
        with self._checker.until(deadline.has_passed):
            count = self._library.so101_search_run(self._checker.team, self._search, most or 0)
        if count < 0:
            raise MemoryError("no memory for a search")
        if count == 0:
            return None
        points = np.empty((count, self._joints))
        goal = self._library.so101_search_path(self._search, pointer(points))
        return list(points), int(goal)

    def trees(self) -> list[Tree]:
        """The trees that grew from the start and from the goals."""
        found = []
        for which in range(2):
            count = self._library.so101_search_tree(self._search, which, None, None)
            points = np.empty((count, self._joints))
            self._library.so101_search_tree(self._search, which, pointer(points), None)
            found.append(Tree(points, self._space, self._random.generator))
        return found


class Tree(NamedTuple):
    """Configurations that a search has reached."""

    points: Array  # the configurations, shape (count, n), [rad]
    space: Space  # the space from which they were drawn
    random: np.random.Generator  # source of random numbers

    def spread(self) -> float:
        """The largest share of any joint's range that the tree covers."""
        extent = np.ptp(self.points, axis=0)
        return float((extent / (self.space.upper - self.space.lower)).max())

    def probe(self, checker: LineCheck) -> list[Array]:
        """Try some branches; return the blocked ones, each of shape (2, n), [rad]."""
        space, met = self.space, []
        for q in self.random.uniform(space.lower, space.upper, (TRIES, len(space.lower))):
            away = np.linalg.norm((self.points - q) * space.weights, axis=1)
            origin = self.points[k := int(away.argmin())]
            end = origin + min(1.0, STEP / max(float(away[k]), 1e-9)) * (q - origin)
            if not (checker.is_free(end) and checker.is_clear(origin, end)):
                met.append(np.array([origin, end]))
        return met


def compiled_shortened(
    points: Sequence[Array],
    checker: LineCheck,
    random: Seeds,
    deadline: Deadline,
    *,
    only_skip: bool = False,
) -> list[Array]:
    """A shorter path between the same ends; the best one so far when the deadline passes.

    With ``only_skip`` pieces are only skipped, for a check that proves lines.
    """
    given, seed = np.array(points), random.next()
    room, count = ROOM, 0
    while count == 0:  # too little room for the pieces of so long a path
        out = np.empty((room, given.shape[1]))
        with checker.until(deadline.has_passed):
            count = checker.library.so101_shorten(
                checker.team, pointer(given), len(given), pointer(out), room, seed, int(only_skip)
            )
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
        turn, k = divmod(self._used - 1, SEEDS)
        return ctypes.c_uint64(self._values[k] + turn)

    @cached_property
    def generator(self) -> np.random.Generator:
        """A source of random numbers for the code here."""
        return np.random.default_rng(self._seed)


@lru_cache(maxsize=16)
def _seeds(seed: int) -> list[int]:
    """Seeds from numpy; cached, because making a generator takes as long as many searches."""
    return [int(value) for value in np.random.default_rng(seed).integers(2**63, size=SEEDS)]
