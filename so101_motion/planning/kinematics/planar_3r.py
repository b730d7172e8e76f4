"""Closed-form inverse kinematics of the three parallel joints (a planar 3R chain).

Once the pan has turned the arm's plane towards the target and the roll is chosen, the rest is a
chain of three bars in a plane: upper arm, forearm and hand, with hinges at shoulder, elbow and
wrist. Its end shall be at a point ``(x, z)``, measured from the shoulder, x forward and z up. Three
joints and two equations leave one freedom, the pitch of the hand.

For a given pitch the solution is elementary: the wrist is where the hand begins, and shoulder,
elbow and wrist form a triangle with three known sides, hence two configurations, elbow up and elbow
down (:meth:`ThreeBars.bends`).

Which pitches are possible? The distance from shoulder to wrist depends only on the angle between
the hand and the line from shoulder to target, so the elbow's limits allow one or two bands of
pitch. Within them a configuration can cease to exist only where the lift or the wrist is at a
limit, and each of these fixes the lengths of a triangle too: at most eight pitches in closed form.
Between two of them nothing changes (:meth:`ThreeBars.intervals`), so one test in the middle decides
for the whole interval. Whether a point can be reached is thus decided exactly, without a grid that
might miss a narrow gap.

Angles. Joint angles are positive downwards (they turn x towards -z), elevations upwards. The pitch
is ``q_lift + q_elbow + q_wrist``; the hand, a vector of given length from the wrist to the target,
has the elevation ``hand.elevation - pitch``.

Plain floats throughout: for three bars, numpy's call overhead costs more than the arithmetic.
"""

from __future__ import annotations

from math import acos, atan2, cos, hypot, pi, remainder, sin
from typing import NamedTuple

TAU = 2.0 * pi

JOINT_SLACK = 1e-6
"""Joint angles this far beyond a limit [rad] count as inside, and the caller clamps them: arccos
near a straight elbow loses that much. At full reach it moves the tool by half a micrometre.
Chosen."""

REACH_SLACK = 1e-5
"""For a wrist this far beyond the straight arm [m] the straight arm is a solution. Chosen: a tenth
of the tolerance of goals, and every solution is judged afterwards."""

_TINY = 1e-12  # lengths below this are this [m], so that no direction is undefined
_NEARLY = 1e-6  # how far a cosine may exceed 1 by rounding. Chosen; later checks are stricter

INSIDE = 1e-6
"""How far inside an interval of pitches its ends are tried, as a share of the interval. Chosen."""


class Bars(NamedTuple):
    """Measures of the chain, without the hand."""

    upper_arm: float  # shoulder to elbow [m]
    upper_arm_elevation: float  # its elevation when all joints are at zero [rad]
    forearm: float  # elbow to wrist [m]
    forearm_elevation: float  # its elevation when all joints are at zero [rad]
    lower: tuple[float, float, float]  # smallest angles of lift, elbow, wrist [rad]
    upper: tuple[float, float, float]  # largest angles of lift, elbow, wrist [rad]


class Hand(NamedTuple):
    """The third bar, from the wrist to the frame that shall reach the target."""

    length: float  # wrist to the frame's origin, within the plane [m]
    elevation: float  # elevation of that vector at pitch zero [rad]


class Target(NamedTuple):
    """The wanted end of the hand, from the shoulder: forward and up [m]."""

    x: float
    z: float
    hand: Hand


Angles = tuple[float, float, float]  # lift, elbow and wrist [rad]


class Bend(NamedTuple):
    """A configuration of the three joints."""

    angles: Angles  # lift, elbow and wrist [rad]
    elbow_up: bool  # whether the elbow is above the line from shoulder to wrist


class ThreeBars:
    """Closed-form solutions for the chain of :class:`Bars`."""

    def __init__(self, bars: Bars) -> None:
        self.bars = bars
        self._a, self._elevation_a, self._b, self._elevation_b = bars[:4]
        self.straight = self._elevation_b - self._elevation_a
        """The elbow angle at which upper arm and forearm are in line [rad]."""
        a, b = self._a, self._b
        self._squares, self._twice = a * a + b * b, 2.0 * a * b
        self._slack = (a + b + REACH_SLACK) ** 2 - (a + b) ** 2
        self.cos_max = ((a + b + REACH_SLACK) ** 2 - self._squares) / self._twice
        """Cosine of the elbow's bend above which the wrist is out of reach."""
        self.low = [limit - JOINT_SLACK for limit in bars.lower]
        self.high = [limit + JOINT_SLACK for limit in bars.upper]
        """Limits of lift, elbow and wrist with their slack [rad]."""
        # Distance from shoulder to wrist, squared, with the elbow as far up or down as it bends.
        self._shortest = {
            elbow_up: self._squares + self._twice * cos(self.straight - limit)
            for elbow_up, limit in ((True, bars.upper[1]), (False, bars.lower[1]))
        }
        self._wrist_limits = (bars.lower[2], bars.upper[2])
        # Where the elbow is, from the shoulder, with the lift at a limit.
        elevations = [self._elevation_a - limit for limit in (bars.lower[0], bars.upper[0])]
        self._elbows = [(a * cos(elevation), a * sin(elevation)) for elevation in elevations]

    @property
    def constants(self) -> tuple[float, ...]:
        """Constants of the chain, in the order of ``arm_ik.c``."""
        shortest = self._shortest[False], self._shortest[True]
        return (self.straight, self._squares, self._twice, self._slack, self.cos_max, *shortest)

    def points(self, angles: Angles, hand: Hand) -> tuple[tuple[float, float], ...]:
        """Shoulder, elbow, wrist and the hand's end, forward and up from the shoulder [m]."""
        lift, elbow, wrist = angles
        points = [(0.0, 0.0)]
        for length, elevation in (
            (self._a, self._elevation_a - lift),
            (self._b, self._elevation_b - lift - elbow),
            (hand.length, hand.elevation - lift - elbow - wrist),
        ):
            x, z = points[-1]
            points.append((x + length * cos(elevation), z + length * sin(elevation)))
        return tuple(points)

    def bends(self, target: Target, pitch: float) -> list[Bend]:
        """All configurations inside the limits with the given pitch [rad]; 0 to 2."""
        x, z, (length, elevation) = target
        elevation -= pitch
        x -= length * cos(elevation)
        z -= length * sin(elevation)
        cosine = (x * x + z * z - self._squares) / self._twice
        if not -1.0 <= cosine <= self.cos_max:
            return []
        fold = acos(cosine) if cosine < 1.0 else 0.0
        lean = atan2(self._b * sin(fold), self._a + self._b * cosine)
        found = []
        for elbow_up in (True, False):
            if not elbow_up:
                fold, lean = -fold, -lean
            elbow = self.straight + fold
            lift = remainder(self._elevation_a - atan2(z, x) - lean, TAU)
            angles = lift, elbow, remainder(pitch - lift - elbow, TAU)
            if self.allows(angles):
                found.append(Bend(angles, elbow_up))
        return found[:1] if fold == 0.0 else found

    def intervals(
        self, target: Target, pitch: float, elbow_up: bool
    ) -> list[tuple[float, float, float]]:
        """Intervals of pitch within which no configuration appears or vanishes, nearest first.

        Returns:
            For each its distance from ``pitch``, its lower and its upper end [rad]. Ends may lie
            beyond pi. Pitches that the elbow forbids are in none.
        """
        found: list[tuple[float, float, float]] = []
        bands = self._bands(target, elbow_up)
        if not bands:
            return found
        aligned = target.hand.elevation - atan2(target.z, target.x)
        splits = self._splits(target)
        home = pitch - aligned
        for low, high in bands:
            ends = [high]
            for split in splits:
                inside = (split - low) % TAU + low
                if inside < high:
                    ends.append(inside)
            ends.sort()
            for end in ends:
                away = abs(remainder(home - 0.5 * (low + end), TAU)) - 0.5 * (end - low)
                # Equally near intervals must compare as equal despite rounding.
                away = round(away, 9) if away > 0.0 else 0.0
                found.append((away, aligned + low, aligned + end))
                low = end
        found.sort()
        return found

    def _bands(self, target: Target, elbow_up: bool) -> list[tuple[float, float]]:
        """The bands the elbow's limits allow, as angles of the hand below the line to the target.

        The more the hand is turned out of that line, to either side, the farther the wrist is from
        the shoulder.
        """
        x, z, (hand, _) = target
        square = x * x + z * z + hand * hand
        twice = 2.0 * max(hypot(x, z), _TINY) * max(hand, _TINY)
        bent = (square - self._shortest[elbow_up]) / twice
        straight = (square - self._squares - self._twice) / twice
        if bent < -1.0 - _NEARLY or straight > 1.0 + self._slack / twice:
            return []
        inner = acos(max(bent, -1.0)) if bent < 1.0 else 0.0
        outer = pi if straight <= -1.0 else acos(min(straight, 1.0))
        if inner == 0.0:
            return [(-outer, outer)]
        if outer == pi:
            return [(inner, TAU - inner)]
        return [(inner, outer), (-outer, -inner)]

    def _splits(self, target: Target) -> list[float]:
        """The same angles at which lift or wrist is at a limit."""
        x, z, (hand, hand_elevation) = target
        a, b = self._a, self._b
        hand, distance, elevation = max(hand, _TINY), max(hypot(x, z), _TINY), atan2(z, x)
        found: list[float] = []
        for limit in self._wrist_limits:
            bend = hand_elevation - self._elevation_b - limit
            outer_x, outer_z = b + hand * cos(bend), hand * sin(bend)
            outer = max(hypot(outer_x, outer_z), _TINY)
            cosine = (distance * distance + outer * outer - a * a) / (2.0 * distance * outer)
            if -1.0 < cosine < 1.0:
                angle, middle = acos(cosine), atan2(outer_z, outer_x) - bend
                found += (middle - angle, middle + angle)
        for elbow_x, elbow_z in self._elbows:
            dx, dz = x - elbow_x, z - elbow_z
            d = max(hypot(dx, dz), _TINY)
            cosine = (d * d + hand * hand - b * b) / (2.0 * d * hand)
            if -1.0 < cosine < 1.0:
                angle, middle = acos(cosine), elevation - atan2(dz, dx)
                found += (middle - angle, middle + angle)
        return found

    def allows(self, angles: Angles) -> bool:
        """Whether joint angles are inside their limits, to within ``JOINT_SLACK``."""
        (lift, elbow, wrist), low, high = angles, self.low, self.high
        return (
            low[1] <= elbow <= high[1] and low[2] <= wrist <= high[2] and low[0] <= lift <= high[0]
        )

    def nearest_pitch(self, target: Target, pitch: float) -> list[Bend]:
        """The configurations whose pitch is nearest to a given one [rad]; 0 to 2."""
        bends = self.bends(target, pitch)
        if bends:
            return bends
        intervals = [
            (*interval, elbow_up)
            for elbow_up in (True, False)
            for interval in self.intervals(target, pitch, elbow_up)
        ]
        for _, low, high, elbow_up in sorted(intervals):
            middle = 0.5 * (low + high)
            if any(bend.elbow_up == elbow_up for bend in self.bends(target, middle)):
                half = (0.5 - INSIDE) * (high - low)
                ahead = remainder(pitch - middle, TAU)
                return self.bends(target, middle + min(max(ahead, -half), half))
        return []
