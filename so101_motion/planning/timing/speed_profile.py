"""Find the largest speed along a path within velocity, acceleration and torque limits.

How it works (TOPP-RA: Pham and Pham, A New Approach to Time-Optimal Path Parameterization Based on
Reachability Analysis, 2018). With ``x`` the squared speed along the path and ``u`` its
acceleration, velocity limits cap x, acceleration and torque limits are linear in u and x. The path
is cut into intervals of constant u. One pass from the end finds the largest x from which the arm
can still stop, one pass from the start then accelerates as hard as it may below that.

What keeps it exact and quick:

* There is a cut at every knot of the path, and both ends of each interval must keep the limits; a
  coarser or unaligned grid exceeds them in between or stalls.
* On a straight piece nothing varies, so the best motion along it is known: full acceleration, top
  speed, full braking. It is one interval for both passes, and is cut afterwards where these phases
  meet.
* Both ends are at rest, and x = 0 with u = 0 is allowed everywhere, so the pass from the end needs
  no lower bound. In the pass from the start x is known, and the largest u is a minimum over rows.
  Only the largest x of a curved interval is a linear program in two unknowns: toppra solves it
  where it is installed, and :mod:`~so101_motion.planning.timing.interval_program` elsewhere.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import Array
from so101_motion.planning.checkpoint import Checkpoint, never_abandoned
from so101_motion.planning.timing.interval_program import (
    LimitRows,
    Solver,
    exact_solver,
    toppra_solver,
)
from so101_motion.planning.timing.path_geometry import JointPath, PathPoints

GRID_POINTS = 800
"""Number of intervals of all winding pieces of a path together, evenly shared. Chosen:
benchmarks/."""
GRID_PER_PIECE = (16, 300)
"""Fewest and most intervals on one winding piece. Fewer than 16 cost more than 1 % in time."""
GRID_ON_ROUNDS = 120
"""Number of intervals of all parabolas that round corners together. Chosen: benchmarks/."""
GRID_PER_ROUND = (12, 40)
"""Fewest and most intervals on one of them. Chosen: that costs less than 0.2 % in time."""
SPEED_MARGIN = 1.0 - 1e-4
"""Share of the speed limits used on the grid; covers the excess between its points."""

SHORTEST = 1e-6
"""Parts of an even interval below this share of it are not cut off."""

_LARGEST = 1e6
"""Largest squared speed in scaled units; toppra needs a bound even where there is none."""

_LEAST = 1e-9
"""A row with a smaller factor of u, in scaled units, does not bound u."""

_BETWEEN = 64
"""Number of intervals between two checkpoints. Chosen: a millisecond."""

Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

FurtherLimits = Callable[[PathPoints], LimitRows]
"""Limits at given points of a path, besides those of velocity and acceleration."""


class PathGrid:
    """A path cut into intervals.

    Attributes:
        steps: Length of each interval, shape (N,), [rad].
        begin: The path at the beginning of each interval, arrays of shape (N, n).
        end: The same at its end. Curvature may jump between the end of one interval and the
            beginning of the next.
        is_even: Whether nothing varies along the interval, shape (N,).
    """

    def __init__(
        self, path: JointPath, piece: Indices, cuts: tuple[Array, Array], is_even: Mask
    ) -> None:
        self._path, self._piece, self._cuts, self.is_even = path, piece, cuts, is_even
        self.steps = cuts[1] - cuts[0]
        self.begin, self.end = (path.on_pieces(piece, cut) for cut in cuts)

    @classmethod
    def on(cls, path: JointPath, *, fine: bool) -> PathGrid:
        """Cut the curved pieces evenly, and with ``fine`` the straight ones as well.

        Straight pieces need that if limits vary along them.
        """
        bends, winds = (np.any(path.coefficients[:, k:], axis=(1, 2)) for k in (2, 3))
        many = int(np.clip(GRID_POINTS // len(bends), *GRID_PER_PIECE))
        some = int(np.clip(GRID_ON_ROUNDS // max(1, int(bends.sum())), *GRID_PER_ROUND))
        count = np.where(winds | fine, many, np.where(bends, some, 1))
        piece = np.repeat(np.arange(len(count)), count)
        number = np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count)
        step = (np.diff(path.knots) / count)[piece]
        is_even = np.zeros(len(piece), dtype=np.bool_) if fine else ~bends[piece]
        return cls(path, piece, (number * step, (number + 1) * step), is_even)

    def divided(self, at: Indices, after: Array) -> PathGrid:
        """A copy with intervals ``at`` cut again, ``after`` [rad] from their beginnings.

        An interval that is cut twice occurs twice; both arrays rise.
        """
        first, last = self._cuts
        u = first[at] + after
        return PathGrid(
            self._path,
            np.insert(self._piece, at, self._piece[at]),
            (np.insert(first, at + 1, u), np.insert(last, at, u)),
            np.insert(self.is_even, at, self.is_even[at]),
        )

    def divided_at(self, s: Array) -> PathGrid:
        """A copy with even intervals cut at ``s`` (m,), rising, [rad] from the start."""
        ends = np.cumsum(self.steps)
        at = np.minimum(np.searchsorted(ends, s), len(ends) - 1)
        after = s - (ends[at] - self.steps[at])
        inside = self.is_even[at] & _is_inside(after, self.steps[at])
        return self.divided(at[inside], after[inside])

    @property
    def nodes(self) -> tuple[Array, Array]:
        """Joint angles and their derivative by s at all cuts, each (N + 1, n)."""
        return (
            np.concatenate((self.begin.q, self.end.q[-1:])),
            np.concatenate((self.begin.q_s, self.end.q_s[-1:])),
        )


def optimal_speed(
    grid: PathGrid,
    cap: Array,
    acceleration: Array,
    further: FurtherLimits | None = None,
    checkpoint: Checkpoint = never_abandoned,
) -> tuple[PathGrid, Array]:
    """The largest speed along the path, zero at both ends.

    Args:
        cap: Largest speed at each cut, shape (N + 1,), [rad/s].
        acceleration: Joint acceleration limits on each interval, shape (N, n), [rad/s^2].
        further: More limits at given points of the path; they need a fine grid.

    Returns:
        The grid, cut once more where the acceleration along an even interval changes, and the
        speed at each cut, [rad/s].

    Raises:
        PlanningError: There is no such speed.
    """
    # Scaled so that the programs have numbers near one, because toppra's tolerances are absolute.
    curved = grid.steps[~grid.is_even]
    length = GRID_PER_PIECE[0] * float((curved if len(curved) else grid.steps).mean())
    time = math.sqrt(length / float(acceleration.max()))
    begin, end = (_rows(points, acceleration, further) for points in (grid.begin, grid.end))
    # An interval of constant u ends with x + 2 u step: its end is one more row for each limit.
    a = np.hstack((begin.a, end.a + 2.0 * grid.steps[:, None] * end.b)) * (length / time**2)
    b = np.hstack((begin.b, end.b)) * (length / time) ** 2
    rows = LimitRows(a, b, np.hstack((begin.c, end.c)))
    with np.errstate(over="ignore"):
        ceiling = np.minimum((SPEED_MARGIN * cap * time / length) ** 2, _LARGEST)
    steps = grid.steps / length
    with np.errstate(divide="ignore"):
        hardest = np.where(grid.is_even, 1.0 / np.abs(rows.a).max(axis=1), 0.0)
    checkpoint()
    x = _largest_squares(steps, rows, ceiling, hardest, checkpoint)
    grid, x = _switched(grid, length, x, ceiling, hardest)
    return grid, np.sqrt(x) * (length / time)


def _rows(points: PathPoints, acceleration: Array, further: FurtherLimits | None) -> LimitRows:
    """Acceleration limits at points of the path, and further ones."""
    a, b = points.q_s / acceleration, points.q_ss / acceleration
    own = LimitRows(a, b, np.zeros_like(a))
    if further is None:
        return own
    return LimitRows(*(np.hstack(both) for both in zip(own, further(points), strict=True)))


def _largest_squares(
    steps: Array, rows: LimitRows, cap: Array, hardest: Array, checkpoint: Checkpoint
) -> Array:
    """Maximise x at each cut subject to ``|a u + b x + c| <= 1`` and ``0 <= x <= cap``.

    Args:
        steps: Length of each interval, shape (N,).
        rows: For each interval.
        cap: Shape (N + 1,).
        hardest: Largest u on an even interval, shape (N,); 0 on the others.
    """
    caps, gains = cap.tolist(), (2.0 * steps * hardest).tolist()
    solve = _solver(steps, rows, cap)
    largest = [0.0] * len(caps)
    for i in range(len(steps) - 1, -1, -1):
        if i % _BETWEEN == 0:
            checkpoint()
        if gains[i]:
            largest[i] = min(caps[i], largest[i + 1] + gains[i])
        else:
            largest[i] = solve(i, largest[i + 1])
    largest[0] = here = 0.0
    x, twice = [here], (2.0 * steps).tolist()
    bases, slopes = _largest_u(rows)
    for i, gain in enumerate(gains):
        if i % _BETWEEN == 0:
            checkpoint()
        if not gain:
            gain = twice[i] * min([p - r * here for p, r in zip(bases[i], slopes[i], strict=True)])
        here = max(0.0, min(here + gain, largest[i + 1]))
        x.append(here)
    found = np.array(x)
    if not np.all(found[1:-1] > 0.0):
        raise PlanningError(
            "no speed along this path satisfies the limits; check for a corner that is too sharp"
        )
    return found


def _largest_u(rows: LimitRows) -> tuple[list[list[float]], list[list[float]]]:
    """``p`` and ``r`` such that u is at most the smallest ``p - r x``, for each interval."""
    bounds = np.abs(rows.a) > _LEAST  # the others bound x alone, which the first pass has seen to
    a = np.where(bounds, rows.a, 1.0)
    p = np.where(bounds, (1.0 - np.sign(a) * rows.c) / np.abs(a), np.inf)
    return p.tolist(), np.where(bounds, rows.b / a, 0.0).tolist()


def _switched(
    grid: PathGrid, length: float, x: Array, cap: Array, hardest: Array
) -> tuple[PathGrid, Array]:
    """Cut even intervals where full acceleration, top speed and full braking meet.

    Args:
        length: The unit of lengths here.
        x: Squared speed at each cut, shape (N + 1,).
        cap: Its largest value, same shape.
        hardest: As for :func:`_largest_squares`.
    """
    even = np.flatnonzero(grid.is_even)
    first, last, top, rate = x[even], x[even + 1], cap[even], 2.0 * hardest[even]
    step = grid.steps[even] / length
    # Where the two meet without a top speed in between; x there.
    peak = 0.5 * (first + last + rate * step)
    top = np.minimum(top, peak)
    after = np.stack(((top - first) / rate, step - (top - last) / rate), axis=1)
    inside = _is_inside(after, step[:, None])
    inside[:, 1] &= after[:, 1] - after[:, 0] > SHORTEST * step
    at = np.repeat(even, 2)[inside.ravel()]
    squares = np.repeat(top, 2)[inside.ravel()]
    return grid.divided(at, length * after[inside]), np.insert(x, at + 1, squares)


def _is_inside(after: Array, step: Array) -> Mask:
    """Whether a cut ``after`` the beginning of an interval leaves parts that are long enough."""
    inside: Mask = (after > SHORTEST * step) & (after < (1.0 - SHORTEST) * step)
    return inside


def _solver(steps: Array, rows: LimitRows, cap: Array) -> Solver:
    """The solver of the linear programs on this system."""
    return (toppra_solver if _has_toppra() else exact_solver)(steps, rows, cap)


@functools.cache
def _has_toppra() -> bool:
    return find_spec("toppra") is not None
