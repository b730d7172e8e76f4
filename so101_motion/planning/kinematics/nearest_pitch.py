"""Find the configuration of the three parallel joints nearest to a seed, over all pitches.

Within an interval of pitches (``planar_3r.py``) the configuration changes smoothly, and so does its
distance from the seed. The slope of the distance is known in closed form, so the minimum is where
the slope vanishes, or at the end of the interval. Intervals too far from the seed's pitch are
skipped.

An interval can have more than one minimum. The search goes downhill from the seed's own pitch, or
from the interval's middle, and nearly always ends at the least one (the tests count how often).
"""

from __future__ import annotations

from collections.abc import Callable
from math import acos, atan2, cos, inf, nan, remainder, sin

from so101_motion.planning.kinematics.planar_3r import INSIDE, TAU, Angles, Bend, Target, ThreeBars

_FLAT = 1e-4
"""The search ends when the next secant step is smaller than this [rad]; the error of the squared
distance is then about its square. Chosen."""

_NOWHERE = (nan, nan, nan)

PitchSample = tuple[float, float, float, Angles]
"""Half the derivative of the squared distance from the seed by the pitch [rad], that distance
[rad^2], the pitch [rad], and lift, elbow and wrist [rad]. A plain tuple, because a named one costs
a third of computing its parts."""

Look = Callable[[float, bool], PitchSample]
"""From pitch [rad] and branch (whether the elbow is up) to the sample there."""


def nearest_bend(
    bars: ThreeBars, target: Target, seed: Angles, ceiling: float
) -> tuple[float, Bend] | None:
    """The configuration that reaches a target nearest to a seed, and its squared distance [rad^2].

    Args:
        target: The target.
        seed: The angles to stay near, possibly outside their limits [rad].
        ceiling: Only squared distances below this are of interest [rad^2].
    """
    best = None
    look = _look_from(bars, target, seed)
    home = sum(seed)
    for elbow_up in (True, False):
        # On either branch the elbow is on its side of the straight arm.
        gap = bars.straight - seed[1] if elbow_up else seed[1] - bars.straight
        if gap > 0.0 and gap * gap >= ceiling:
            continue
        for away, low, high in bars.intervals(target, home, elbow_up):
            # The three angles add up to the pitch: off by d, they are off by d^2 / 3 at least.
            if away * away >= 3.0 * ceiling:
                break
            pitch = 0.5 * (low + high)
            margin = INSIDE * (high - low)
            low, high = low + margin, high - margin
            if away == 0.0:
                pitch = min(max(pitch + remainder(home - pitch, TAU), low), high)
            start = look(pitch, elbow_up)
            if start[1] < inf:
                _, square, _, angles = _descend(look, elbow_up, start, low, high)
                if square < ceiling:
                    best, ceiling = (square, Bend(angles, elbow_up)), square
    return best


def _look_from(bars: ThreeBars, target: Target, seed: Angles) -> Look:
    """Make a function for the distance from the seed by pitch and branch.

    The joint velocities that keep the hand's end in place are in the ratio of the cross products of
    the vectors from two of the hinges to that end.

    Without a configuration inside the limits the distance is infinite. The function is a closure
    over plain names because this is the innermost loop.
    """
    x, z, (hand, hand_elevation) = target
    seed_lift, seed_elbow, seed_wrist = seed
    a, elevation_a, b, elevation_b = bars.bars[:4]
    straight, squares, twice = bars.straight, a * a + b * b, 2.0 * a * b
    cos_max = bars.cos_max
    (lift_low, elbow_low, wrist_low), (lift_high, elbow_high, wrist_high) = bars.low, bars.high

    def look(pitch: float, elbow_up: bool) -> PitchSample:
        elevation = hand_elevation - pitch
        hand_x, hand_z = hand * cos(elevation), hand * sin(elevation)
        wrist_x, wrist_z = x - hand_x, z - hand_z
        cosine = (wrist_x * wrist_x + wrist_z * wrist_z - squares) / twice
        if not -1.0 <= cosine <= cos_max:
            return 0.0, inf, pitch, _NOWHERE
        fold = acos(cosine) if cosine < 1.0 else 0.0
        if not elbow_up:
            fold = -fold
        q_elbow = straight + fold
        if not elbow_low <= q_elbow <= elbow_high:
            return 0.0, inf, pitch, _NOWHERE
        lean = atan2(b * sin(fold), a + b * cosine)
        q_lift = remainder(elevation_a - atan2(wrist_z, wrist_x) - lean, TAU)
        q_wrist = remainder(pitch - q_lift - q_elbow, TAU)
        if not (lift_low <= q_lift <= lift_high and wrist_low <= q_wrist <= wrist_high):
            return 0.0, inf, pitch, _NOWHERE

        elevation = elevation_b - q_lift - q_elbow
        outer_x, outer_z = b * cos(elevation) + hand_x, b * sin(elevation) + hand_z
        lift = outer_x * hand_z - outer_z * hand_x
        elbow = hand_x * z - hand_z * x
        wrist = x * outer_z - z * outer_x
        total = lift + elbow + wrist
        off_lift, off_elbow = q_lift - seed_lift, q_elbow - seed_elbow
        off_wrist = q_wrist - seed_wrist
        along = off_lift * lift + off_elbow * elbow + off_wrist * wrist
        square = off_lift * off_lift + off_elbow * off_elbow + off_wrist * off_wrist
        return along / total if total else 0.0, square, pitch, (q_lift, q_elbow, q_wrist)

    return look


def _descend(
    look: Look, elbow_up: bool, start: PitchSample, low: float, high: float
) -> PitchSample:
    """Follow a branch downhill from a pitch to the least distance within an interval.

    Secant steps inside a bracket find the zero of the slope.
    """
    near_slope, near_square, near, _ = start
    if near_slope == 0.0:
        return start
    end = look(low if near_slope > 0.0 else high, elbow_up)
    while near_slope * end[0] >= 0.0:
        if end[1] <= near_square:
            return end
        # The end is farther, but the distance falls there too: a minimum is in between.
        end = look(0.5 * (near + end[2]), elbow_up)
    far_slope, _, far, _ = end
    last_slope, last = near_slope, near
    pitch = near - near_slope * (far - near) / (far_slope - near_slope)
    while True:
        place = look(pitch, elbow_up)
        slope = place[0]
        if slope * near_slope > 0.0:
            near = pitch
        else:
            far = pitch
        change = slope - last_slope
        step = slope * (last - pitch) / change if change else 0.0
        if abs(step) < _FLAT or abs(far - near) < _FLAT:
            return place
        last_slope, last = slope, pitch
        pitch += step
        if not min(near, far) < pitch < max(near, far):
            pitch = 0.5 * (near + far)
