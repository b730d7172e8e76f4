"""Choose and colour the points of an atlas for display."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.geometry import Array
from so101_motion.common.units import to_mm
from so101_motion.tasks.sweeps.atlas import Atlas, Reach


class Figure(NamedTuple):
    """A figure of a point that can be shown as its colour."""

    name: str  # its field in ``Reach``
    unit: str  # the unit for display
    scale: float  # factor from SI to that unit
    low: float  # the value of the first colour, in SI
    high: float  # the value of the last colour


FIGURES = {
    "Torque left": Figure("torque_left", "%", 100.0, 0.0, 1.0),
    "Clearance": Figure("clearance", "mm", 1e3, 0.0, 0.06),
    "Manipulability": Figure("manipulability", "l", 1e3, 0.0, 0.012),
    "Ways to be there": Figure("ways", "", 1.0, 0.0, 40.0),
}
"""The figures that can be shown, by their names on the page."""

AXES = "xyz"

_COLOURS = np.array(
    [(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)], dtype=float
)
"""From bad to good: five of the colours of viridis (S. van der Walt and N. Smith, 2015)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """A choice of points to show."""

    figure: str = "Torque left"  # one of ``FIGURES``
    at_least: float = 0.0  # points with less of it are left out, in SI
    axis: str | None = None  # the normal of a slice, one of ``AXES``; None for all points
    at: float = 0.0  # where the slice is [m]


class Voxels(NamedTuple):
    """Points with their colours."""

    rows: NDArray[np.int64]  # their rows in the atlas, shape (n,)
    p: Array  # their positions, shape (n, 3), [m]
    colours: NDArray[np.uint8]  # their colours, shape (n, 3), 0 to 255
    total: int  # how many were chosen, with those that are hidden inside


def shades(figure: str, values: Array) -> NDArray[np.uint8]:
    """The colours of values, shape (n,), in SI; shape (n, 3), 0 to 255."""
    of = FIGURES[figure]
    at = np.clip((values - of.low) / (of.high - of.low), 0.0, 1.0) * (len(_COLOURS) - 1)
    stops = np.arange(len(_COLOURS))
    columns = [np.interp(at, stops, column) for column in _COLOURS.T]
    return np.stack(columns, axis=-1).round().astype(np.uint8)


def voxels(atlas: Atlas, shown: Shown) -> Voxels:
    """The chosen points of an atlas that can be seen, because they are not surrounded by others."""
    steps = atlas.grid.steps(atlas.points)
    rows = _chosen(atlas, shown, steps)
    nx, ny, nz = atlas.grid.counts
    there = np.zeros((nx + 2, ny + 2, nz + 2), dtype=bool)
    i, j, k = (steps[rows] + 1).T
    there[i, j, k] = True
    inside = there[i - 1, j, k] & there[i + 1, j, k] & there[i, j - 1, k] & there[i, j + 1, k]
    inside &= there[i, j, k - 1] & there[i, j, k + 1]
    seen = rows[~inside]
    values = atlas.rows[FIGURES[shown.figure].name][seen].astype(float)
    p = atlas.grid.points(atlas.points[seen])
    return Voxels(seen, p, shades(shown.figure, values), len(rows))


def in_words(reach: Reach, p: Array) -> str:
    """Text that describes a point, shape (3,), [m], in three lines."""
    x, y, z = to_mm(p).tolist()
    return "\n".join(
        [
            f"({x:.0f}, {y:.0f}, {z:.0f}) mm",
            f"{reach.ways} ways; {', '.join(reach.branch_names) or 'none free'}",
            f"clearance {1e3 * reach.clearance:.0f} mm, {100.0 * reach.torque_left:.0f} % torque"
            f" left, manipulability {1e3 * reach.manipulability:.2f} l",
        ]
    )


def _chosen(atlas: Atlas, shown: Shown, steps: NDArray[np.int64]) -> NDArray[np.int64]:
    rows = atlas.rows
    good = (rows["ways"] > 0) & (rows["torque_left"] >= 0.0)
    good &= rows[FIGURES[shown.figure].name] >= shown.at_least
    if shown.axis is not None:
        axis = AXES.index(shown.axis)
        at = round(shown.at / atlas.grid.spacing) - atlas.grid.first[axis]
        good &= steps[:, axis] == at
    return np.flatnonzero(good)
