"""A way for the joints from here to there that touches nothing.

How it works. Most ways are straight: of random pairs of free postures in an empty scene, one in
two hundred is not. So the straight joint line to each goal is tried first, nearest goal first.
Only then two trees grow towards each other, one from the start and one from all goals at once
(RRT-Connect), each new branch being greedily followed by the other tree; what they find is
shortened by straight connections. Every edge is proven free (:mod:`collision`), and the same
request with the same seed gives the same path, because nothing but the seed is random and only
giving up depends on time.

Distances between postures are measured in joint angles weighted by how far each joint moves the
arm, so that a metre of motion counts the same whichever joint makes it.

Source: J. J. Kuffner, S. M. LaValle, RRT-Connect: An Efficient Approach to Single-Query Path
Planning, ICRA 2000.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from so101_motion.errors import NoPath
from so101_motion.geometry import Array, frozen_array
from so101_motion.planning.collision import CollisionModel
from so101_motion.planning.model import RobotModel

STEP = 0.20
"""Longest branch of a tree, as weighted distance [m]. Chosen by benchmarks/bench_plan.py."""

SHORTCUTS = 100
"""Random connections tried to shorten a found path. Chosen with the next two: paths within 1 % of
what ten times the effort finds."""

IN_VAIN = 20
"""So many of them in a row without gain end the attempt early."""

GAIN = 0.005
"""A connection must save this share of the path to be worth the proof that it is free."""

_CONFINED = 0.25
"""A tree that after the whole time spans less than this share of the joints' range is shut in."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FreePath:
    """A polyline in joint space, proven free of contact.

    Attributes:
        waypoints: From start to goal, shape (m, 5), m >= 2, [rad].
        goal: Which of the goals it leads to, as an index.
    """

    waypoints: Array
    goal: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "waypoints", frozen_array(self.waypoints, (-1, 5)))


class PathFinder:
    """Finds free paths for one arm, one jaw opening and one set of surroundings.

    Args:
        model: Joint limits.
        collision: What is in the way.
        q_jaw: Jaw angle during the motion [rad].
        seed: Of all random choices.
    """

    def __init__(
        self, model: RobotModel, collision: CollisionModel, *, q_jaw: float = 0.0, seed: int = 0
    ) -> None:
        self._collision, self._q_jaw = collision, q_jaw
        self._lower, self._span = model.lower, model.upper - model.lower
        self._weights = collision.reach
        self._seed = seed

    def find(self, q_start: Array, goals: Iterable[Array], time_budget: float) -> FreePath:
        """A free path to one of the goals, straight if there is such.

        Args:
            q_start: A free posture inside the limits, shape (5,), [rad].
            goals: Free postures inside the limits, at least one, nearest first. They are asked for
                one by one, so the later ones may be worked out only if they are needed.
            time_budget: When to give up [s].

        Raises:
            NoPath: None was found in time; the message says which end is shut in, if one is.
        """
        blocked = []
        for index, goal in enumerate(goals):
            if self.is_free_line(q_start, goal):
                return FreePath(waypoints=np.array([q_start, goal]), goal=index)
            blocked.append(goal)
        random = np.random.default_rng(self._seed)
        points, index = self._connect(q_start, blocked, time_budget, random)
        return FreePath(waypoints=self._shortened(points, random), goal=index)

    def is_free_line(self, q_from: Array, q_to: Array) -> bool:
        """Whether the straight joint line between two postures is free, ends included."""
        points = np.array([q_from, q_to])
        return self._collision.blocked_posture(points, self._q_jaw) is None

    def _connect(
        self,
        q_start: Array,
        goals: Sequence[Array],
        time_budget: float,
        random: np.random.Generator,
    ) -> tuple[list[Array], int]:
        """Waypoints found by two growing trees, and the goal they lead to."""
        start_tree = _Tree([q_start], self._weights)
        goal_tree = _Tree(goals, self._weights)
        here, there = start_tree, goal_tree
        give_up = time.perf_counter() + time_budget
        while time.perf_counter() < give_up:
            sample = self._lower + self._span * random.random(5)
            new = self._grow(here, sample)
            if new is not None:
                met = self._follow(there, here.points[new])
                if met is not None:
                    first, second = (new, met) if here is start_tree else (met, new)
                    to_goal = goal_tree.branch(second)
                    points = start_tree.branch(first)[::-1] + to_goal[1:]
                    return points, goal_tree.root(second)
            here, there = there, here
        raise _no_path(start_tree, goal_tree, self._span, time_budget)

    def _grow(self, tree: _Tree, q_towards: Array) -> int | None:
        """Add one branch of at most ``STEP`` from the nearest node; its index, or None."""
        parent, distance = tree.nearest(q_towards)
        origin = tree.points[parent]
        if distance > STEP:
            q_towards = origin + (q_towards - origin) * (STEP / distance)
        return self._add(tree, parent, q_towards)

    def _follow(self, tree: _Tree, q_towards: Array) -> int | None:
        """Grow towards a posture until it is reached (its index) or the way is blocked (None)."""
        parent, distance = tree.nearest(q_towards)
        while True:
            origin = tree.points[parent]
            arrives = distance <= STEP
            q_next = q_towards if arrives else origin + (q_towards - origin) * (STEP / distance)
            added = self._add(tree, parent, q_next)
            if added is None or arrives:
                return added
            parent, distance = added, distance - STEP

    def _add(self, tree: _Tree, parent: int, q: Array) -> int | None:
        if self._is_free(q) and self.is_free_line(tree.points[parent], q):
            return tree.add(q, parent)
        return None

    def _shortened(self, points: list[Array], random: np.random.Generator) -> Array:
        """The same path with detours cut, by skipping waypoints and then by random connections."""
        points = self._skipped(points)
        in_vain = 0
        for _ in range(SHORTCUTS):
            if len(points) == 2 or in_vain == IN_VAIN:
                break
            shorter = self._cut_once(points, random)
            in_vain = in_vain + 1 if shorter is None else 0
            points = shorter or points
        return np.array(self._skipped(points))

    def _skipped(self, points: list[Array]) -> list[Array]:
        """Leave out every waypoint that a straight line can pass by, farthest reach first."""
        kept, k = [points[0]], 0
        while k < len(points) - 1:
            reach = len(points) - 1
            while reach > k + 1 and not self.is_free_line(points[k], points[reach]):
                reach -= 1
            kept.append(points[reach])
            k = reach
        return kept

    def _cut_once(self, points: list[Array], random: np.random.Generator) -> list[Array] | None:
        """Connect two random points of the path, if that is worth it and they see each other."""
        lengths = np.array([float(np.linalg.norm(b - a)) for a, b in pairwise(points)])
        ends = np.cumsum(lengths)
        at = np.sort(random.random(2)) * ends[-1]
        i, j = np.minimum(np.searchsorted(ends, at, "right"), len(lengths) - 1)
        before_end = (ends[[i, j]] - at) / lengths[[i, j]]
        a = points[i + 1] + (points[i] - points[i + 1]) * before_end[0]
        b = points[j + 1] + (points[j] - points[j + 1]) * before_end[1]
        saved = at[1] - at[0] - float(np.linalg.norm(b - a))
        if saved < GAIN * ends[-1]:
            return None
        if not (self._is_free(a) and self._is_free(b) and self.is_free_line(a, b)):
            return None
        return [*points[: i + 1], a, b, *points[j + 1 :]]

    def _is_free(self, q: Array) -> bool:
        return self._collision.is_free(q, self._q_jaw)


class _Tree:
    """Postures and how each was reached, with a quick search for the nearest."""

    def __init__(self, roots: Sequence[Array], weights: Array) -> None:
        self._weights = weights
        self._weighted = np.empty((256, 5))
        self.points: list[Array] = []
        self._parents: list[int] = []
        for root in roots:
            self.add(root, -1)

    @property
    def count(self) -> int:
        return len(self.points)

    def add(self, q: Array, parent: int) -> int:
        index = len(self.points)
        if index == len(self._weighted):
            self._weighted = np.concatenate((self._weighted, np.empty_like(self._weighted)))
        self._weighted[index] = q * self._weights
        self.points.append(q)
        self._parents.append(parent)
        return index

    def nearest(self, q: Array) -> tuple[int, float]:
        """The nearest node and its weighted distance [m]."""
        apart = self._weighted[: len(self.points)] - q * self._weights
        squares = np.einsum("ij,ij->i", apart, apart)
        index = int(squares.argmin())
        return index, float(squares[index]) ** 0.5

    def branch(self, index: int) -> list[Array]:
        """The postures from a node back to its root."""
        points = []
        while index >= 0:
            points.append(self.points[index])
            index = self._parents[index]
        return points

    def root(self, index: int) -> int:
        """Which of the roots a node grew from."""
        while self._parents[index] >= 0:
            index = self._parents[index]
        return index

    def spread(self, span: Array) -> float:
        """The largest share of any joint's range that the tree covers."""
        return float((np.ptp(np.array(self.points), axis=0) / span).max())


def _no_path(start_tree: _Tree, goal_tree: _Tree, span: Array, time_budget: float) -> NoPath:
    shut_in = [tree.spread(span) < _CONFINED for tree in (start_tree, goal_tree)]
    if shut_in[1] and not shut_in[0]:
        where = "the goal is free but shut in: nothing leads up to it; choose another approach"
    elif shut_in[0] and not shut_in[1]:
        where = "the start is free but shut in: nothing leads away from it; clear its surroundings"
    else:
        where = "start and goal are free, the way between them is blocked; move in smaller steps"
    return NoPath(
        f"no path found in {time_budget:.1f} s ({start_tree.count} postures reached from the start,"
        f" {goal_tree.count} from the goal): {where}, or allow more time"
    )
