"""Joint paths as piecewise cubic curves, without time.

A path is a chain of cubic pieces over a parameter ``s`` that runs from 0 to ``length`` in radians
of joint space. Two functions make one through waypoints: :func:`spline_path` passes through every
point with continuous curvature and may swing wide between them; :func:`blended_path` keeps to the
straight lines between the points and rounds the corners by no more than a given tolerance, so
that a collision-free polyline stays free within that bound.

Curvature may jump where a straight piece meets a rounded one. :meth:`JointPath.on_pieces` gives it
on both sides of such a knot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.geometry import Array, freeze, frozen_array

SAME_POINT = 1e-9  # nearer waypoints are one [rad]; chosen


class PathPoints(NamedTuple):
    """Points of a path and their derivatives by ``s``."""

    q: Array  # joint angles, shape (..., n), [rad]
    q_s: Array  # first derivative by ``s``, same shape, [1]
    q_ss: Array  # second derivative by ``s``, same shape, [1/rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointPath:
    """A curve in joint space made of cubic pieces."""

    knots: Array  # ends of the pieces, shape (K + 1,), rising from 0, [rad]
    # shape (K, 4, n): with ``u = s - knots[k]`` the curve is ``q = c[k, 0] + c[k, 1] u + c[k, 2]
    # u^2 + c[k, 3] u^3``
    coefficients: Array

    def __post_init__(self) -> None:
        freeze(self, knots=(-1,))
        shape = (len(self.knots) - 1, 4, -1)
        freeze(self, coefficients=shape)
        if len(self.knots) < 2 or self.knots[0] != 0.0 or np.any(np.diff(self.knots) <= 0.0):
            raise ValueError("the knots of a path must rise from 0")

    @property
    def n(self) -> int:
        """How many joints."""
        return int(self.coefficients.shape[2])

    @property
    def length(self) -> float:
        """The end of the path [rad]."""
        return float(self.knots[-1])

    def evaluate(self, s: ArrayLike) -> PathPoints:
        """The curve at ``s``, shape (m,), [rad]; beyond the ends the end points.

        At a knot the curvature is that of the piece that begins there.
        """
        at = np.clip(np.asarray(s, dtype=np.float64), 0.0, self.length)
        piece = np.clip(np.searchsorted(self.knots, at, "right") - 1, 0, len(self.knots) - 2)
        return self.on_pieces(piece, at - self.knots[piece])

    def on_pieces(self, piece: ArrayLike, u: ArrayLike) -> PathPoints:
        """The curve at ``u`` [rad] from the start of each given piece; the shapes broadcast."""
        chosen = self.coefficients[np.asarray(piece)]
        c0, c1, c2, c3 = (chosen[..., k, :] for k in range(4))
        u = np.asarray(u, dtype=np.float64)[..., None]
        return PathPoints(
            q=c0 + u * (c1 + u * (c2 + u * c3)),
            q_s=c1 + u * (2.0 * c2 + (3.0 * u) * c3),
            q_ss=2.0 * c2 + (6.0 * u) * c3,
        )


def spline_path(waypoints: ArrayLike) -> JointPath:
    """The curve of continuous curvature through every waypoint.

    A natural cubic spline over the accumulated chord length: no curvature at the ends, where the
    motion starts and stops.

    Args:
        waypoints: Shape (m, n), [rad]; a point equal to the one before it counts once.


    Source: C. de Boor, A Practical Guide to Splines, 1978, chapter IV.
    """
    points, chords, lengths = _polyline(waypoints)
    right = 6.0 * np.diff(chords / lengths[:, None], axis=0)
    bends = np.zeros_like(points)
    bends[1:-1] = solved(2.0 * (lengths[:-1] + lengths[1:]), lengths[1:-1], right)
    return cubic_path(_accumulated(lengths), points, bends)


def cubic_path(knots: Array, points: Array, bends: Array) -> JointPath:
    """The curve through ``points`` (m, n) at ``knots`` (m,) with these second derivatives there."""
    h = np.diff(knots)[:, None]
    coefficients = np.stack(
        [
            points[:-1],
            np.diff(points, axis=0) / h - h * (2.0 * bends[:-1] + bends[1:]) / 6.0,
            bends[:-1] / 2.0,
            np.diff(bends, axis=0) / (6.0 * h),
        ],
        axis=1,
    )
    return JointPath(knots=knots, coefficients=coefficients)


def solved(diagonal: Array, beside: Array, right: Array) -> Array:
    """Solve a symmetric tridiagonal system, (m,) and (m - 1,), for right sides (m, n).

    By elimination without pivoting, which is safe because the diagonal of a spline's dominates.
    """
    scale, along, x = diagonal.tolist(), beside.tolist(), right.copy()
    for k in range(1, len(x)):
        factor = along[k - 1] / scale[k - 1]
        scale[k] -= factor * along[k - 1]
        x[k] -= factor * x[k - 1]
    for k in range(len(x) - 1, -1, -1):
        x[k] = (x[k] - (along[k] * x[k + 1] if k < len(along) else 0.0)) / scale[k]
    return x


def blended_path(waypoints: ArrayLike, tolerance: ArrayLike) -> JointPath:
    """Straight lines through the waypoints with rounded corners.

    A corner becomes a parabola that leaves one line and meets the other at the distance ``reach``
    from the waypoint. With unit directions d1 and d2 it passes the waypoint at
    ``reach (d2 - d1) / 4``, and no joint is anywhere further than that from the lines; ``reach`` is
    chosen so that this is ``tolerance``, but never more than half of a neighbouring line.

    Args:
        waypoints: Shape (m, n), [rad]; a point equal to the one before it counts once.
        tolerance: How far each joint may leave the straight lines [rad], positive; one figure, or
            one for each corner if no two points are equal.
    """
    points, chords, lengths = _polyline(waypoints)
    corners = _corners(points, chords, lengths, tolerance)
    reach = np.concatenate(([0.0], corners.reach, [0.0]))
    # A line and the corner at its end, in turn; what has no length is left out.
    pieces = np.zeros((2 * len(chords) - 1, 4, points.shape[1]))
    directions = chords / lengths[:, None]
    pieces[::2, 0], pieces[::2, 1] = points[:-1] + reach[:-1, None] * directions, directions
    pieces[1::2, 0], pieces[1::2, 1] = corners.begin, corners.direction
    extent = np.empty(len(pieces))
    extent[::2], extent[1::2] = lengths - reach[:-1] - reach[1:], 2.0 * corners.reach
    exists = extent > np.where(np.arange(len(pieces)) % 2, 0.0, SAME_POINT)
    curved = corners.reach > 0.0
    pieces[1::2, 2][curved] = corners.turn[curved] / (4.0 * corners.reach[curved, None])
    return JointPath(knots=_accumulated(extent[exists]), coefficients=pieces[exists])


class Corners(NamedTuple):
    """The corners of a polyline, rounded as in :func:`blended_path`."""

    # how far from its waypoint each parabola begins and ends, shape (m,), [rad]; 0 where the line
    # is straight
    reach: Array
    begin: Array  # where it begins, shape (m, n), [rad]
    direction: Array  # the unit direction there, same shape
    turn: Array  # the change of direction, same shape

    def at(self, share: Array) -> Array:
        """Configurations at shares (k,) of each corner, 0 to 1, shape (m, k, n), [rad]."""
        s, reach = share[:, None], self.reach[:, None, None]
        along = 2.0 * s * self.direction[:, None] + s * s * self.turn[:, None]
        return np.asarray(self.begin[:, None] + reach * along)


def rounded_corners(waypoints: ArrayLike, tolerance: ArrayLike) -> Corners:
    """The corners of a :func:`blended_path`."""
    return _corners(*_polyline(waypoints), tolerance)


def _corners(points: Array, chords: Array, lengths: Array, tolerance: ArrayLike) -> Corners:
    tolerance = np.asarray(tolerance, dtype=np.float64)
    if not np.all((tolerance > 0.0) & (tolerance < np.inf)):
        raise ValueError(f"the corner tolerance must be positive and finite, got {tolerance}")
    directions = chords / lengths[:, None]
    turn = np.diff(directions, axis=0)
    largest = np.abs(turn).max(axis=1, initial=0.0)
    with np.errstate(divide="ignore", over="ignore"):
        reach = np.where(largest > SAME_POINT, 4.0 * tolerance / largest, 0.0)
    reach = np.minimum(reach, 0.5 * np.minimum(lengths[:-1], lengths[1:]))
    begin = points[1:-1] - reach[:, None] * directions[:-1]
    return Corners(reach, begin, directions[:-1], turn)


def _polyline(waypoints: ArrayLike) -> tuple[Array, Array, Array]:
    """The different points (m, n), the chords between them (m - 1, n) and their lengths."""
    points = frozen_array(waypoints, (-1, -1))
    if not np.all(np.isfinite(points)):
        raise ValueError("every waypoint must be finite")
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    different = points[np.append(True, steps > SAME_POINT)] if len(points) else points
    if len(different) < 2:
        raise ValueError("a path needs at least two different points")
    different[-1] = points[-1]  # the motion must end exactly there, and start at the first
    points = different
    chords = np.diff(points, axis=0)
    return points, chords, np.asarray(np.linalg.norm(chords, axis=1))


def _accumulated(lengths: Array) -> Array:
    return np.concatenate(([0.0], np.cumsum(lengths)))
