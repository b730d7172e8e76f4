"""Segments of a tool path as curves: lines, arcs and rounded corners between them.

The curve of a segment is parametrised by the distance ``s`` from its start, also a little beyond
its ends. Where two segments meet, direction or curvature jumps, and an arm that moves on would have
to jump with it. A rounded corner leaves both segments some distance before and after their meeting
point and follows a polynomial of fifth degree that agrees with each in place, direction and
curvature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_mm
from so101_motion.planning.goals import ArcTo, LineTo

SHORTEST = 1e-6
"""Points closer than this are the same [m]. Chosen: a hundredth of the tolerance of a line."""

STRAIGHTEST = 1e-4
"""An arc is refused if its via point is nearer to the chord than this share of the chord. Chosen:
its radius would be more than a thousand times its length."""

_ROUNDS = 4  # iterations for the length of a rounded corner; each gains two digits

_ROUNDEST = 1.5
"""Shortest rounded corner, in ``reach``. Chosen: the corner of a path that turns back on itself has
hardly any length, and would become too tight to move through."""

_SAMPLES = 64  # number of points at which the length of a rounded corner is measured


class PathPoint(NamedTuple):
    """Points of a curve, each of shape (n, 3)."""

    p: Array  # where they are [m]
    direction: Array  # unit vectors along the curve
    curvature: Array  # change of direction per metre [1/m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Line:
    """A straight segment; or a point, whose length is only nominal."""

    p_start: Array  # start point, shape (3,), [m]
    p_end: Array  # end point [m]
    length: float  # length, or for a turn on the spot what it counts [m]

    def at(self, s: Array) -> PathPoint:
        """Points after ``s`` (n,) metres."""
        direction = (self.p_end - self.p_start) / self.length
        p = self.p_start + s[:, None] * direction
        return PathPoint(p, np.broadcast_to(direction, p.shape), np.zeros_like(p))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arc:
    """A part of a circle."""

    centre: Array  # of the circle, shape (3,), [m]
    first: Array  # unit vector from there to the start
    second: Array  # unit vector along the arc at the start
    radius: float  # [m]
    length: float  # [m]

    def at(self, s: Array) -> PathPoint:
        """Points after ``s`` (n,) metres."""
        c, t = np.cos(s / self.radius)[:, None], np.sin(s / self.radius)[:, None]
        outwards = c * self.first + t * self.second
        along = c * self.second - t * self.first
        return PathPoint(self.centre + self.radius * outwards, along, -outwards / self.radius)


SegmentCurve = Line | Arc


class Rounding(NamedTuple):
    """The curve around a corner."""

    length: float  # its length [m]; the parameter is the distance travelled only on average
    reach: float  # distance from the corner at which it leaves and meets the segments [m]
    # of four polynomials in the share of ``length`` done, shape (6, 4): the place [m], and the
    # place on the segments on either side as a distance from the corner, from ``-reach`` to
    # ``reach`` [m]
    coefficients: Array

    def at(self, s: Array) -> Array:
        """Place and distance from the corner after ``s`` (n,) metres, shape (n, 4), [m]."""
        return polynomial(self.coefficients, s / self.length)


def curve_of(p_start: Array, segment: LineTo | ArcTo, number: int) -> SegmentCurve:
    """The curve of one segment from ``p_start``; ``number`` is its number in messages.

    Raises:
        ConfigError: It has no length, or its three points are on no circle.
    """
    p_end = segment.T_base_tool.p
    chord = float(np.linalg.norm(p_end - p_start))
    if chord < SHORTEST:
        advice = ", or make a full circle of two arcs" if isinstance(segment, ArcTo) else ""
        raise ConfigError(
            "segments", number, f"segment {number} ends where it starts; leave it out{advice}"
        )
    if isinstance(segment, LineTo):
        return Line(p_start=p_start, p_end=p_end, length=chord)
    return _arc(p_start, segment.p_via, p_end, number)


def _arc(p_start: Array, p_via: Array, p_end: Array, number: int) -> Arc:
    """The arc through three points. Source: the circumcentre in barycentric coordinates."""
    to_via, to_end = p_via - p_start, p_end - p_start
    normal = np.cross(to_via, to_end)
    chord = float(np.linalg.norm(to_end))
    aside = float(np.linalg.norm(normal)) / chord
    if not aside > STRAIGHTEST * chord:
        raise ConfigError(
            "segments",
            number,
            f"the arc of segment {number} passes {to_mm(aside):.3g} mm beside the line between its"
            " ends, which is too straight for an arc; move its via point aside, or make it a line",
        )
    balance = (to_end @ to_end) * to_via - (to_via @ to_via) * to_end
    centre = p_start + np.cross(normal, balance) / (2.0 * (normal @ normal))
    radius = float(np.linalg.norm(p_start - centre))
    first = (p_start - centre) / radius
    second = np.cross(normal, first) / np.linalg.norm(normal)
    out = p_end - centre
    angle = math.atan2(float(out @ second), float(out @ first)) % (2.0 * math.pi)
    return Arc(centre=centre, first=first, second=second, radius=radius, length=radius * angle)


def rounded(before: SegmentCurve, after: SegmentCurve, reach: float) -> Rounding:
    """The rounded corner between two segments, ``reach`` [m] to either side."""
    ends = []
    for curve, at, off in ((before, before.length - reach, -reach), (after, reach, reach)):
        place, direction, curvature = (value[0] for value in curve.at(np.array([at])))
        ends.append((np.append(place, off), np.append(direction, 1.0), np.append(curvature, 0.0)))

    def through(length: float) -> Array:
        state = [value * length**k for end in ends for k, value in enumerate(end)]
        return quintic(*state)

    length = 2.0 * reach
    for _ in range(_ROUNDS):
        points = polynomial(through(length), np.linspace(0.0, 1.0, _SAMPLES + 1))[:, :3]
        measured = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        length = max(measured, _ROUNDEST * reach)
    return Rounding(length, reach, through(length))


def quintic(p0: Array, v0: Array, a0: Array, p1: Array, v1: Array, a1: Array) -> Array:
    """Coefficients (6, n) of the polynomial over 0 to 1 with these values and derivatives (n,)."""
    dp, dv, da = p1 - p0 - v0 - 0.5 * a0, v1 - v0 - a0, 0.5 * (a1 - a0)
    c3, c4, c5 = (
        10.0 * dp - 4.0 * dv + da,
        -15.0 * dp + 7.0 * dv - 2.0 * da,
        6.0 * dp - 3.0 * dv + da,
    )
    return np.array([p0, v0, 0.5 * a0, c3, c4, c5])


def polynomial(coefficients: Array, u: Array) -> Array:
    """Values of n polynomials, shape (m, n), at ``u`` (m,)."""
    value = np.zeros((len(u), coefficients.shape[1]))
    for coefficient in coefficients[::-1]:
        value = value * u[:, None] + coefficient
    return value
