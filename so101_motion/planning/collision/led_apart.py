"""Prove that an arm that is led keeps apart from another one, or does nothing but part from it.

The compiled library does it (``native/apart.c``); without it, and while something is passed from
hand to hand, the same is done here with coal. ``apart.py`` has what holds for every motion.
"""

from __future__ import annotations

import ctypes
from functools import partial
from operator import is_

import numpy as np

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.apart import (
    GUARDED,
    GUARDED_EARLY,
    PARTING,
    UNKNOWN,
    Meeting,
    first_meeting,
    gaps,
    meeting,
    nearness,
    placement,
)
from so101_motion.planning.collision.arm_bodies import ArmBodies
from so101_motion.planning.collision.batch_check import pointer
from so101_motion.planning.collision.course import STEP, Course, NearArms
from so101_motion.planning.native.library import native

PUSHED = 0.7
"""Arms that are nearer than this share of what they have gained were moved by others; chosen, a
proof leaves seven eighths of it."""

RANGE = 0.03
"""From how near on, beyond ``GUARDED``, arms approach each other more slowly [m]; as guard.py's."""

GAP = 0.002
"""What stays free beyond what must when something is approached [m], and what is left, as a share,
of what a joint may hold. Chosen: the proof, which goes by what must, then has nothing to refuse."""

_BOUND, _ROW, _MOST = 7, 9, 24
"""Numbers of a bound, of a body that is near, and how many of these are told; as in native.h."""

_PLACES = 64
"""Courses of so many places need no new memory; chosen, a stop of a second has fewer."""

_SAME = 1e-7
"""Distances that differ by less are equal [m]; coal's rounding."""


class _Course(ctypes.Structure):
    _fields_ = [
        ("t", ctypes.c_double),
        ("dt", ctypes.c_double),
        ("n", ctypes.c_int),
        ("q", ctypes.c_void_p),
    ]


class _Asked(ctypes.Structure):
    """What stands in front in the library's ``Beside``."""

    _fields_ = [
        ("scene", ctypes.c_void_p * 2),
        ("levers", ctypes.c_void_p * 2),
        ("placement", ctypes.c_double * 12),
        ("course", _Course * 2),
        *(
            (name, ctypes.c_double)
            for name in ("since", "step", "margin", "skew", "pushed", "parting", "within", "gap")
        ),
        ("told", ctypes.c_double * 4),
        ("gained", ctypes.c_double),
        ("near", ctypes.c_double),
        ("row", ctypes.c_double * _ROW * _MOST),
    ]


class Beside:
    """What is known of an arm that is led beside another one, from cycle to cycle.

    Attributes:
        gained: How far they keep apart from now on, having been too near [m]; 0 for nothing.
    """

    def __init__(self) -> None:
        self.gained = 0.0
        self._of: tuple[ArmBodies, ArmBodies, SE3] | None = None
        self._asked, self._rows = _Asked(), np.zeros((0, _ROW))
        self._address = ctypes.c_void_p()
        self._courses: tuple[_Course, ...] = ()
        self._q = tuple[Array, ...]()  # the courses' places, where the library reads them

    @property
    def count(self) -> int:
        """How many bodies were near each other.

        0 without the library, and while something is passed from hand to hand.
        """
        return 0 if self._of is None else int(self._asked.near)

    def near(self, name: str) -> NearArms:
        """What was near.

        Args:
            name: What messages call the other arm.
        """
        return NearArms(self._rows[: self.count, :_BOUND], partial(self._words, name))

    def _words(self, name: str, k: int) -> str:
        assert self._of is not None
        (a, b, _), row = self._of, self._rows[k]
        return close(a.names[int(row[_BOUND])], name, b.names[int(row[_BOUND + 1])])

    def answer(
        self,
        first: tuple[ArmBodies, Course],
        second: tuple[ArmBodies, Course],
        T: SE3,
        since: float,
    ) -> tuple[int, Array] | None:
        """What the library says to ``led_apart``; None if it has nothing to say."""
        a, b = first[0], second[0]
        if a.handle is None or b.handle is None or a.passed | b.passed:
            self._of = None
            return None
        if self._of is None or not all(map(is_, self._of, (a, b, T))):
            self._begin(a, b, T)
        asked = self._asked
        for (_, course), told, places in zip((first, second), self._courses, self._q, strict=True):
            n = len(course.q)
            if n > len(places):
                self._make_room(n)
                return self.answer(first, second, T, since)
            told.t, told.dt, told.n, places[:n] = course.t, course.dt, n, course.q
        asked.since, asked.gained = since, self.gained
        library = native().library
        assert library is not None
        found = library.so101_led_apart(self._address)
        if found != UNKNOWN:
            self.gained = asked.gained
        return found, asked.told

    def _begin(self, a: ArmBodies, b: ArmBodies, T: SE3) -> None:
        library = native().library
        assert library is not None
        memory = np.zeros(library.so101_beside_size() // 8)
        self._of, self._asked = (a, b, T), _Asked.from_buffer(memory.data)  # which keeps the memory
        self._address = pointer(memory)
        asked = self._asked
        for k, bodies in enumerate((a, b)):
            assert bodies.handle is not None
            asked.scene[k], asked.levers[k] = bodies.handle.value, bodies.levers_pointer.value
        asked.placement[:] = placement(T).tolist()
        asked.step, asked.margin, asked.skew = STEP, GUARDED, GUARDED_EARLY
        asked.pushed, asked.parting, asked.within, asked.gap = PUSHED, PARTING, GUARDED + RANGE, GAP
        rows = memory[_Asked.row.offset // 8 :][: _ROW * _MOST]
        self._rows, self._courses = rows.reshape(_MOST, _ROW), (asked.course[0], asked.course[1])
        self._make_room(_PLACES)

    def _make_room(self, places: int) -> None:
        self._q = tuple(np.zeros((places, 6)) for _ in range(2))
        for course, q in zip(self._courses, self._q, strict=True):
            course.q = q.ctypes.data


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
    said = beside.answer(first, second, T_first_second, since)
    if said is not None and said[0] != UNKNOWN:
        return meeting(*said, a, b)
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
