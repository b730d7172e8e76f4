"""Prove that an arm that is led keeps apart from another one, or does nothing but part from it.

The compiled library does it (``native/apart.c``); without it, and while something is passed from
hand to hand, the same is done here with coal. ``apart.py`` has what holds for every motion.
"""

from __future__ import annotations

import ctypes
from functools import partial
from operator import is_

import numpy as np

from so101_motion.common.geometry import SE3
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
from so101_motion.planning.collision.batch_check import pointer
from so101_motion.planning.collision.course import STEP, Course, NearArms
from so101_motion.planning.native.library import native

PUSHED = 0.7
"""Arms that are nearer than this share of what they have gained were moved by others; chosen, a
proof leaves three quarters of it."""

RANGE = 0.03
"""From how near on, beyond ``GUARDED``, arms approach each other more slowly [m]; as guard.py's."""

_ROW = 8  # numbers of a body that is near, as in nearest.c

_SAME = 1e-7
"""Distances that differ by less are equal [m]; coal's rounding."""


class Beside:
    """What is known of an arm that is led beside another one, from cycle to cycle.

    Attributes:
        gained: How far they keep apart from now on, having been too near [m]; 0 for nothing.
    """

    def __init__(self) -> None:
        self.gained = 0.0
        self._of: tuple[ArmBodies, ArmBodies, SE3] | None = None
        self._memory, self._address = np.zeros(0), ctypes.c_void_p()

    @property
    def count(self) -> int:
        """How many bodies were near each other.

        0 without the library, and while something is passed from hand to hand.
        """
        return 0 if self._of is None else int(self._memory[1])

    def near(self, name: str) -> NearArms:
        """What was near.

        Args:
            name: What messages call the other arm.
        """
        rows = self._memory[2 : 2 + _ROW * self.count].reshape(-1, _ROW)
        return NearArms(rows[:, 0] - GUARDED, rows[:, 3:], partial(self._words, name))

    def _words(self, name: str, k: int) -> str:
        assert self._of is not None
        (a, b, _), row = self._of, self._memory[2 + _ROW * k :]
        return close(a.names[int(row[1])], name, b.names[int(row[2])])

    def of(self, a: ArmBodies, b: ArmBodies, T: SE3) -> ctypes.c_void_p | None:
        """Where the library keeps what it knows of two arms; None if it has nothing to say."""
        if a.handle is None or b.handle is None or a.passed | b.passed:
            self._of = None
            return None
        if self._of is None or not all(map(is_, self._of, (a, b, T))):
            library = native().library
            assert library is not None
            self._of = a, b, T
            self._memory = np.zeros(library.so101_beside_size() // 8)
            self._address = pointer(self._memory)
        self._memory[0] = self.gained
        return self._address

    def take(self) -> None:
        """Take over what the library has found."""
        self.gained = float(self._memory[0])


def led_apart(
    first: tuple[ArmBodies, Course],
    second: tuple[ArmBodies, Course],
    T_first_second: SE3,
    *,
    since: float,
    beside: Beside,
) -> Meeting | None:
    """Where an arm that is led would come too near to another, both stopping along their courses.

    Arms that are too near already may part: what they have gained they keep, and those that have
    less, such as one that braked into that, may do nothing but part.

    Args:
        first: The led arm's bodies and its course.
        second: Another's.
        T_first_second: Where the second's base is in the first's.
        since: From when on to look [s].
        beside: Of the same two arms in every cycle; is changed.

    Returns:
        Where they would meet; None if nowhere.
    """
    a, b = first[0], second[0]
    memory = beside.of(a, b, T_first_second)
    if memory is not None:
        figures = since, STEP, GUARDED, GUARDED_EARLY, PUSHED, PARTING, GUARDED + RANGE
        found, out = answer("so101_led_apart", first, second, T_first_second, figures, memory)
        if found != UNKNOWN:
            beside.take()
            return meeting(found, out, a, b)
    pair = first, second, T_first_second
    met = first_meeting(*pair, since=since, room=GUARDED, early=GUARDED_EARLY)
    if met is None:
        return None
    nearest = nearness(*pair, at=since, room=GUARDED)
    if nearest is None:
        beside.gained = 0.0
        return met
    kept = beside.gained if nearest >= PUSHED * beside.gained else 0.0
    kept = max(kept, nearest - PARTING)
    if only_part(*pair, since=since, room=GUARDED):
        met = None
    elif kept > 0.0:
        met = first_meeting(*pair, since=since, room=kept, early=0.0)
    if met is None:
        beside.gained = kept
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


def close(own: str, name: str, others: str) -> str:
    """Which bodies of two arms are close to each other, in words."""
    return f"the {own} close to {name}'s {others}"
