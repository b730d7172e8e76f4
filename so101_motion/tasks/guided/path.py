"""A path that was recorded by hand guiding, and its reduction to few points.

A straight line may replace a stretch if every point of it is near that line, *in the order of the
points*: if a hand wipes to and fro over one place, the replay must do so too. So a point is
compared with the farthest place on the line reached until then (after Douglas and Peucker, 1973).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from so101_motion.common.geometry import Array, freeze
from so101_motion.planning.kinematics.model import RobotModel

TOLERANCE = np.radians(2.0)
"""How far a joint may be from the recorded path by default [rad]; chosen: a hand trembles by some
tenths of a degree, and a wider tolerance makes a faster and smoother motion."""

JAW_TOLERANCE = 0.02  # the same for the jaw, share of its travel; chosen
_DRAWN = 400  # points at most of the line that is drawn
_SPACING = np.radians(0.5)  # of the places on a polyline that points are compared with [rad]
_WINDOW = 120  # places before and after the best one that are looked at: 60 deg; chosen
_CORNER = 24  # places that points may leave out at once, where they cut a corner; chosen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GuidedPath:
    """The path along which a hand has guided the arm."""

    t: Array  # times, from 0 on, increasing, shape (n,), n >= 1, [s]
    q: Array  # joint angles, shape (n, 5), [rad]
    aperture: Array | None = None  # of the jaw, 0 to 1, shape (n,); None for an arm without one

    def __post_init__(self) -> None:
        freeze(self, t=(-1,))
        n = len(self.t)
        freeze(self, q=(-1, 5))
        if self.aperture is not None:
            freeze(self, aperture=(-1,))
        jaw = np.zeros(n) if self.aperture is None else self.aperture
        if n == 0 or len(self.q) != n or len(jaw) != n:
            raise ValueError(f"{n} times, {len(self.q)} configurations and {len(jaw)} apertures")
        if not (np.isfinite(self.t).all() and np.isfinite(self.q).all() and np.isfinite(jaw).all()):
            raise ValueError("a path must be finite")
        if self.t[0] != 0.0 or np.any(np.diff(self.t) <= 0.0):
            raise ValueError("the times of a path must begin at 0 and increase")
        if np.any((jaw < 0.0) | (jaw > 1.0)):
            raise ValueError("an aperture must be 0 to 1")

    def __len__(self) -> int:
        return len(self.t)

    @property
    def duration(self) -> float:
        """How long the recording took [s]."""
        return float(self.t[-1])

    def taken(self, chosen: NDArray[np.intp] | slice) -> GuidedPath:
        """Some of its points, by index; times count from the first of them."""
        t = self.t[chosen]
        jaw = None if self.aperture is None else self.aperture[chosen]
        return GuidedPath(t=t - t[0], q=self.q[chosen], aperture=jaw)

    def thinned(self, tolerance: float = TOLERANCE) -> GuidedPath:
        """The path without points that are within ``tolerance`` [rad] of lines between others."""
        return self.taken(self.corners(tolerance))

    def corners(self, tolerance: float) -> NDArray[np.intp]:
        """The indices of the points that ``thinned`` keeps, the ends included."""
        x = self.q if self.aperture is None else np.column_stack(
            [self.q, self.aperture * (tolerance / JAW_TOLERANCE)]
        )  # fmt: skip
        return corners_of(x, tolerance)


def tool_line(path: GuidedPath) -> Array:
    """Where the tool is along a path, to draw it: shape (m, 3), m <= 400, in the base frame [m]."""
    model = RobotModel.load()
    keep = np.unique(np.linspace(0, len(path) - 1, _DRAWN).astype(int))
    return np.array([model.frame(q).p for q in path.q[keep]])


def corners_of(x: Array, tolerance: float) -> NDArray[np.intp]:
    """The fewest points of ``x``, shape (n, d), whose polyline stays near all points; indices.

    Both ends are among them. No coordinate of a point that is left out is further than
    ``tolerance`` from the straight line between the kept ones beside it.
    """
    kept, spans = {0, len(x) - 1}, [(0, len(x) - 1)]
    while spans:
        begin, end = spans.pop()
        off = _off_line(x[begin : end + 1])
        worst = int(np.argmax(off))
        if off[worst] > tolerance:
            kept.add(begin + worst)
            spans += [(begin, begin + worst), (begin + worst, end)]
    return np.array(sorted(kept))


def _off_line(x: Array) -> Array:
    """Distances of points, shape (m, d), from the line between first and last, in order, (m,)."""
    line = x[-1] - x[0]
    square = float(line @ line)
    share = np.zeros(len(x)) if square == 0.0 else np.clip((x - x[0]) @ line / square, 0.0, 1.0)
    share = np.maximum.accumulate(share)
    off = np.abs(x - x[0] - share[:, None] * line).max(axis=1)
    off[[0, -1]] = 0.0
    return np.asarray(off)


def along(corners: Array, points: Array) -> Array:
    """The places on a polyline of points that follow it, as corner number and share, shape (n,).

    ``corners`` have shape (m, d), m >= 2, ``points`` (n, d), [rad]. Places go from 0 to ``m - 1``
    and never fall.
    """
    parts = 1 + np.ceil(np.abs(np.diff(corners, axis=0)).max(axis=1) / _SPACING).astype(int)
    where = np.concatenate(
        [k + np.arange(parts[k]) / parts[k] for k in range(len(parts))] + [[float(len(parts))]]
    )
    places = np.column_stack([np.interp(where, np.arange(len(corners)), x) for x in corners.T])
    near = _in_order(places, points)
    ends = np.clip(near[None] + np.array([[-1, 0], [0, 1]])[..., None], 0, len(places) - 1)
    off, found = [], []
    for a, b in ends:
        line = places[b] - places[a]
        square = np.maximum((line * line).sum(axis=1), 1e-300)
        share = np.clip(((points - places[a]) * line).sum(axis=1) / square, 0.0, 1.0)
        off.append(np.square(points - places[a] - share[:, None] * line).sum(axis=1))
        found.append(where[a] + share * (where[b] - where[a]))
    return np.maximum.accumulate(np.where(off[0] < off[1], found[0], found[1]))


def _in_order(places: Array, points: Array) -> NDArray[np.intp]:
    """The places of points in rising order, with the least sum of squared distances.

    From point to point a place goes on no further than points and corners may take it, and only
    places near the best one so far are looked at: memory and time grow with the number of points.
    """
    n = len(points)
    steps = np.abs(np.diff(points, axis=0)).max(axis=1, initial=0.0)
    most = (_CORNER + 2 * np.ceil(steps / _SPACING) + 4 * np.ceil(len(places) / n)).astype(int)
    window = max(_WINDOW, 2 * int(most.max(initial=0)))
    total = np.full(2 * window, np.inf)
    total[: len(places)] = np.square(places[: 2 * window] - points[0]).sum(axis=1)
    first = np.zeros(n, dtype=np.intp)  # where each window begins
    back = np.zeros((n, 2 * window), dtype=np.int32)  # how far each place went on
    for k in range(1, n):
        ahead = max(0, int(np.argmin(total)) - window)
        first[k], m = first[k - 1] + ahead, int(most[k - 1])
        known = np.concatenate([np.full(m, np.inf), total[ahead:], np.full(ahead, np.inf)])
        before = sliding_window_view(known, m + 1)[:, ::-1]  # of each place, the nearest first
        back[k] = np.argmin(before, axis=1)
        near = places[first[k] : first[k] + 2 * window]
        total = before[np.arange(2 * window), back[k]]
        total[: len(near)] += np.square(near - points[k]).sum(axis=1)
        total[len(near) :] = np.inf
    chosen = np.empty(n, dtype=np.intp)
    chosen[-1] = first[-1] + int(np.argmin(total))
    for k in range(n - 1, 0, -1):
        chosen[k - 1] = chosen[k] - back[k, chosen[k] - first[k]]
    return chosen
