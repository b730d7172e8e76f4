"""Shorten a joint path: skip waypoints, cut corners, and pull it straight.

Three methods complement each other. *Skipping*: the path is cut into short pieces, and straight
lines past many of them are tried, then past half as many, and so on; that removes the zigzag of a
random search. *Cutting* from one random point of the path to another removes wide curves. *Pulling*
moves each corner towards the line between its neighbours, like pulling a rope tight.

Lengths are Euclidean in joint angles. Points are joint angles, shape (5,), [rad].

Source: R. Geraerts, M. H. Overmars, Creating High-quality Paths for Motion Planning, IJRR 2007, for
shortcuts between random points.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate, pairwise
from math import ceil, dist

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.paths.rrt_connect import Deadline, LineChecker

PIECE = 0.25
"""Longest piece that is skipped or kept as a whole [rad]. Chosen, like the following, by resulting
length and time on the paths of benchmarks/bench_plan.py."""

CUTS = 60
"""Number of random cuts that are tried."""

MOST_FAILED_CUTS = 14
"""Cutting ends early after so many cuts in a row without gain."""

GAIN = 0.005
"""A cut that saves less than this share of the path is not checked."""

SHARES = (0.5, 0.25)
"""How far a corner is pulled if it cannot be left out; the first free share is used."""

Points = list[Array]
"""Corners of a path, each of shape (5,), [rad]."""


def shortened(
    points: Sequence[Array],
    checker: LineChecker,
    random: np.random.Generator,
    deadline: Deadline,
) -> Points:
    """A shorter path between the same ends; the best one so far when the deadline passes."""
    found = _cut(skipped(points, checker), checker, random, deadline)
    return found if deadline.has_passed() else _pulled(found, checker)


def skipped(points: Sequence[Array], checker: LineChecker) -> Points:
    """The path without the pieces that straight lines can replace, the longest lines first."""
    kept = _in_pieces(points)
    stride = len(kept) - 1
    while stride >= 2:
        k = 0
        while k + stride < len(kept):
            if checker.is_clear(kept[k], kept[k + stride]):
                del kept[k + 1 : k + stride]
                k += 1
            else:
                k += max(1, stride // 2)
        stride = min(stride, len(kept) - 1) // 2
    return kept


def _in_pieces(points: Sequence[Array]) -> Points:
    """The same path with further points on its lines, so that no piece is long."""
    pieces = [points[0]]
    for a, b in pairwise(points):
        count = max(1, ceil(dist(a, b) / PIECE))
        pieces += [a + (k / count) * (b - a) for k in range(1, count)]
        pieces.append(b)
    return pieces


def _cut(
    points: Points, checker: LineChecker, random: np.random.Generator, deadline: Deadline
) -> Points:
    """The path with random points of it connected where that is shorter and free."""
    ends = _ends(points)
    failed = 0
    for first, second in np.sort(random.random((CUTS, 2))).tolist():
        if len(points) == 2 or failed == MOST_FAILED_CUTS or deadline.has_passed():
            break
        failed += 1
        begin, end = first * ends[-1], second * ends[-1]
        i, j = bisect_right(ends, begin), bisect_right(ends, end)
        if i == j:
            continue
        a, b = _at(points, ends, i, begin), _at(points, ends, j, end)
        if end - begin - dist(a, b) >= GAIN * ends[-1] and checker.is_clear(a, b):
            points = [*points[:i], a, b, *points[j:]]
            ends, failed = _ends(points), 0
    return points


def _ends(points: Points) -> list[float]:
    """The length of the path up to each corner, 0 for the first."""
    return [0.0, *accumulate(dist(a, b) for a, b in pairwise(points))]


def _at(points: Points, ends: list[float], i: int, length: float) -> Array:
    """The point after some length, which lies before corner ``i``."""
    part = (length - ends[i - 1]) / (ends[i] - ends[i - 1])
    i = min(i, len(points) - 1)
    point: Array = points[i - 1] + part * (points[i] - points[i - 1])
    return point


def _pulled(points: Points, checker: LineChecker) -> Points:
    """The path with each corner pulled towards the line between its neighbours."""
    points = list(points)
    k = 1
    while k < len(points) - 1:
        before, corner, after = points[k - 1 : k + 2]
        line = after - before
        part = float((corner - before) @ line) / max(float(line @ line), 1e-12)
        target = before + min(max(part, 0.0), 1.0) * line
        if checker.is_clear(before, after):
            del points[k]
            continue
        for share in SHARES:
            nearer = corner + share * (target - corner)
            if (
                checker.is_free(nearer)
                and checker.is_clear(before, nearer)
                and checker.is_clear(nearer, after)
            ):
                points[k] = nearer
                break
        k += 1
    return points
