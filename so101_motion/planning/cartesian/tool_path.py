"""Tool paths: lines and arcs of a gripper frame, with rounded corners.

How it works. A path is a chain of parts with one parameter ``s`` in metres. On a line or an arc the
frame turns steadily from the orientation at one end to that at the other. Within ``blend`` metres
of a corner the path follows a rounding instead, so the arm need not stop: a polynomial of fifth
degree that agrees with both segments in place, direction and curvature. There both steady turns are
continued beyond the corner, and a smooth weight blends them. Without blending the arm rests at each
corner.

``s`` is the distance the frame travels, approximately so on roundings. A turn on the spot has no
length; its nominal length is its angle times ``LEVER``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array, rotation_vector
from so101_motion.common.units import to_mm
from so101_motion.planning.goals import ArcTo, LineTo

SHORTEST = 1e-6  # points closer than this are the same [m]; chosen, a hundredth of the tolerance
STRAIGHTEST = 1e-4  # least share of the chord by which an arc's via point is off it; chosen
_ROUNDS = 4  # iterations for the length of a rounded corner; each gains two digits
_ROUNDEST = 1.5  # shortest rounded corner, in ``reach``; chosen for paths that turn back
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
    """The curve of one segment from ``p_start``; ``number`` is its number in messages."""
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


Indices = NDArray[np.intp]

LEVER = 0.1  # length of a turn on the spot [m/rad]; chosen, from wrist to jaw


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Leg:
    """A segment without the ends that are cut off for roundings."""

    number: int  # number of the segment, from 0
    curve: SegmentCurve  # that of the whole segment
    R_start: Array  # orientation at its start, shape (3, 3)
    turn: Array  # rotation from its start to its end, as a rotation vector [rad]
    begin: float  # where on the segment the leg begins [m]
    end: float  # where it ends [m]

    @property
    def length(self) -> float:
        return self.end - self.begin

    def places(self, s: Array) -> Array:
        return self.curve.at(self.begin + s).p

    def rotations(self, s: Array) -> Array:
        return self.turned(self.begin + s)

    def turned(self, along: Array) -> Array:
        """Rotations ``along`` the whole segment (n,), beyond its ends too."""
        return np.asarray(
            self.R_start @ _rotations((along / self.curve.length)[:, None] * self.turn)
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Corner:
    """A rounded corner between two segments."""

    number: int  # of the segment after it
    before: _Leg  # the leg before it
    after: _Leg  # the leg after it
    rounding: Rounding  # its curve

    @property
    def length(self) -> float:
        return self.rounding.length

    def places(self, s: Array) -> Array:
        return self.rounding.at(s)[:, :3]

    def rotations(self, s: Array) -> Array:
        off = self.rounding.at(s)[:, 3]
        R_before = self.before.turned(self.before.curve.length + off)
        R_after = self.after.turned(off)
        weight = polynomial(_SMOOTH_STEP, 0.5 * (off / self.rounding.reach + 1.0))
        turns = R_before.transpose(0, 2, 1) @ R_after
        apart = np.array([rotation_vector(R) for R in turns]).reshape(-1, 3)
        return np.asarray(R_before @ _rotations(weight * apart))


_SMOOTH_STEP = quintic(*(np.array([value]) for value in (0.0, 0.0, 0.0, 1.0, 0.0, 0.0)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToolPath:
    """A path of the tool, from the start on."""

    parts: tuple[_Leg | _Corner, ...]  # legs and roundings
    spin: bool = False  # whether it is a turn on the spot
    begins: Array = field(init=False)  # where each part begins, shape (k,), [m]
    length: float = field(init=False)  # how long the path is [m]
    turn: float = field(init=False)  # how far the frame turns along it, all in all [rad]

    def __post_init__(self) -> None:
        ends = np.cumsum([part.length for part in self.parts])
        legs = [part for part in self.parts if isinstance(part, _Leg)]
        object.__setattr__(self, "begins", np.concatenate([[0.0], ends[:-1]]))
        object.__setattr__(self, "length", float(ends[-1]))
        object.__setattr__(self, "turn", sum(float(np.linalg.norm(leg.turn)) for leg in legs))

    @property
    def segments(self) -> int:
        """How many segments the path has."""
        return self.parts[-1].number + 1

    @property
    def rests(self) -> list[float]:
        """Where the arm has to stop between its start and its end [m]."""
        meetings = zip(pairwise(self.parts), self.begins[1:].tolist(), strict=True)
        return [at for (a, b), at in meetings if isinstance(a, _Leg) and isinstance(b, _Leg)]

    def segment_at(self, s: float) -> int:
        """The segment of a place on the path, from 0; a corner belongs to the segment after it."""
        return self.parts[int(self._part_at(np.array([s]))[0])].number

    def places(self, s: Array) -> Array:
        """Positions of the frame after ``s`` (n,) metres, shape (n, 3), [m]."""
        p = np.empty((len(s), 3))
        for part, here, along in self._split(s):
            p[here] = part.places(along)
        return p

    def rotations(self, s: Array) -> Array:
        """Orientations of the frame after ``s`` (n,) metres, shape (n, 3, 3)."""
        R = np.empty((len(s), 3, 3))
        for part, here, along in self._split(s):
            R[here] = part.rotations(along)
        return R

    def _part_at(self, s: Array) -> Indices:
        return np.asarray(np.searchsorted(self.begins, s, "right") - 1)

    def _split(self, s: Array) -> list[tuple[_Leg | _Corner, Indices, Array]]:
        """Parts that hold places, the indices of those, and how far along the part they are."""
        if len(self.parts) == 1:
            return [(self.parts[0], np.arange(len(s)), s)]
        at = self._part_at(s)
        split = []
        for i in np.unique(at):
            here = np.flatnonzero(at == i)
            split.append((self.parts[i], here, s[here] - self.begins[i]))
        return split


def straight_path(T_start: SE3, T_end: SE3) -> ToolPath:
    """One line, or a turn on the spot."""
    turn = rotation_vector(T_start.R.T @ T_end.R)
    length = float(np.linalg.norm(T_end.p - T_start.p))
    spin = length < SHORTEST
    if spin:
        length = max(LEVER * float(np.linalg.norm(turn)), SHORTEST)
    line = Line(p_start=T_start.p, p_end=T_end.p, length=length)
    leg = _Leg(number=0, curve=line, R_start=T_start.R, turn=turn, begin=0.0, end=length)
    return ToolPath(parts=(leg,), spin=spin)


def path_through(T_start: SE3, segments: Sequence[LineTo | ArcTo], blend: float) -> ToolPath:
    """A path of lines and arcs one after the other.

    ``blend`` is the distance from a corner within which it may leave them [m], at most half a
    segment; at 0 the arm rests at each corner.
    """
    legs = _legs(T_start, segments, blend)
    parts: list[_Leg | _Corner] = [legs[0]]
    for before, after in pairwise(legs):
        if blend > 0.0:
            rounding = rounded(before.curve, after.curve, after.begin)
            parts.append(
                _Corner(number=after.number, before=before, after=after, rounding=rounding)
            )
        parts.append(after)
    return ToolPath(parts=tuple(parts))


def _legs(T_start: SE3, segments: Sequence[LineTo | ArcTo], blend: float) -> list[_Leg]:
    """The segments, shortened where a corner is to be rounded."""
    starts = [T_start, *(segment.T_base_tool for segment in segments)]
    curves = [
        curve_of(T.p, segment, number)
        for number, (T, segment) in enumerate(zip(starts[:-1], segments, strict=True), 1)
    ]
    cuts = [
        min(blend, 0.5 * before.length, 0.5 * after.length) for before, after in pairwise(curves)
    ]
    return [
        _Leg(
            number=number,
            curve=curve,
            R_start=starts[number].R,
            turn=rotation_vector(starts[number].R.T @ starts[number + 1].R),
            begin=begin,
            end=curve.length - cut,
        )
        for number, (curve, begin, cut) in enumerate(
            zip(curves, [0.0, *cuts], [*cuts, 0.0], strict=True)
        )
    ]


def _rotations(vectors: Array) -> Array:
    """Rotations (n, 3, 3) by rotation vectors (n, 3) [rad]; Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    K = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -z, y, -x
    K -= K.transpose(0, 2, 1)
    half = np.sinc(0.5 * angle / np.pi)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * K + 0.5 * half**2 * (K @ K))
