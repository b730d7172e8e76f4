"""Solve the linear program of one interval with toppra, where it is installed.

toppra has wheels for x86-64 Linux only. It is imported on first use, and only here. It imports
matplotlib for a plotting method, which takes seconds and more memory than the planner; empty
modules replace matplotlib during that one import.
"""

from __future__ import annotations

import functools
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.timing.interval_program import LimitRows, Solver


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
