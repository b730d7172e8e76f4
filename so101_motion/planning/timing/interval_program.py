"""Find the largest squared speed at which a motion may enter one interval of a path.

This is the linear program in two unknowns of TOPP-RA (Pham and Pham, A New Approach to Time-Optimal
Path Parameterization Based on Reachability Analysis, 2018): the largest ``x`` for which some ``u``
keeps ``|a u + b x + c| <= 1`` in every row and reaches the next interval within its own largest
square, ``0 <= x + 2 step u <= next``. toppra solves it where it is installed; this solver is for
systems that toppra has no wheels for. Both agree to 1e-12; the tests hold them to 1e-9.

How it works: at a given x each row bounds u from above and from below by a line in x. The gap
between the lowest upper bound and the highest lower bound is concave in x. So Newton's method, from
the largest x that the speed limits allow, goes down to the largest x without a negative gap;
because the bounds are lines, it gets there exactly after a few steps.

``toppra_solver`` solves it with toppra, where that is installed.

toppra has wheels for x86-64 Linux only. It is imported on first use, and only here. It imports
matplotlib for a plotting method, which takes seconds and more memory than the planner; empty
modules replace matplotlib during that one import. In the planning process they replace SciPy's
splines and sparse matrices as well, see ``import_toppra_alone``.
"""

from __future__ import annotations

import functools
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from so101_motion.common.geometry import Array


def toppra_solver(steps: Array, rows: LimitRows, cap: Array) -> Solver:
    """Like :func:`interval_program.exact_solver`.

    Raises:
        ModuleNotFoundError: toppra is not installed.
    """
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
    optimum = wrapper([constraint], interval, grid).solve_stagewise_optim
    upward, free = np.array([1e-9, -1.0]), float("nan")

    def solve(i: int, largest_next: float) -> float:
        x: float = optimum(i, None, upward, free, free, 0.0, largest_next)[1]
        return x if x > 0.0 else 0.0  # NaN if there is none

    return solve


@dataclass(frozen=True, slots=True)
class _PathInterval:
    """The only part of a path that toppra's solver reads; the constraint has the rest."""

    path_interval: tuple[float, float]


def import_toppra_alone() -> None:
    """Import toppra, if it is installed, without SciPy, which its solver does not use.

    Only for a process in which nobody else uses toppra: its splines do not work then. The planning
    process starts with 0.43 s of processor time and 106 MB, instead of 0.8 s and 150 MB.
    """
    with suppress(ModuleNotFoundError), _stand_ins("scipy.interpolate", "scipy.sparse"):
        _toppra()


@functools.cache
def _toppra() -> tuple[Any, Any]:
    """Toppra's constraint base class and its solver, imported without matplotlib."""
    with _stand_ins("matplotlib", "matplotlib.pyplot"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its docstrings hold invalid escapes
        from toppra.constraint import LinearConstraint
        from toppra.solverwrapper import seidelWrapper
    return LinearConstraint, seidelWrapper


class _StandIn(ModuleType):
    """A module that has every public name."""

    def __getattr__(self, name: str) -> type:
        if name.startswith("__"):
            raise AttributeError(name)
        return object


@contextmanager
def _stand_ins(*names: str) -> Iterator[None]:
    """Empty modules in place of those of ``names`` that are not loaded yet."""
    missing = {name: _StandIn(name) for name in names if name not in sys.modules}
    sys.modules.update(missing)
    try:
        yield
    finally:
        for name in missing:
            del sys.modules[name]


Solver = Callable[[int, float], float]
"""From an interval and the largest squared speed at its end to the largest at its beginning.

It is 0 where there is none.
"""

_LEAST = 1e-12
"""A row with a smaller factor of u, in scaled units, bounds x alone."""

_EQUAL = 1.0 - 1e-15
"""A step to more than this share of x is rounding, and the last one."""


class LimitRows(NamedTuple):
    """Limits on the motion along a path, ``|a u + b x + c| <= 1``; each shape (N, m).

    Attributes:
        a: Factors of the acceleration along the path [s^2/rad].
        b: Factors of the squared speed along it [s^2/rad^2].
        c: The part of the limit used at rest; less than 1 in magnitude.
    """

    a: Array
    b: Array
    c: Array


def exact_solver(steps: Array, rows: LimitRows, cap: Array) -> Solver:
    """Our own solver for N intervals of lengths ``steps`` (N,) [rad].

    ``cap`` is the largest squared speed at their ends, shape (N + 1,), [rad^2/s^2].
    """
    bounds_u = np.abs(rows.a) > _LEAST
    a = np.where(bounds_u, rows.a, 1.0)
    slopes = np.where(bounds_u, rows.b / a, 0.0)
    upper, lower = (
        np.where(bounds_u, (side - np.sign(a) * rows.c) / np.abs(a), side * np.inf)
        for side in (1.0, -1.0)
    )
    bounds_x = ~bounds_u & (rows.b != 0.0)
    b = np.where(bounds_x, rows.b, 1.0)
    alone = np.where(bounds_x, (1.0 - np.sign(b) * rows.c) / np.abs(b), np.inf).min(axis=1)
    above, below = (
        [[(p, r) for p, r in interval] for interval in np.stack((side, slopes), axis=2).tolist()]
        for side in (upper, lower)
    )
    caps, twice = np.minimum(cap[:-1], alone).tolist(), (2.0 * steps).tolist()

    def solve(i: int, largest_next: float) -> float:
        to_next = 1.0 / twice[i]
        highest = [*above[i], (largest_next * to_next, to_next)]
        lowest = [*below[i], (0.0, to_next)]
        return _largest_square(highest, lowest, caps[i])

    return solve


def _largest_square(
    above: list[tuple[float, float]], below: list[tuple[float, float]], x: float
) -> float:
    """The largest square up to ``x`` with a u between all lines ``p - r x``, given as (p, r)."""
    while True:
        top, r_top = min([(p - r * x, r) for p, r in above])
        bottom, r_bottom = max([(p - r * x, r) for p, r in below])
        gap, rise = top - bottom, r_bottom - r_top
        if gap >= 0.0:
            return x
        if rise >= 0.0:  # nor below
            return 0.0
        lower = x - gap / rise
        if lower >= _EQUAL * x:
            return x
        if lower <= 0.0:
            return 0.0
        x = lower
