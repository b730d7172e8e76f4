"""Search for a collision-free path with two trees that grow towards each other (RRT-Connect).

One tree has its root at the start, the other one root at each goal. A tree grows by a branch of
limited length from its nearest node towards a random configuration; the other tree then follows
greedily to the new node, as far as it gets. The smaller tree goes next until it has caught up: if
one end is deep in a narrow place, nearly all tries on its side fail, and they are needed there.

Random configurations are handled several at a time, because in narrow places most of them are not
free and cost little else. The seed determines everything except giving up, which depends on time.

Distances are joint angles weighted by how far each joint moves the arm, so that a metre of motion
counts the same for every joint.

Source: J. J. Kuffner, S. M. LaValle, RRT-Connect: An Efficient Approach to Single-Query Path
Planning, ICRA 2000.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Protocol

import numpy as np

from so101_motion.common.geometry import Array

STEP = 0.20
"""Longest branch of a tree, as weighted distance [m]. Chosen by benchmarks/bench_plan.py."""

FEWEST, MOST = 8, 64
"""Number of random configurations at a time: the fewest after a success, doubled after each failure
up to the most. Chosen."""


class LineChecker(Protocol):
    """Checks whether configurations and lines are free."""

    def is_free(self, q: Array) -> bool:
        """Whether joint angles ``q``, shape (5,), [rad], are free of contact."""

    def first_free(self, configurations: Array) -> int | None:
        """The first free one of several configurations (n, 5) [rad], None if none is."""

    def is_clear(self, q_from: Array, q_to: Array) -> bool:
        """Whether the line between two free configurations is free, as far as is checked."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Space:
    """The space from which configurations are drawn.

    Attributes:
        lower: Smallest joint angles, shape (5,), [rad].
        upper: Largest joint angles, shape (5,), [rad].
        weights: How far each joint moves the arm per angle, shape (5,), [m/rad].
    """

    lower: Array
    upper: Array
    weights: Array

    def around(self, first: Array, second: Array, distance: float) -> Space:
        """The part within ``distance`` [rad] of two configurations (5,) in each joint."""
        return replace(
            self,
            lower=np.maximum(self.lower, np.minimum(first, second) - distance),
            upper=np.minimum(self.upper, np.maximum(first, second) + distance),
        )


class Deadline:
    """The time at which a search ends.

    Attributes:
        budget: Time from its creation [s].
    """

    def __init__(self, budget: float) -> None:
        self.budget = budget
        self._end = time.perf_counter() + budget

    def has_passed(self) -> bool:
        """Whether the time is up."""
        return time.perf_counter() > self._end


class TreeSearch:
    """One search, from a start to any of several goals.

    Args:
        space: The space from which configurations are drawn.
        checker: Checks configurations and lines.
        q_start: A free configuration, shape (5,), [rad].
        goals: Free configurations, at least one, each of shape (5,), [rad].
        random: Source of random numbers.
    """

    def __init__(
        self,
        space: Space,
        checker: LineChecker,
        q_start: Array,
        goals: Sequence[Array],
        random: np.random.Generator,
    ) -> None:
        self._checker = checker
        self.from_start = Tree([q_start], space, random)
        self.from_goals = Tree(goals, space, random)

    def run(self, deadline: Deadline, most: int | None = None) -> tuple[list[Array], int] | None:
        """Waypoints (5,) to a goal, and its index; None if not found in time or ``most`` rounds."""
        here, there = self.from_start, self.from_goals
        for _ in count() if most is None else range(most):
            if deadline.has_passed():
                break
            new = here.grow(self._checker)
            if new is None:
                continue
            met = there.follow(self._checker, here.points[new])
            if met is not None:
                first, second = (new, met) if here is self.from_start else (met, new)
                points = self.from_start.branch(first)[::-1] + self.from_goals.branch(second)
                return points, self.from_goals.root(second)
            if here.grown > there.grown:
                here, there = there, here
        return None


class Tree:
    """Configurations, each with its parent. The first ones are the roots.

    Attributes:
        points: The configurations, shape (>= count, 5), [rad]; valid up to ``count``.
        count: How many there are.
    """

    def __init__(self, roots: Sequence[Array], space: Space, random: np.random.Generator) -> None:
        self._space, self._random = space, random
        n = len(space.lower)
        self.points, self._weighted = np.empty((256, n)), np.empty((256, n))
        self._half_squares = np.empty(256)
        self._parents: list[int] = []
        self._at_once = FEWEST
        self.count = 0
        for root in roots:
            self.add(root, -1)
        self._roots = self.count

    @property
    def grown(self) -> int:
        """Number of nodes besides the roots."""
        return self.count - self._roots

    def grow(self, checker: LineChecker) -> int | None:
        """Try some branches towards random configurations; the new node, or None."""
        parents, ends = self._tries()
        first = 0
        while (k := checker.first_free(ends[first:])) is not None:
            parent, q = int(parents[first + k]), ends[first + k]
            if checker.is_clear(self.points[parent], q):
                self._at_once = FEWEST
                return self.add(q, parent)
            first += k + 1
        self._at_once = min(2 * self._at_once, MOST)
        return None

    def probe(self, checker: LineChecker) -> list[Array]:
        """Try some branches; return the blocked ones, each of shape (2, 5), [rad]."""
        met = []
        for parent, q in zip(*self._tries(), strict=True):
            origin = self.points[parent].copy()
            if checker.is_free(q) and checker.is_clear(origin, q):
                self.add(q, int(parent))
            else:
                met.append(np.array([origin, q]))
        return met

    def follow(self, checker: LineChecker, q_towards: Array) -> int | None:
        """Grow towards a configuration; the last node if it was reached, None if blocked."""
        parent, distance = self.nearest(q_towards)
        origin = self.points[parent]
        while distance > STEP:
            q_next = origin + (q_towards - origin) * (STEP / distance)
            if not (checker.is_free(q_next) and checker.is_clear(origin, q_next)):
                return None
            parent, origin, distance = self.add(q_next, parent), q_next, distance - STEP
        return parent if checker.is_clear(origin, q_towards) else None

    def branch(self, index: int) -> list[Array]:
        """The configurations from a node back to its root."""
        points = []
        while index >= 0:
            points.append(self.points[index].copy())
            index = self._parents[index]
        return points

    def root(self, index: int) -> int:
        """The root of a node."""
        while self._parents[index] >= 0:
            index = self._parents[index]
        return index

    def spread(self) -> float:
        """The largest share of any joint's range that the tree covers."""
        space = self._space
        extent = np.ptp(self.points[: self.count], axis=0)
        return float((extent / (space.upper - space.lower)).max())

    def _tries(self) -> tuple[Array, Array]:
        """Nodes to branch from, and the ends of the branches, shape (n, 5), [rad]."""
        space, n = self._space, self.count
        drawn = self._random.random((self._at_once, len(space.lower)))
        drawn = space.lower + (space.upper - space.lower) * drawn
        weighted = drawn * space.weights
        parents = (weighted @ self._weighted[:n].T - self._half_squares[:n]).argmax(axis=1)
        origins = self.points[parents]
        away = weighted - self._weighted[parents]
        distances = np.sqrt(np.einsum("ij,ij->i", away, away))
        part = STEP / np.maximum(distances, STEP)
        return parents, origins + (drawn - origins) * part[:, None]

    def nearest(self, q: Array) -> tuple[int, float]:
        """The nearest node and its weighted distance [m]."""
        weighted = q * self._space.weights
        n = self.count
        index = int((self._weighted[:n] @ weighted - self._half_squares[:n]).argmax())
        away = weighted - self._weighted[index]
        return index, float(away @ away) ** 0.5

    def add(self, q: Array, parent: int) -> int:
        """Add a node (5,) [rad] that was reached from ``parent``; its index."""
        index = self.count
        if index == len(self.points):
            self.points, self._weighted, self._half_squares = (
                np.concatenate((old, np.empty_like(old)))
                for old in (self.points, self._weighted, self._half_squares)
            )
        self.points[index] = q
        weighted = self._weighted[index] = q * self._space.weights
        self._half_squares[index] = 0.5 * float(weighted @ weighted)
        self._parents.append(parent)
        self.count += 1
        return index
