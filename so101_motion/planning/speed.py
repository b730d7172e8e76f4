"""The largest speed along a path that keeps velocity, acceleration and, where asked, torque limits.

How it works (toppra's method: Pham and Pham, A New Approach to Time-Optimal Path Parameterization
Based on Reachability Analysis, 2018). With ``x`` the squared speed along the path and ``u`` its
acceleration, velocity limits cap x, acceleration and torque limits are linear in u and x. The path
is cut into intervals of constant u. One pass from the end finds the largest x from which the arm
can still stop, one pass from the start then accelerates as hard as it may below that.

What keeps it exact and quick:

* Cuts meet every knot of the path, and both ends of each interval are held to the limits; a
  coarser or unaligned grid exceeds them in between or stalls.
* On a straight piece nothing varies, so the best motion along it is known: full acceleration, top
  speed, full braking. It is one interval for both passes, and is then cut where those phases meet.
* Both ends are at rest, and x = 0 with u = 0 is allowed everywhere, so the pass from the end needs
  no lower bound. In the pass from the start x is known, and the largest u is a minimum over rows.
  Only the largest x of a curved interval is a linear program in two unknowns, and toppra solves it.

toppra is imported on first use, not with this module, and only here. Its package imports
matplotlib for a plotting method (seconds, and more memory than the planner); empty stand-ins take
its place during that one import.
"""

from __future__ import annotations

import functools
import math
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from so101_motion.errors import PlanningError
from so101_motion.geometry import Array
from so101_motion.planning.path_geometry import JointPath, PathPoints

GRID_POINTS = 800
"""How many intervals the winding pieces of a path get together, shared out evenly. Chosen:
benchmarks/."""
GRID_PER_PIECE = (16, 300)
"""Fewest and most intervals on one winding piece. Fewer than 16 cost more than 1 % in time."""
GRID_ON_ROUNDS = 120
"""How many intervals the parabolas that round corners get together. Chosen: benchmarks/."""
GRID_PER_ROUND = (12, 40)
"""Fewest and most intervals on one of them. Chosen: that costs less than 0.2 % in time."""
SPEED_MARGIN = 1.0 - 1e-4
"""Share of the speed limits used on the grid; covers what happens between its points."""

SHORTEST = 1e-6
"""Parts of an even interval below this share of it are not cut off."""

_LARGEST = 1e6
"""Largest squared speed in scaled units; toppra wants a bound even where there is none."""

_LEAST = 1e-9
"""A row with a smaller factor of u, in scaled units, does not bound u."""

Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]


class Rows(NamedTuple):
    """Limits on the motion along a path, ``|a u + b x + c| <= 1``; each shape (N, m).

    Attributes:
        a: Factors of the acceleration along the path [s^2/rad].
        b: Factors of the squared speed along it [s^2/rad^2].
        c: What is used up at rest; less than 1 in magnitude.
    """

    a: Array
    b: Array
    c: Array


FurtherLimits = Callable[[PathPoints], Rows]
"""Limits at given points of a path, beside those of velocity and acceleration."""


class Grid:
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
    def on(cls, path: JointPath, *, fine: bool) -> Grid:
        """Cut the curved pieces evenly, and if ``fine`` the straight ones as well.

        Straight pieces need that where limits vary along them.
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

    def divided(self, at: Indices, after: Array) -> Grid:
        """The same with intervals ``at`` cut again, ``after`` [rad] from their beginnings.

        An interval that is cut twice occurs twice; all rise.
        """
        first, last = self._cuts
        u = first[at] + after
        return Grid(
            self._path,
            np.insert(self._piece, at, self._piece[at]),
            (np.insert(first, at + 1, u), np.insert(last, at, u)),
            np.insert(self.is_even, at, self.is_even[at]),
        )

    def divided_at(self, s: Array) -> Grid:
        """The same with even intervals cut at ``s`` (m,), rising, [rad] from the start."""
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
    grid: Grid,
    cap: Array,
    acceleration: Array,
    further: FurtherLimits | None = None,
) -> tuple[Grid, Array]:
    """The largest speed along the path, zero at both ends.

    Args:
        grid: The path.
        cap: Largest speed at each cut, shape (N + 1,), [rad/s].
        acceleration: Joint acceleration limits on each interval, shape (N, n), [rad/s^2].
        further: More limits at given points of the path; they call for a fine grid.

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
    rows = Rows(a, b, np.hstack((begin.c, end.c)))
    with np.errstate(over="ignore"):
        ceiling = np.minimum((SPEED_MARGIN * cap * time / length) ** 2, _LARGEST)
    steps = grid.steps / length
    with np.errstate(divide="ignore"):
        hardest = np.where(grid.is_even, 1.0 / np.abs(rows.a).max(axis=1), 0.0)
    x = _largest_squares(steps, rows, ceiling, hardest)
    grid, x = _switched(grid, length, x, ceiling, hardest)
    return grid, np.sqrt(x) * (length / time)


def _rows(points: PathPoints, acceleration: Array, further: FurtherLimits | None) -> Rows:
    """Acceleration limits at points of the path, and further ones."""
    a, b = points.q_s / acceleration, points.q_ss / acceleration
    own = Rows(a, b, np.zeros_like(a))
    if further is None:
        return own
    return Rows(*(np.hstack(both) for both in zip(own, further(points), strict=True)))


def _largest_squares(steps: Array, rows: Rows, cap: Array, hardest: Array) -> Array:
    """Maximise x at each cut subject to ``|a u + b x + c| <= 1`` and ``0 <= x <= cap``.

    Args:
        steps: Length of each interval, shape (N,).
        rows: For each interval.
        cap: Shape (N + 1,).
        hardest: Largest u on an even interval, shape (N,); 0 on the others.
    """
    upward, free, gains = np.array([1e-9, -1.0]), math.nan, (2.0 * steps * hardest).tolist()
    caps, solver = cap.tolist(), _solver(steps, rows, cap)
    largest = [0.0] * len(caps)
    for i in range(len(steps) - 1, -1, -1):
        if gains[i]:
            largest[i] = min(caps[i], largest[i + 1] + gains[i])
        else:
            largest[i] = solver(i, None, upward, free, free, 0.0, largest[i + 1])[1]
    largest[0] = here = 0.0
    x, twice = [here], (2.0 * steps).tolist()
    bases, slopes = _largest_u(rows)
    for i, gain in enumerate(gains):
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


def _largest_u(rows: Rows) -> tuple[list[list[float]], list[list[float]]]:
    """``p`` and ``r`` such that u is at most the smallest ``p - r x``, for each interval."""
    bounds = np.abs(rows.a) > _LEAST  # the others bound x alone, which the first pass has seen to
    a = np.where(bounds, rows.a, 1.0)
    p = np.where(bounds, (1.0 - np.sign(a) * rows.c) / np.abs(a), np.inf)
    return p.tolist(), np.where(bounds, rows.b / a, 0.0).tolist()


def _switched(
    grid: Grid, length: float, x: Array, cap: Array, hardest: Array
) -> tuple[Grid, Array]:
    """Cut even intervals where full acceleration meets top speed, and that full braking.

    Args:
        grid: The path.
        length: What lengths are divided by here.
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
    """Whether a cut ``after`` the beginning of an interval leaves parts worth having."""
    inside: Mask = (after > SHORTEST * step) & (after < (1.0 - SHORTEST) * step)
    return inside


def _solver(steps: Array, rows: Rows, cap: Array) -> Callable[..., Any]:
    """Toppra's solver for the linear program of one interval."""
    base, wrapper = _toppra()
    m = rows.a.shape[1]
    both = np.vstack((np.eye(m), -np.eye(m)))
    bounds = np.column_stack((np.zeros_like(cap), cap))
    constraint = base()
    constraint.identical = True
    with_last = (np.vstack((values, values[-1:])) for values in rows)
    parameters = (*with_last, both, np.ones(2 * m), None, bounds)
    constraint.compute_constraint_params = lambda *_: parameters
    grid = np.concatenate(([0.0], np.cumsum(steps)))
    interval = _PathInterval(path_interval=(grid[0], grid[-1]))
    solve: Callable[..., Any] = wrapper([constraint], interval, grid).solve_stagewise_optim
    return solve


@dataclass(frozen=True, slots=True)
class _PathInterval:
    """All that toppra's solver wants to know of a path when the constraint has the rest."""

    path_interval: tuple[float, float]


@functools.cache
def _toppra() -> tuple[Any, Any]:
    """Toppra's constraint base class and its solver, imported without matplotlib."""
    with _stand_ins("matplotlib", "matplotlib.pyplot"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its docstrings hold invalid escapes
        from toppra.constraint import LinearConstraint
        from toppra.solverwrapper import seidelWrapper
    return LinearConstraint, seidelWrapper


@contextmanager
def _stand_ins(*names: str) -> Iterator[None]:
    """Empty modules in place of those of ``names`` that are not loaded yet."""
    missing = {name: ModuleType(name) for name in names if name not in sys.modules}
    sys.modules.update(missing)
    try:
        yield
    finally:
        for name in missing:
            del sys.modules[name]
