"""Refuse commands that are too fast, and limit servo goals; the last step before the bus.

Every goal for a running arm passes through here, in every mode. For each joint:

1. *The command moves no faster than its caps.* Over any span it moves by at most
   ``v * (span + CATCH_UP)`` and what ``acceleration`` adds in between, where ``v`` is the
   larger of the two velocities that came with two commands. Time that a command did not need
   is kept for a later one, up to ``CATCH_UP``. Those velocities themselves stay below
   ``speed`` and change by no more than ``acceleration`` allows. So a motion with a cap of 30 deg/s
   is held to 30 deg/s by the velocities of its setpoints; a command without a velocity is held to
   ``speed``. ``speed`` and ``acceleration`` are the hard caps, which the servos keep as well.
   A joint that got no command for ``PAUSE`` stands: it may go on from rest, or at its old speed.
2. *A command begins where its joint is.* The first one after torque was off, after a fault or after
   a hand has guided the arm must be at the known position of the joint. So must a command that
   breaks promise 1 to make a joint that did not follow stay where it is; it has no velocity.
3. *The offset against weight stays below its bound*, ``largest``, and changes by no more than
   ``OFFSET_SPEED``; the lead against lag at speed, v^2 / 2a, changes by no more than
   ``LEAD_SPEED``.
4. *The goals of an arm that a hand guides* follow the hand no faster than ``speed``.

A command that breaks 1 or 2 comes from a bug or a wrong reading, so it is refused instead of
clamped: nothing is sent, and the executor treats ``CommandRefused`` as a fault. Offsets, leads and
guided goals come from measurements and are clamped silently, as their controllers expect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence

from so101_motion.common.errors import CommandRefused
from so101_motion.common.units import to_deg, to_rad
from so101_motion.drivers.bus.ticks import RAD_PER_TICK
from so101_motion.drivers.position_check import CLOSE

SLACK = 0.01
"""How much closer in time two goals may be than their setpoints [s]: a period, because after a late
tick the next one is in time."""

CATCH_UP = 0.03
"""How much time a command may make up for [s]: three periods, because after a tick that is up to
three periods late two are left out, and the next one is in time. Seen under load: a command 14 ms
late, and the next but one 6 ms after it."""

PAUSE = 0.1
"""A joint without a command for so long stands [s]. Chosen: three times the servos' lag; they have
reached the last goal."""

OFFSET_SPEED = to_rad(60.0)
"""How fast the offset against weight may change [rad/s]. Chosen: twice what the weight needs at 180
deg/s, and more than the integral in ``gravity_compensation.py`` ever learns."""

LEAD_SPEED = 2.0
"""How fast the lead against lag may change, in shares of ``speed``: v times the acceleration over
the servo's own braking, 1000 / 600 at most."""

SEED = CLOSE * RAD_PER_TICK
"""Largest distance from its joint at which a command may begin [rad]: that of two readings that
agree."""

_ROUNDING = 1e-6  # [rad] and [rad/s]


class GoalLimiter:
    """Limits the commands of the six joints; in plain lists, for it is called in every cycle.

    ``speed`` [rad/s] and ``acceleration`` [rad/s^2] are the hard caps of every joint.
    """

    def __init__(self, names: Sequence[str], *, speed: float, acceleration: float) -> None:
        n = len(names)
        self._names, self._speed, self._acceleration = names, speed, acceleration
        self._q, self._qd = [0.0] * n, [0.0] * n
        self._goal, self._offset, self._lead = [0.0] * n, [0.0] * n, [0.0] * n
        self._at_rest = [0.0] * n
        self._t = self._t_before = self._t_goal = 0.0
        self._spare = SLACK
        self._kept = [CATCH_UP] * n
        self._begins = True

    def begin(
        self, q_cmd: Sequence[float], q: Sequence[float], now: float, free: Collection[int] = ()
    ) -> None:
        """Check the first command; ``CommandRefused`` unless it is at ``q``, as measured [rad].

        Joints that are ``free`` are kept slow by their servos, see ``out_of_range.py``.
        """
        for i, (there, here) in enumerate(zip(q_cmd, q, strict=True)):
            if not abs(there - here) <= SEED and i not in free:
                raise CommandRefused(
                    f"{self._names[i]} is at {to_deg(here):.1f} deg and was to be held at"
                    f" {to_deg(there):.1f} deg; {to_deg(SEED):.1f} deg apart are allowed, so"
                    " nothing was sent. Let the arm hold again",
                    joint=self._names[i],
                )
        self._q, self._qd = list(q_cmd), [0.0] * len(self._q)
        self._t = self._t_before = now
        self._kept = [CATCH_UP] * len(self._q)
        self._begins = True

    def follow(
        self,
        q_cmd: Sequence[float],
        qd_cmd: Sequence[float] | None,
        now: float,
        here: Callable[[int], float],
        free: Collection[int] = (),
    ) -> None:
        """Check the next command, ``q_cmd`` [rad], at ``now`` [s]; ``free`` as for ``begin``.

        ``qd_cmd`` are velocities there of the first joints [rad/s], NaN if not known; ``here``
        gives the confirmed angle of a joint [rad], else NaN. ``CommandRefused`` if it moves more
        than the caps allow; the last command stays in force.
        """
        elapsed = max(now - self._t, 0.0)
        if elapsed > PAUSE + CATCH_UP:
            elapsed = CATCH_UP  # the joints stand, so what comes now begins, or goes on, from rest
        # The pause may have ended just before the last command: nothing moved in a single period.
        has_paused = now - self._t_before >= PAUSE
        change = self._acceleration * (elapsed + CATCH_UP)
        bend = 0.25 * self._acceleration * (elapsed + SLACK) ** 2
        given = () if qd_cmd is None else qd_cmd
        known, kept = len(given), [CATCH_UP] * len(q_cmd)
        for i, q in enumerate(q_cmd):
            step = abs(q - self._q[i])
            time, v, more = elapsed + self._kept[i], self._speed, 0.0
            if i < known and given[i] == given[i]:
                qd, before = given[i], self._qd[i]
                reached = _between(qd, before) if has_paused else before
                if not abs(qd) <= self._speed + _ROUNDING or not abs(qd - reached) <= change:
                    self._refuse_velocity(i, before, qd, change, free)
                v, more = min(max(abs(qd), abs(before)), v), bend
            elif (i < known or step > v * time) and abs(q - here(i)) <= SEED:
                self._lead[i] = 0.0  # it is to stay there
                continue
            allowed = v * time + more
            if not step <= allowed + _ROUNDING:
                if i in free:
                    continue
                raise CommandRefused(
                    f"{self._names[i]} was to move by {to_deg(q - self._q[i]):.1f} deg within"
                    f" {1000.0 * elapsed:.0f} ms; {to_deg(allowed):.1f} deg are allowed, so"
                    " nothing was sent and the servos keep their last goal. Let the arm hold, then"
                    " move again",
                    joint=self._names[i],
                )
            used = (step - more) / v if v > 0.0 and step > more else 0.0
            kept[i] = min(max(time - used, 0.0), CATCH_UP)
        self._q[:], self._kept = q_cmd, kept
        self._t_before, self._t = self._t, now
        self._qd = [qd if qd == qd else 0.0 for qd in given] + self._at_rest[known:]

    def goals(
        self,
        weight: Sequence[float],
        largest: Sequence[float],
        lead: Sequence[float],
        now: float,
    ) -> list[float]:
        """The goals to send [rad]: the last command plus offset and lead, within their bounds.

        With the first command offset (``weight``, at most ``largest``) and ``lead`` may jump to
        their values.
        """
        dt = now - self._t_goal + SLACK
        if self._begins:
            self._offset, self._lead, dt = self._at_rest, self._at_rest, math.inf
        self._offset = [
            limited(within_change(wanted, before, OFFSET_SPEED * dt), most)
            for wanted, before, most in zip(weight, self._offset, largest, strict=True)
        ]
        change = LEAD_SPEED * self._speed * dt
        self._lead = [
            within_change(w, before, change) for w, before in zip(lead, self._lead, strict=True)
        ]
        self._t_goal, self._begins = now, False
        parts = zip(self._q, self._offset, self._lead, strict=True)
        self._goal = [q + offset + ahead for q, offset, ahead in parts]
        return list(self._goal)

    def yielded(self, goals: Sequence[float], now: float) -> list[float]:
        """The goals [rad] of the first joints while a hand guides them: no faster than ``speed``.

        ``SLACK`` is spent once and comes back with time that no joint needed, so over any span the
        goals travel at most ``speed * (span + SLACK)``.
        """
        time = max(now - self._t_goal, 0.0) + self._spare
        change, farthest = self._speed * time, 0.0
        for i, goal in enumerate(goals):
            before = self._goal[i]
            self._goal[i] = within_change(goal, before, change)
            farthest = max(farthest, abs(self._goal[i] - before))
        self._spare = min(SLACK, max(time - farthest / self._speed, 0.0))
        self._t_goal = now
        return self._goal[: len(goals)]

    def _refuse_velocity(
        self, i: int, before: float, qd: float, change: float, free: Collection[int]
    ) -> None:
        if i not in free:
            raise CommandRefused(
                f"{self._names[i]} was to change its speed from {to_deg(before):.0f} to"
                f" {to_deg(qd):.0f} deg/s at once; steps of {to_deg(change):.0f} deg/s up to"
                f" {to_deg(self._speed):.0f} deg/s are allowed, so nothing was sent and"
                " the servos keep their last goal. Let the arm hold, then move again",
                joint=self._names[i],
            )


# Plain comparisons: a dozen of these run in every cycle.


def within_change(wanted: float, before: float, change: float) -> float:
    """``wanted``, limited to at most ``change`` from ``before``."""
    if wanted > before + change:
        return before + change
    return before - change if wanted < before - change else wanted


def _between(value: float, end: float) -> float:
    return min(max(value, min(end, 0.0)), max(end, 0.0))


def limited(value: float, most: float) -> float:
    if value > most:
        return most
    return -most if value < -most else value
