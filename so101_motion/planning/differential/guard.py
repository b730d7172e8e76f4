"""Keep an arm that follows a target clear of itself and its surroundings, one short path at a time.

A control cycle asks five questions:

* ``see``: which bodies are near, and which joints are near their torque limit?
* ``within_reach``: which configuration nearest to a target is free? An estimate, from distances
  that are linearised in the joint angles: the arm slides along obstacles.
* ``admits``: is a path free, and can the servos bear it? A proof. An arm that only takes steps from
  which an admitted path leads to rest never touches anything, however wrong the estimate was.
* ``guided_to``: how far may a hand lead the joints? Those that bring bodies too near are held back.
* ``contact``: which bodies does a path bring into contact that somebody else has planned?

Belongs to one thread, like the ``CollisionModel``.

``BoundedStep`` finds the step nearest to a wanted one that keeps linear bounds: ``x`` with ``G x >=
least``.

The most violated bound becomes active, and active bounds with negative multipliers leave again (a
dual active set method, as that of D. Goldfarb and A. Idnani, 1983, without its factor updates:
there are few rows, and one or two rounds are mostly enough). The compiled library does it
(``native/within.c``).
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.native.library import quick, shown
from so101_motion.planning.collision.batch_check import BOUND, NEAR_ROW
from so101_motion.planning.collision.bodies import NEAR
from so101_motion.planning.collision.collision import BACK_OUT, CollisionModel
from so101_motion.planning.collision.course import NearArms
from so101_motion.planning.collision.following_apart import GAP
from so101_motion.planning.timing.torque import NEARLY, Load, TorqueReserve

MOST = 8  # at most so many bounds are used, those with the least room; chosen, and the same in C
_ROOM = 64  # up to so many bounds need no new memory; chosen


class BoundedStep:
    """Finds the step nearest to a wanted one. Belongs to one thread.

    Attributes:
        bounds: Room for bounds, shape (``room``, 7).
    """

    def __init__(self, room: int = _ROOM) -> None:
        self._make_room(room)

    def nearest(self, step: Array, bounds: Sequence[Array]) -> tuple[Array | None, Sequence[int]]:
        """The step nearest to ``step`` (5,) that keeps the bounds, and which bounds are active.

        Each bound, a row of one of the arrays (k, 7), has five factors of the step, the smallest
        value of their product, and the room it leaves; those with the least room are used. ``step``
        itself if no bound is active; None if no step is found. Active bounds are counted through
        all arrays.
        """
        n = sum(map(len, bounds))
        if n > len(self.bounds):
            self._make_room(n)
        n = 0
        for each in bounds:
            self.bounds[n : n + len(each)] = each
            n += len(each)
        return self.nearest_within(step, n)

    def nearest_within(self, step: Array, n: int) -> tuple[Array | None, Sequence[int]]:
        """``nearest`` for the first ``n`` of ``bounds``."""
        self._step[:] = step
        found = quick().so101_nearest_within(self._address, n)
        if found == 0:
            return step, ()
        active = list(map(int, self._active[: abs(found)].tolist()))
        return (self._step.copy() if found > 0 else None), active

    def _make_room(self, bounds: int) -> None:
        given = np.zeros(5 + MOST + 7 * bounds)
        self._step, self._active = given[:5], given[5 : 5 + MOST]
        self.bounds = given[5 + MOST :].reshape(-1, 7)
        self._address = given.ctypes.data


RANGE = 0.05  # beyond the margin, where approaches get slower [m]; chosen
BENT = 0.3  # share of the smallest margin by which a path may bend between its samples; chosen
FAST = 0.01  # travel of a path to rest above which servos are inexact [m]; chosen

INEXACT = 0.015
"""Extra margin of such a path [m]. Servos that are stopped from speed swing past the end of the
ramp: following a target to and fro at 180 deg/s, a fitted emulated arm came 13 mm nearer to a table
than its command, and once farther."""

AHEAD, AHEAD_SHARE = 0.02, 0.2
"""Further extra margin for servos that are driven ahead of the command to compensate their lag: at
most the first [m], as a share of the travel the second. Emulated, among hostile targets at 150
deg/s, a joint came 21 mm nearer to the table than its command."""

AHEAD_STEP = 0.002  # that margin is rounded up to these [m]; chosen

CONTACT = 1.0 / 3.0
"""Bodies that are nearer than this share of their margin count as in contact for ``contact``: 1 mm
of 3. Chosen: a proof needs some distance, and whoever planned the path may keep less than we do."""

ALONG = 0.001
"""A joint that brings bodies nearer by less than this moves along them [m/rad]. Chosen: a hand that
turns the pan above a table is not held back, nor is the margin used up by a turn of 90 degrees."""

GUIDED_GAP = 0.005
"""Gap beyond the margin at which a hand is held back [m]. Chosen: fitted servos, led at 30 deg/s by
a hand of 2 N m, went 5 mm farther than that in the median, and 9 mm at most."""

_BORNE, _CLEAR = 1, 2  # as in guard.h
PLACES = 4  # samples of a path at which bodies must part; chosen
_CLOSER = 1e-6  # how much closer such bodies may come on a path [m]: rounding


class _Seen(ctypes.Structure):
    """What is near the arm, for ``guard.c``, which fills it."""

    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("scene", "margin", "pair_of", "load")),
        *((name, ctypes.c_void_p) for name in ("near", "bound", "room")),
        *((name, ctypes.c_double) for name in ("within", "widest", "bend", "nearly", "fast")),
        *((name, ctypes.c_double) for name in ("inexact", "ahead", "share", "step", "closer")),
        *((name, ctypes.c_double * n) for name, n in (("reach", 5), ("q", 6), ("target", 5))),
        *((name, ctypes.c_double) for name in ("free", "extra")),
        *((name, ctypes.c_int) for name in ("most", "places", "sees_enough", "seen")),
        *((name, ctypes.c_int) for name in ("is_heavy", "is_kept", "is_undecided")),
    ]


class Guard:
    """Checks the next steps of an arm that follows a target.

    Pairs of bodies within their margin may only move apart, and overloaded joints may only get less
    load. An arm that is in a surface, of which nobody knows how deep, may not move at all.

    ``collision`` and ``load`` (None not to check it) are used by the guard alone from now on;
    ``q_jaw`` returns the wanted jaw angle; ``acceleration`` (5,) is the largest on paths for
    ``admits``, None for straight lines.

    Attributes:
        look_every: Largest time between samples of a path for ``admits`` [s]: between them it bends
            no more than ``admits`` allows for.
        against: Words for what kept the last ``within_reach`` from its target.
        scene: The compiled library's handle of the scene.
        bounds_at: Address of ``bounds``.
        stuck: Words for the bodies that the arm is in, to an unknown depth, at the last look. Then
            no step is admitted, because any may lead deeper.
    """

    def __init__(
        self,
        collision: CollisionModel,
        q_jaw: Callable[[], float],
        load: Load | None = None,
        *,
        acceleration: Array | None = None,
    ) -> None:
        self._collision, self._q_jaw, self._load = collision, q_jaw, load
        self._bend, self.look_every = 0.0, np.inf
        if acceleration is not None:
            # With an acceleration a, a path is off its chord by a t^2 / 8 at most.
            self._bend = BENT * self.margin
            self.look_every = math.sqrt(8.0 * self._bend / float(acceleration @ collision.reach))
            # A check is made when it is first needed, which takes longer than a control cycle.
            steps = range(round(AHEAD / AHEAD_STEP) + 1)
            for extra in (0.0, *(INEXACT + min(AHEAD_STEP * k, AHEAD) for k in steps)):
                collision.first_blocked(np.zeros((1, 5)), bend=self._bend, extra=extra)
            collision.first_blocked(np.zeros((1, 5)), tolerance=1.0 - CONTACT)
        else:
            collision.first_blocked(np.zeros((1, 5)))
        self._widest = float(collision.margins.max(initial=collision.margin))
        self._range = min(NEAR, self._widest + RANGE)
        self._sees_enough = self._widest + INEXACT + AHEAD + self._bend <= self._range
        batch, most = collision.batch, max(1, len(collision.pairs))
        self._found, self._own_step = np.zeros((most, NEAR_ROW)), BoundedStep(most)
        self._kept = self._own_step.bounds
        self._seen = _Seen(
            batch.scene, batch.margins_at, batch.numbers_at, None if load is None else load.known,
            self._found.ctypes.data, self._kept.ctypes.data, batch.near_at,
            self._range, self._widest, self._bend, NEARLY, FAST, INEXACT, AHEAD, AHEAD_SHARE,
            AHEAD_STEP, _CLOSER, most=most, places=PLACES, sees_enough=self._sees_enough,
        )  # fmt: skip
        self._seen.reach[:], self._seen.q[:] = collision.reach.tolist(), [math.nan] * 6
        self._q, self._to = shown(self._seen, "q", 5), shown(self._seen, "target", 5)
        self._n = 0  # pairs that are near
        self._in_c, self._at = quick(), ctypes.addressof(self._seen)
        self.scene, self.bounds_at = batch.scene, self._kept.ctypes.data
        self._step = BoundedStep()
        self._words = dict[int, str]()  # by pair of bodies
        self.against: tuple[str, ...] = ()
        self.stuck: tuple[str, ...] = ()
        self._stuck_in: Any = None  # booleans by row

    @property
    def margin(self) -> float:
        """The smallest distance that any two bodies must keep [m]."""
        return float(self._collision.margins.min(initial=self._collision.margin))

    @property
    def _rows(self) -> Array:
        """The rows of ``near_bounds`` of what is near."""
        return self._found[: self._n]

    @property
    def bounds(self) -> Array:
        """The bounds of ``near_bounds`` of what was near at the last look."""
        return self._kept[: self._n]

    def see(self, q: Array) -> list[TorqueReserve]:
        """Find near bodies at ``q`` (5,) [rad]; return the joints near their torque limit."""
        self._find_near(q, GAP)
        return self._load.heavy(q) if self._seen.is_heavy and self._load is not None else []

    def _find_near(self, q: Array, gap: float) -> None:
        seen, self._q[:] = self._seen, q
        seen.q[5], self.stuck = self._q_jaw(), ()
        self._n = self._in_c.so101_guard_look(self._at, gap, -1)
        if self._n < 0:
            near = self._collision.near_bounds(q, seen.q[5], within=self._range, gap=gap)
            self._n = len(near[0])
            self._rows[:], self.bounds[:] = near
            self._in_c.so101_guard_look(self._at, gap, self._n)
        if seen.free < 0.0:
            pairs = self._rows[:, 0].astype(int)
            self._stuck_in = self._collision.unknown(pairs, self._rows[:, 1])
            called = map(self._called, pairs[self._stuck_in])
            self.stuck = tuple(f"{a} in contact with {b}: {BACK_OUT}" for a, b in called)

    def within_reach(self, q: Array, q_target: Array, others: Sequence[NearArms] = ()) -> Array:
        """The configuration nearest to a target that is probably free, shape (5,), [rad].

        ``q_target`` itself if nothing is in its way; ``q``, the present one, if none is found.
        ``others``: near bodies of other arms.
        """
        self._to[:] = q_target
        heavy = self.see(q)
        if self.stuck:
            self.against = self.stuck
            return q
        if self._seen.is_kept and not (heavy or others):
            self.against = ()
            return q_target
        if heavy or others:
            bounds = [self.bounds, *(each.bounds for each in others)]
            rows = [[*each.gradient, min(0.0, GAP - each.left), -np.inf] for each in heavy]
            bounds.append(np.array(rows).reshape(-1, BOUND))
            nearest, active = self._step.nearest(q_target - q, bounds)
        else:
            nearest, active = self._own_step.nearest_within(q_target - q, self._n)
        self.against = tuple(self._named(i, others, heavy) for i in active)
        if nearest is None:
            return q
        return q + nearest if active else q_target

    def guided_to(self, q: Array, q_guided: Array, others: Sequence[NearArms] = ()) -> Array:
        """How far a hand may lead the joints from ``q`` to ``q_guided``; (5,) or (k, 5), [rad].

        Each joint that brings near bodies nearer, by ``ALONG`` or more, goes as far as leaves them
        their margins and ``GUIDED_GAP`` if no other joint makes room; the others go all the way. An
        estimate for a few degrees, from distances that are linearised. The load is not checked.
        """
        self._find_near(q, GUIDED_GAP)
        own = self.bounds[~self._stuck_in] if self.stuck else self.bounds
        bounds = np.concatenate([own, *(each.bounds for each in others)])
        rates = np.where(np.abs(bounds[:, :5]) < ALONG, 0.0, bounds[:, :5])
        step, least = np.atleast_2d(q_guided - q), np.minimum(bounds[:, 5], 0.0)
        nearer = np.minimum(rates * step[:, None], 0.0)  # by each joint [m]
        total, shares = nearer.sum(axis=2), np.ones_like(step)
        for i, k in np.argwhere(total < least):
            culprits = nearer[i, k] < 0.0
            shares[i, culprits] = np.minimum(shares[i, culprits], least[k] / total[i, k])
        return q + (shares * step).reshape(q_guided.shape)

    def _named(self, k: int, others: Sequence[NearArms], heavy: Sequence[TorqueReserve]) -> str:
        """Words for the obstacle or load of bound ``k``, counted as in ``within_reach``."""
        if k < self._n:
            return self.close_to(k)
        k -= self._n
        for each in others:
            if k < len(each.bounds):
                return each.words(k)
            k -= len(each.bounds)
        return self.words(heavy[k])

    def close_to(self, k: int) -> str:
        """Words for the bodies of a bound, such as ``"the jaw close to the floor"``."""
        pair = int(self._rows[k, 0])
        if pair not in self._words:
            self._words[pair] = "{} close to {}".format(*self._called(pair))
        return self._words[pair]

    def admits(self, path: Array, *, ahead: bool = False) -> bool:
        """Whether a path is proven free and bearable; arguments as for ``is_free``."""
        proven, load = self._proven(path, ahead=ahead), self._load
        if not proven & _BORNE and load is not None and not load.admits(path):
            return False
        return bool(proven & _CLEAR) or self._is_free(path)

    def is_free(self, path: Array) -> bool:
        """Whether a path (m, 5) [rad], m >= 2, with straight lines between, is proven free.

        The load is not checked.
        """
        return bool(self._proven(path, ahead=False) & _CLEAR) or self._is_free(path)

    def _proven(self, path: Array, *, ahead: bool) -> int:
        path = np.ascontiguousarray(path, dtype=np.float64)
        at = path.ctypes.data
        found = self._in_c.so101_guard_proves(
            self._at, at, at + path.strides[0], len(path) - 1, ahead
        )
        return int(found)

    def _is_free(self, path: Array) -> bool:
        extra = self._seen.extra
        q_jaw, more = self._q_jaw(), self._bend + extra
        if self._collision.first_blocked(path, q_jaw, bend=self._bend, extra=extra) is None:
            return True
        if not self._seen.is_undecided:
            return False
        margins = self._collision.margins + more
        lack = self._lacking(path[0], q_jaw, margins)
        return bool(lack.any()) and self._parts(path, q_jaw, margins, lack)

    def _parts(self, path: Array, q_jaw: float, margins: Array, lack: Array) -> bool:
        """Whether pairs that ``lack`` [m] of their margins where a path begins come no closer."""
        if np.isinf(lack).any():
            return bool((path == path[0]).all())
        places = path[: 0 : -max(1, len(path) // PLACES)]
        return not self._collision.lacks_more(places, q_jaw, margins, lack + _CLOSER)

    def contact(self, path: Array) -> tuple[str, str] | None:
        """The first two bodies that a path brings into contact, in words; None is a proof.

        Bodies that are in contact where it begins may part. Nearness is no contact, and the load is
        not checked: the path is somebody else's plan.
        """
        self.see(path[0])
        collision, q_jaw = self._collision, self._q_jaw()
        if self._span(path) <= self._seen.free:
            return None
        blocked = collision.first_blocked(path, q_jaw, tolerance=1.0 - CONTACT)
        if blocked is None:
            return None
        margins = CONTACT * collision.margins
        lack = collision.lacking(path[0], q_jaw, margins)
        if lack.any():
            if self._parts(path, q_jaw, margins, lack):
                return None
            known = np.where(np.isinf(lack), 0.0, lack)
            worse = [collision.lacking(q, q_jaw, margins) - known for q in path]
            k = int(np.argmax(np.max(worse, axis=0)))
        else:
            k = int(np.argmax(collision.lacking(blocked, q_jaw, margins)))
        return self._called(k)

    def keeps_clear(self, path: Array) -> bool:
        """Whether a stop along a path keeps out of contact; from speed it must be free as well."""
        return self.contact(path) is None if self._span(path) <= FAST else self.is_free(path)

    def _span(self, path: Array) -> float:
        """A bound on how far any point of the arm is from where a path begins [m]."""
        return float(np.maximum.reduce(np.abs(path - path[0])) @ self._collision.reach)

    def nearest(self, path: Array) -> tuple[str, str]:
        """The two bodies that come nearest to their margin on a path that is not free, in words."""
        lack = [
            self._collision.lacking(q, self._q_jaw(), self._collision.margins + self._range)
            for q in path
        ]
        return self._called(int(np.argmax(np.max(lack, axis=0))))

    def _called(self, pair: int) -> tuple[str, str]:
        called = self._collision.scene.called
        first, second = self._collision.pairs[pair]
        return called(first), called(second)

    def _lacking(self, q: Array, q_jaw: float, margins: Array) -> Array:
        """Like ``CollisionModel.lacking``, but uses the result of ``look`` at the same ``q``."""
        if not self._sees_enough or not np.array_equal(q, self._q):
            return self._collision.lacking(q, q_jaw, margins)
        return self._collision.lack_in(self._rows, margins)

    def words(self, each: TorqueReserve) -> str:
        """Words for a load."""
        return f"{each.joint} at its torque limit"
