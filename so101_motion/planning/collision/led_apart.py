"""Prove that an arm that is led keeps apart from another one, or does nothing but part from it.

The compiled library does it (``native/apart.c``); without it, and while something is passed from
hand to hand, the same is done here with coal. ``apart.py`` has what holds for every motion.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.apart import (
    GUARDED,
    GUARDED_EARLY,
    PARTING,
    UNKNOWN,
    Meeting,
    answer,
    first_meeting,
    gaps,
    meeting,
    nearness,
)
from so101_motion.planning.collision.arm_bodies import ArmBodies
from so101_motion.planning.collision.course import STEP, Course

PUSHED = 0.7
"""Arms that are nearer than this share of what they have gained were moved by others; chosen, a
proof leaves three quarters of it."""

_SAME = 1e-7
"""Distances that differ by less are equal [m]; coal's rounding."""


@dataclass(slots=True)
class Gained:
    """What an arm that is led has gained from another that is too near.

    Attributes:
        room: How far they keep apart from now on [m]; 0 for nothing.
        lie: About how their bodies lie from each other, for the library: a hint, no more.
    """

    room: float = 0.0
    lie: Array = field(default_factory=lambda: np.zeros(0))


def led_apart(
    first: tuple[ArmBodies, Course],
    second: tuple[ArmBodies, Course],
    T_first_second: SE3,
    *,
    since: float,
    gained: Gained,
) -> Meeting | None:
    """Where an arm that is led would come too near to another, both stopping along their courses.

    Arms that are too near already may part: what they have gained they keep, and those that have
    less, such as one that braked into that, may do nothing but part.

    Args:
        first: The led arm's bodies and its course.
        second: Another's.
        T_first_second: Where the second's base is in the first's.
        since: From when on to look [s].
        gained: What they have gained, of the same two arms in every cycle; is changed.

    Returns:
        Where they would meet; None if nowhere.
    """
    a, b = first[0], second[0]
    if a.handle is not None and b.handle is not None and not a.passed | b.passed:
        figures = since, STEP, GUARDED, GUARDED_EARLY, PUSHED, PARTING
        size = 3 * len(a.objects) * len(b.objects)
        if len(gained.lie) != size:
            gained.lie = np.zeros(size)
        more = np.concatenate(([gained.room], gained.lie))
        found, out = answer("so101_led_apart", first, second, T_first_second, figures, more)
        if found != UNKNOWN:
            gained.room, gained.lie = float(out[4]), out[5:]
            return meeting(found, out, a, b)
    pair = first, second, T_first_second
    met = first_meeting(*pair, since=since, room=GUARDED, early=GUARDED_EARLY)
    if met is None:
        return None
    nearest = nearness(*pair, at=since, room=GUARDED)
    if nearest is None:
        gained.room = 0.0
        return met
    kept = gained.room if nearest >= PUSHED * gained.room else 0.0
    kept = max(kept, nearest - PARTING)
    if only_part(*pair, since=since, room=GUARDED):
        met = None
    elif kept > 0.0:
        met = first_meeting(*pair, since=since, room=kept, early=0.0)
    if met is None:
        gained.room = kept
    return met


def only_part(
    first: tuple[ArmBodies, Course],
    second: tuple[ArmBodies, Course],
    T_first_second: SE3,
    *,
    since: float,
    room: float,
) -> bool:
    """Whether no two bodies come nearer than they are, or nearer than ``room`` [m].

    Looked at by coal every ``STEP`` until both rest, at first twice as often. Never while something
    is passed from hand to hand.

    Args:
        first: An arm's bodies and its course.
        second: Another's.
        T_first_second: Where the second's base is in the first's.
        since: From when on to look [s].
        room: What is far enough [m].
    """
    if first[0].passed | second[0].passed:
        return False
    left = max(first[1].end, second[1].end) - since
    soon, later = np.arange(0.0, 2.0 * STEP, 0.5 * STEP), np.arange(2.0 * STEP, left, STEP)
    times = since + np.append(np.append(soon[soon < left], later), max(left, 0.0))
    now, *after = gaps(first, second, T_first_second, times)
    enough = np.minimum(now, room) - _SAME
    return all(bool(np.all(each >= enough)) for each in after)
