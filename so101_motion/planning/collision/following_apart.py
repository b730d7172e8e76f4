"""Prove that an arm that follows a target keeps apart from another arm, or only moves away from it.

The compiled library does it (``native/following_apart.c``). What it cannot decide is decided here:
arms that touch, by coal, and arms that pass an object between them, whose bodies are in groups.
The proof for planned motions is in ``apart.py``.
"""

from __future__ import annotations

import ctypes
from functools import partial
from operator import is_

import numpy as np

from so101_motion.common.geometry import SE3, Array
from so101_motion.native.library import native
from so101_motion.planning.collision.apart import (
    GUARDED,
    GUARDED_EARLY,
    PARTING,
    UNKNOWN,
    Meeting,
    Moving,
    first_meeting,
    gaps,
    meeting,
    nearness,
    placement,
)
from so101_motion.planning.collision.arm_bodies import ArmBodies
from so101_motion.planning.collision.batch_check import pointer
from so101_motion.planning.collision.course import STEP, NearArms

PUSHED = 0.7  # nearer than this share of what was kept: pushed; a proof leaves 7/8
RANGE = 0.03  # arms nearer than ``GUARDED`` and this approach slowly [m]; see guard.py

GAP = 0.002
"""Gap beyond the margin that stays when a body is approached [m], and the share of its torque limit
that a joint keeps free. Chosen: the proof, which checks the margin itself, then refuses nothing."""

_BOUND, _ROW, _MOST = 7, 9, 24  # numbers of a bound and of a near pair, and most pairs; native.h
_PLACES = 64  # samples of a course that need no new memory; chosen
_SAME = 1e-7  # distances that differ by less are equal [m]; coal's rounding


class _Course(ctypes.Structure):
    _fields_ = [
        ("t", ctypes.c_double),
        ("dt", ctypes.c_double),
        ("n", ctypes.c_int),
        ("q", ctypes.c_void_p),
    ]


class _Asked(ctypes.Structure):
    """The first fields of the library's ``Beside``."""

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
    """Memory of two arms from cycle to cycle, one of which follows a target.

    Attributes:
        gained: Distance to keep from now on, after the arms were too near [m]; 0 for none.
    """

    def __init__(self) -> None:
        self.gained = 0.0
        self._of: tuple[ArmBodies, ArmBodies, SE3] | None = None
        self._asked, self._rows = _Asked(), np.zeros((0, _ROW))
        self._address = ctypes.c_void_p()
        self._courses: tuple[_Course, ...] = ()
        self._q = tuple[Array, ...]()  # the samples of the courses, where the library reads them

    @property
    def count(self) -> int:
        """How many pairs of bodies were near each other.

        0 while an object is passed between the arms.
        """
        return 0 if self._of is None else int(self._asked.near)

    def near(self, name: str) -> NearArms:
        """The pairs of bodies that were near each other; ``name`` is the other arm's."""
        return NearArms(self._rows[: self.count, :_BOUND], partial(self._words, name))

    def _words(self, name: str, k: int) -> str:
        assert self._of is not None
        (a, b, _), row = self._of, self._rows[k]
        return close(a.names[int(row[_BOUND])], name, b.names[int(row[_BOUND + 1])])

    def answer(
        self, first: Moving, second: Moving, T: SE3, since: float
    ) -> tuple[int, Array] | None:
        """The library's verdict for ``following_apart``; None while an object is passed."""
        library = self._tell(first, second, T, since)
        if library is None:
            return None
        asked = self._asked
        asked.gained = self.gained
        found = library.so101_following_apart(self._address)
        if found != UNKNOWN:
            self.gained = asked.gained
        return found, asked.told

    def look(self, first: Moving, second: Moving, T: SE3, at: float) -> None:
        """Find the pairs of bodies that are near each other at an instant [s], and prove nothing.

        The other arguments are those of ``following_apart``.
        """
        library = self._tell(first, second, T, at)
        if library is not None:
            library.so101_near_beside(self._address)

    def _tell(self, first: Moving, second: Moving, T: SE3, since: float) -> ctypes.CDLL | None:
        """Hand both courses to the library; None while an object is passed between the arms."""
        a, b = first[0], second[0]
        if a.passed | b.passed:
            self._of = None
            return None
        if self._of is None or not all(map(is_, self._of, (a, b, T))):
            self._begin(a, b, T)
        for (_, course), told, places in zip((first, second), self._courses, self._q, strict=True):
            n = len(course.q)
            if n > len(places):
                self._make_room(n)
                return self._tell(first, second, T, since)
            told.t, told.dt, told.n, places[:n] = course.t, course.dt, n, course.q
        self._asked.since = since
        return native().library

    def _begin(self, a: ArmBodies, b: ArmBodies, T: SE3) -> None:
        library = native().library
        memory = np.zeros(library.so101_beside_size() // 8)
        self._of, self._asked = (a, b, T), _Asked.from_buffer(memory.data)  # which keeps the memory
        self._address = pointer(memory)
        asked = self._asked
        for k, bodies in enumerate((a, b)):
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


def following_apart(
    first: Moving, second: Moving, T_first_second: SE3, *, since: float, beside: Beside
) -> Meeting | None:
    """Where an arm that follows a target would come too near to another, if both stop now.

    Arms that are too near already may move apart, and then keep the distance they have gained. Arms
    nearer than that, for example because one braked into it, may only move apart. ``first`` follows
    a target; ``beside`` remembers these two arms and is changed; else as in ``apart.py``. None if
    nowhere.
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
    first: Moving, second: Moving, T_first_second: SE3, *, since: float, room: float
) -> bool:
    """Whether no two bodies come nearer than they are now, or stay beyond ``room`` [m].

    Checked by coal every ``STEP`` until both rest, at first twice as often. False while an object
    is passed between the arms.
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
    """Words for two bodies of two arms that are close to each other."""
    return f"the {own} close to {name}'s {others}"
