"""Tell whether joints follow their setpoints, or something holds them up.

*A joint is far from where it was wanted*: servos lag, so it is measured against all the setpoints
of the last ``following_lag``. *A joint stands while its setpoints go on*: over one of
``contact_windows`` it has moved much less than they have. That is seen long before the joint is far
off, because what makes joints stand off (weight, friction, delay) changes little in so short a
time; so it tells a contact from a load. The longer window is for slow motions, whose setpoints go
no farther on than play lets a joint stand. *A joint stops that followed slowly and evenly*: what
its play lets it stand is enough to be beyond. The driver says how far a joint strays until its
motor has crossed the play (``servo_model.py``); where the load keeps the gears on one side, about
half of that is enough.

*No setpoint was sent*, because a tick came late: servos run on to their last goal, so a joint may
be as far on as if setpoints had gone on as they did. *No joint answers*: goals may not arrive
either, and joints stand for want of them, so what was seen before no longer tells a contact. Joints
that have missed many goals would catch up faster than they may: the motion has to wait for them
(``forgive``), or to end.
"""

from __future__ import annotations

import ctypes
import math
import operator
from contextlib import suppress
from typing import Any

import numpy as np

from so101_motion.common.errors import WorkerError
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_rad
from so101_motion.control.joint_group import Tolerances
from so101_motion.drivers.goal_limiter import PAUSE
from so101_motion.native.library import quick

FOLLOWED = 0.4  # for how long a joint must have followed before it stopped [s]; chosen

STOPPED = (0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.11, 0.12, 0.13, 0.14, 0.17, 0.2)
"""For how long it must stand then [s]: at 20 deg/s the shortest do, at 6 the longest. Chosen."""

LEAST_WAY = to_rad(1.6)
"""How far it must have moved while it followed [rad]: more than play lets it stand. Chosen."""

SLOW = to_rad(35.0)  # a faster joint is seen to stand soon enough without this [rad/s]; chosen
ONE_SIDE = 0.15  # how long its load must have been on one side before that [s]; chosen

STANDS = to_rad(0.3)
"""A joint stands if it moves forward or falls back by no more than this [rad]: three ticks. A joint
that leans on a wall trembles by two. Chosen."""

RUNS_ON = 0.3
"""For so long joints that ran on may be ahead [s]. Chosen: emulated ones fall back within 0.2 s."""

SILENCE = 2
"""Joints may have missed their goals after so many ticks in a row without any answer. Chosen: a
single one is a lost request, which a joint hardly feels."""

MISSED, DOUBTED = 5, 0.1
"""After so many such ticks joints are looked at for this time [s], and may catch up for as long.
Chosen: with 4 ticks, emulated joints caught up within a third above their caps by themselves; they
run on to their last goal for 0.06 s."""

BEHIND = 0.3
"""They have missed too many if they are farther from their setpoints than before, by this share of
``contact_distance``; chosen."""

NEAREST = 0.75  # from which share of ``contact_distance`` on a joint is behind its setpoint; chosen


MOST, MOST_SPANS = 8, 16  # joints, windows or stops; as in held_up.c


class _Watch(ctypes.Structure):
    """The limits of ``held_up.c``: times in ticks, and how long the gears have been on one side."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("joints", "kept", "lag", "before", "one_side")),
        *((name, ctypes.c_int) for name in ("windows", "stops")),
        ("window", ctypes.c_int * MOST_SPANS),
        ("stop", ctypes.c_int * MOST_SPANS),
        *((name, ctypes.c_double) for name in ("contact_distance", "contact_share", "nearest")),
        *((name, ctypes.c_double) for name in ("pressed_stray", "stands", "least_way", "most_way")),
        ("pressed", ctypes.c_double * MOST),
        ("in_play", ctypes.c_double * MOST),
    ]


class LatestRows:
    """The latest rows of a table, in one array: looking back at them copies nothing.

    ``count`` says how many there are, up to as many as are kept.
    """

    def __init__(self, kept: int) -> None:
        self._kept = kept
        self._rows: Array = np.empty((0, 0))
        self._end = self.count = 0

    def begin(self, row: Array) -> None:
        """Forget all rows; those that come will be like this one, shape (n,)."""
        if self._rows.shape[1:] != row.shape:
            self._rows = np.empty((4 * self._kept, len(row)))
            self._begin, self._size = self._rows.ctypes.data, self._rows.strides[0]
        self.clear()

    def append(self, row: Array) -> None:
        """Add a row, shape (n,); the oldest is dropped if as many as are kept are there."""
        if self._end == len(self._rows):
            self._rows[: self._kept] = self._rows[-self._kept :].copy()
            self._end = self._kept
        self._rows[self._end] = row
        self._end += 1
        if self.count < self._kept:
            self.count += 1

    @property
    def end(self) -> int:
        """The address behind the last row."""
        return self._begin + self._end * self._size

    def last(self, n: int) -> Array:
        """The last ``n`` rows that are there, oldest first; until the next ``append``."""
        return self._rows[self._end - min(n, self.count) : self._end]

    def clear(self) -> None:
        self._end = self.count = 0


class FollowingCheck:
    """Compares measured joints with the latest setpoints, tick by tick.

    Args:
        tolerances: From which error on a joint does not follow.
        dt: The period of the ticks [s].

    Attributes:
        silence: How long no joint has answered, if that was just before ``held_up`` was called [s].
    """

    def __init__(self, tolerances: Tolerances, dt: float) -> None:
        self._tolerances, self._dt = tolerances, dt
        self._lag = round(tolerances.following_lag / dt)
        self._farthest = float(tolerances.following_error)
        self._sees_contact = math.isfinite(
            min(tolerances.contact_distance, tolerances.pressed_stray)
        )
        if self._sees_contact:
            with suppress(WorkerError):  # raised where it is needed
                quick()  # loading it takes longer than a tick
        windows = [round(span / dt) for span in tolerances.contact_windows]
        stops, before = [round(span / dt) for span in STOPPED], round(FOLLOWED / dt)
        self._kept = 1 + max(self._lag + max(windows), before + max(stops))
        self._wanted, self._seen = LatestRows(self._kept), LatestRows(self._kept)
        spans = ctypes.c_int * MOST_SPANS
        self._watch = _Watch(
            kept=self._kept, lag=self._lag, before=before, one_side=round(ONE_SIDE / dt),
            windows=len(windows), stops=len(stops), window=spans(*windows), stop=spans(*stops),
            contact_distance=tolerances.contact_distance, contact_share=tolerances.contact_share,
            nearest=NEAREST * tolerances.contact_distance, pressed_stray=tolerances.pressed_stray,
            stands=STANDS, least_way=LEAST_WAY, most_way=SLOW * FOLLOWED,
        )  # fmt: skip
        self._watch_at = ctypes.c_void_p(ctypes.addressof(self._watch))
        self._doubted = round(DOUBTED / dt)
        self._blind = 0  # for how many ticks joints may catch up
        self._silent = self._left = 0  # ticks without an answer; ticks until these do not matter
        self._strayed: tuple[Array | float, Array | float] = 0.0, 0.0  # wanted and seen before that
        self._q: Array | None = None  # where the joints were last
        self._ran_to: Array | None = None  # where joints without setpoints may have run
        self._way: Array = np.zeros(0)  # in which direction
        self._gap = 0.0  # for how long they were without [s]
        self._late = 0  # for how many ticks that counts
        self.silence = 0.0

    def begin(self, q_ref: Array) -> None:
        """Forget everything; the joints have stood at ``q_ref``, shape (n,), [rad]."""
        self._watch.joints = len(q_ref)
        self._given: Any = (ctypes.c_double * MOST)()
        self._newest, self._latest = q_ref, q_ref.tolist()
        self._wanted.begin(q_ref)
        self._seen.begin(q_ref)
        for _ in range(self._kept):
            self._wanted.append(q_ref)
        self._forget_seen()
        self._silent, self._left, self._blind, self.silence = 0, 0, 0, 0.0
        self._q = self._ran_to = None

    def run_on(self, q_ref: Array, qd_ref: Array, gap: float) -> None:
        """Note that no setpoint was sent for ``gap`` [s]: joints run on to goals ahead of it.

        The last setpoint was ``q_ref`` [rad], moving at ``qd_ref`` [rad/s], shapes (n,).
        """
        self._way = np.sign(qd_ref)
        ahead = 0.0 if self._q is None else np.maximum(self._way * (self._q - q_ref), 0.0)
        self._ran_to = q_ref + self._way * ahead + min(gap, PAUSE) * qd_ref  # they stand then
        self._gap, self._late = gap, round((gap + RUNS_ON) / self._dt)

    def want(self, q_ref: Array) -> None:
        """Note the setpoint of this tick, ``q_ref``, shape (n,), [rad]."""
        self._wanted.append(q_ref)
        self._newest, self._latest = q_ref, q_ref.tolist()
        self._late -= 1
        if self._late < 0:
            self._ran_to = None

    def is_near(self, q: Array) -> bool:
        """Whether no joint at ``q``, shape (n,), [rad], is far from the latest setpoint."""
        self._q = q
        off = map(abs, map(operator.sub, self._latest, q.tolist()))
        return all(map(self._farthest.__ge__, off))

    def off(self, q: Array) -> Array:
        """How far the joints at ``q`` are from all the latest setpoints, shapes (n,), [rad]."""
        self._q, wanted = q, self._wanted.last(1 + self._lag)
        low, high = wanted.min(axis=0), wanted.max(axis=0)
        if self._ran_to is not None:
            low = np.where(self._way < 0.0, np.minimum(low, self._ran_to), low)
            high = np.where(self._way > 0.0, np.maximum(high, self._ran_to), high)
        off: Array = np.maximum(low - q, q - high)
        return off

    def held_up(self, q: Array, in_play: list[float] | None = None, *, silent: bool = False) -> int:
        """A bit for each joint, seen at ``q`` now, that stands while its setpoints go on.

        Args:
            q: Measured angles, shape (n,), [rad].
            in_play: How far they stray while their motors go through the play [rad]; 0 for gears
                that are kept on one side of it, as all are if it is None.
            silent: Whether none of them has answered in this tick, so that ``q`` is a guess.
        """
        held = 0
        if not self._sees_contact:
            return held
        if silent:
            self._silent += 1
        elif self._silent or self._left:
            held = self._have_missed_goals(q)
        else:
            self._strayed, self.silence = (self._newest, q), 0.0
        if self._silent >= SILENCE or self._blind:
            self._blind = max(self._blind - 1, 0)
            self._forget_seen()
            return held
        self._seen.append(q)
        if self._wanted.count < self._kept:
            return held
        self._given[: len(q)] = in_play or [0.0] * len(q)
        return held | int(
            quick().so101_held_up(
                self._watch_at, self._wanted.end, self._seen.end, self._seen.count, self._given
            )
        )

    def words(self, i: int, *, held_up: bool) -> tuple[str, str]:
        """What has happened to joint ``i``, which does not follow, and what to check."""
        ran_ahead = (  # after a while without any setpoint
            self._ran_to is not None
            and self._q is not None
            and bool(self._way[i] * (self._q[i] - self._wanted.last(1)[0, i]) > 0.0)
        )
        if not held_up and ran_ahead:
            return (
                f"was without setpoints for {self._gap:.2f} s, and is",
                "how busy the computer is",
            )
        if held_up and self.silence:
            happened = f"missed its goals while no servo answered for {self.silence:.2f} s, and is"
            return happened, "the USB cable and how busy the computer is"
        blocked = "that nothing blocks the joint and that its servo has power"
        return ("was held up and is" if held_up else "is"), blocked

    def forgive(self) -> None:
        """Let the joints catch up with what they have missed in the last silence."""
        self._blind = self._doubted
        self._left, self.silence = 0, 0.0

    def _forget_seen(self) -> None:
        self._seen.clear()
        self._watch.pressed[:] = [0.0] * MOST
        self._watch.in_play[:] = [math.inf] * MOST

    def _have_missed_goals(self, q: Array) -> int:
        """A bit for each joint, at ``q`` [rad] now, that fell behind in a silence."""
        if self._silent >= MISSED:
            self._left, self.silence = self._doubted, self._silent * self._dt
        self._silent = 0
        if not self._left:
            self._strayed, self.silence = (self._newest, q), 0.0
            return 0
        self._left -= 1
        wanted, seen = self._strayed
        missed = (
            np.abs(self._newest - q - (wanted - seen)) > BEHIND * self._tolerances.contact_distance
        )
        return sum(1 << int(i) for i in np.flatnonzero(missed))
