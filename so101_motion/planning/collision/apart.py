"""Prove that two arms stay apart while both move, or say when and where they would not.

The compiled library does it (``native/apart.c`` says how). Bodies are those of ``bodies.py``: hulls
that contain the real parts, and held objects. An object that is passed from one gripper to another
need not keep off the gripper and the jaw of the arm that takes it; all other bodies of both arms
keep apart as always.

``first`` and ``second`` are two arms' bodies and courses, ``T_first_second`` the second's base in
the first's base frame; ``since`` is the start of a check [s], ``room`` the distance to keep [m].
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import coal
import numpy as np

from so101_motion.common.geometry import SE3, Array
from so101_motion.native.library import native
from so101_motion.planning.collision.arm_bodies import ArmBodies
from so101_motion.planning.collision.batch_check import pointer
from so101_motion.planning.collision.course import STEP, Course
from so101_motion.planning.collision.scene import HOLDERS

ROOM = 0.02  # distance that planned arms keep [m]; chosen for backlash, sag and base poses
GUARDED = 0.01  # distance of arms that follow targets or stop [m]; chosen, half of it
EARLY = 0.03  # how far one arm may be ahead [s]; chosen, three control periods
GUARDED_EARLY = 0.01  # the same for arms that follow targets [s]: one period of the control loop
PARTING = 5e-4  # how much nearer arms that part may come [m]: parts slide; chosen
UNKNOWN = 2  # as in native.h


Moving = tuple[ArmBodies, Course]  # an arm's bodies and its course


class Meeting(NamedTuple):
    """Where two arms would come too near to each other."""

    t: float  # when [s]
    distance: float  # how near they are then [m]; 0 or less if they touch
    first: str  # a link of the first arm by its human name, or what it holds
    second: str  # the same of the second arm


def _groups(a: ArmBodies, b: ArmBodies) -> Sequence[tuple[ArmBodies, ArmBodies]]:
    """The groups of bodies that must keep apart: all, if no object is passed between the arms."""
    passed = a.passed | b.passed
    if not passed:
        return ((a, b),)
    hands, groups = passed | HOLDERS, [(a.without(passed), b.without(passed))]
    if a.passed:
        groups.append((a.without(frozenset(a.names) - a.passed), b.without(hands)))
    if b.passed:
        groups.append((a.without(hands), b.without(frozenset(b.names) - b.passed)))
    return groups


def first_meeting(
    first: Moving,
    second: Moving,
    T_first_second: SE3,
    *,
    since: float,
    room: float = ROOM,
    early: float = EARLY,
) -> Meeting | None:
    """Where two arms first come too near to each other, or None: a proof that they never do.

    Both rest at the ends of their courses. Between two checks of a pair seven eighths of ``room``
    [m] are kept. One may be ``early`` [s] ahead of the other: the faster both are, the further
    apart they must stay.
    """
    figures = since, STEP, room, early
    met = (
        _asked("so101_courses_apart", (a, first[1]), (b, second[1]), T_first_second, figures)
        for a, b in _groups(first[0], second[0])
    )
    return min(filter(None, met), default=None)


def nearness(
    first: Moving, second: Moving, T_first_second: SE3, *, at: float, room: float
) -> float | None:
    """The distance of two arms at an instant [s], if it is less than ``room``; else None.

    A lower bound, at most 0.1 mm too small; 0 or less if they touch, or nearly [m].
    """
    here, there = (course.at(np.array([at])) for _, course in (first, second))
    nearest = min(
        float(distances(a, b, T_first_second, here, there, need=room, enough=room).min())
        for a, b in _groups(first[0], second[0])
    )
    return nearest if nearest < room else None


def clearance_over_time(
    first: Moving, second: Moving, T_first_second: SE3, times: Array
) -> list[Meeting]:
    """The closest bodies of two arms at each of some times (n,) [s].

    For display; it takes a tenth of a millisecond for each time.
    """
    (a, _), (b, _) = first, second
    found = []
    for t, apart in zip(times, gaps(first, second, T_first_second, times), strict=True):
        i, j = np.unravel_index(np.argmin(apart), apart.shape)
        found.append(Meeting(float(t), float(apart[i, j]), a.names[i], b.names[j]))
    return found


def distances(
    a: ArmBodies, b: ArmBodies, T: SE3, qa: Array, qb: Array, *, need: float, enough: float
) -> Array:
    """Lower bounds of the distances between bodies of two arms, shape (n, k, m), [m].

    Exact to 0.1 mm below ``need``, else to a tenth of the excess; distances above ``enough`` may be
    given as any value above it. The two bases are infinitely far from each other. ``qa`` and ``qb``
    are joints and jaws, shape (n, 6), [rad].
    """
    library, placed = native().library, placement(T)
    qa, qb = np.ascontiguousarray(qa), np.ascontiguousarray(qb)
    found = np.empty((len(qa), len(a.objects), len(b.objects)))
    library.so101_gaps(
        a.handle,
        b.handle,
        pointer(placed),
        len(qa),
        pointer(qa),
        pointer(qb),
        ctypes.c_double(need),
        ctypes.c_double(enough),
        pointer(found),
    )
    return found


def gaps(first: Moving, second: Moving, T: SE3, times: Array) -> Iterator[Array]:
    """Distances between the bodies of two arms at some times, shape (n, m), [m], by coal.

    The two bases, which do not move, are infinitely far from each other.
    """
    (a, one), (b, other) = first, second
    data, request = (a.model.createData(), b.model.createData()), coal.DistanceRequest()
    for qa, qb in zip(one.at(times), other.at(times), strict=True):
        place_a, place_b = a.placed(qa, SE3.identity(), data[0]), b.placed(qb, T, data[1])
        apart = np.full((len(a.objects), len(b.objects)), np.inf)
        for i, (x, at) in enumerate(zip(a.objects, place_a, strict=True)):
            for j, (y, to) in enumerate(zip(b.objects, place_b, strict=True)):
                if x.joint or y.joint:
                    apart[i, j] = coal.distance(
                        x.shape, at, y.shape, to, request, coal.DistanceResult()
                    )
        yield apart


def stops_meeting(
    first: Moving,
    second: Moving,
    T_first_second: SE3,
    *,
    since: float,
    every: float,
    room: float,
    early: float,
) -> Meeting | None:
    """Where two arms would come too near if both stopped at some instant; None if nowhere.

    The instants are ``every`` [s], until one of them rests; ``early`` as in ``first_meeting``.
    """
    (a, one), (b, other) = first, second
    end, since = min(one.end, other.end), max(since, one.t, other.t)
    figures = since, end, every, STEP, room, early
    met_in_groups = (
        _asked("so101_stops_apart", (mine, one), (theirs, other), T_first_second, figures)
        for mine, theirs in _groups(a, b)
    )
    return min(filter(None, met_in_groups), default=None)


def _asked(
    question: str, first: Moving, second: Moving, T: SE3, figures: tuple[float, ...]
) -> Meeting | None:
    """Ask the compiled library about two courses."""
    (a, one), (b, other) = first, second
    library, n, m = native().library, one.q.size, other.q.size
    timing = np.array([one.t, one.dt, other.t, other.dt, 0.0, 0.0, 0.0, 0.0])
    given = np.concatenate((placement(T), one.q.ravel(), other.q.ravel(), timing))
    at: int = given.ctypes.data  # asking for an address takes as long as some checks
    placed, qa, qb, times, others, out = (
        ctypes.c_void_p(at + given.itemsize * k)
        for k in (0, 12, 12 + n, 12 + n + m, 14 + n + m, 16 + n + m)
    )
    found = getattr(library, question)(
        a.handle, b.handle, placed, a.levers_pointer, b.levers_pointer,
        times, n // 6, qa, others, m // 6, qb, *map(ctypes.c_double, figures), out,
    )  # fmt: skip
    return meeting(int(found), given[16 + n + m :], a, b)


def meeting(found: int, out: Sequence[float] | Array, a: ArmBodies, b: ArmBodies) -> Meeting | None:
    """Turn an answer of the library into a ``Meeting``; None if the arms do not meet."""
    if found == UNKNOWN:
        raise MemoryError("there is no memory to prove that two arms keep apart")
    if not found:
        return None
    return Meeting(float(out[0]), float(out[1]), a.names[int(out[2])], b.names[int(out[3])])


def placement(T: SE3) -> Array:
    """A transform in the library's form: rotation by rows, then translation, shape (12,)."""
    return np.concatenate((T.R.ravel(), T.p))
