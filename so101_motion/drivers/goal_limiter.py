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

import ctypes
from collections.abc import Collection, Sequence

from so101_motion.common.errors import CommandRefused
from so101_motion.common.units import to_deg, to_rad
from so101_motion.drivers.bus.ticks import RAD_PER_TICK
from so101_motion.drivers.position_check import CLOSE
from so101_motion.native.library import quick

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

Six = list[float]
CArray = list[float] | ctypes.Array[ctypes.c_double]
SIX = ctypes.c_double * 6
"""A number for each joint, as C has it and as its slices are."""


def as_bits(joints: Collection[int]) -> int:
    """A bit for each of ``joints``, as C takes them."""
    return sum(1 << i for i in joints)


class GoalLimiter(ctypes.Structure):
    """Limits the commands of the six joints, in ``servo_goals.c``: it is called in every cycle.

    ``speed`` [rad/s] and ``acceleration`` [rad/s^2] are the hard caps of every joint.
    """

    _fields_ = [
        *((name, ctypes.c_double) for name in ("speed", "acceleration", "slack", "catch_up")),
        *((name, ctypes.c_double) for name in ("pause", "offset_speed", "lead_speed", "seed")),
        *((name, ctypes.c_double) for name in ("t", "t_before", "t_goal", "spare", "begins")),
        *((name, SIX) for name in ("q", "qd", "goal", "offset", "lead", "kept")),
        *((name, ctypes.c_double) for name in ("step", "elapsed", "allowed", "before", "asked")),
    ]
    speed: float
    q: Six
    qd: Six
    goal: Six
    kept: Six
    step: float
    elapsed: float
    allowed: float
    before: float
    asked: float

    def __init__(self, names: Sequence[str], *, speed: float, acceleration: float) -> None:
        super().__init__(
            speed=speed, acceleration=acceleration, slack=SLACK, catch_up=CATCH_UP, pause=PAUSE,
            offset_speed=OFFSET_SPEED, lead_speed=LEAD_SPEED, seed=SEED, spare=SLACK, begins=1.0,
            kept=SIX(*[CATCH_UP] * 6),
        )  # fmt: skip
        self._names, self._in_c, self._at = names, quick(), ctypes.c_void_p(ctypes.addressof(self))

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
        self.q[:], self.qd[:], self.kept[:] = q_cmd, [0.0] * 6, [CATCH_UP] * 6
        self.t = self.t_before = now
        self.begins = 1.0

    def follow(
        self,
        q_cmd: Sequence[float],
        qd_cmd: Sequence[float] | None,
        now: float,
        here: Sequence[float],
    ) -> None:
        """Check the next command, ``q_cmd`` [rad], at ``now`` [s].

        ``qd_cmd`` are velocities there of the first joints [rad/s], NaN if not known; ``here`` are
        the confirmed angles of the joints [rad], else NaN. ``CommandRefused`` if it moves more than
        the caps allow; the last command stays in force.
        """
        qd = None if qd_cmd is None else SIX(*qd_cmd)
        given = (SIX(*q_cmd), qd, SIX(*here), 0, ctypes.c_double(now))
        self.refuse(self._in_c.so101_limiter_follow(self._at, *given))

    def goals(
        self, weight: Sequence[float], largest: Sequence[float], lead: Sequence[float], now: float
    ) -> list[float]:
        """The goals to send [rad]: the last command plus offset and lead, within their bounds.

        With the first command offset (``weight``, at most ``largest``) and ``lead`` may jump to
        their values.
        """
        given = (SIX(*each) for each in (weight, largest, lead))
        self._in_c.so101_limiter_goals(self._at, *given, ctypes.c_double(now))
        return self.goal[:]

    def yielded(self, goals: Sequence[float], now: float) -> list[float]:
        """The goals [rad] of the first joints while a hand guides them: no faster than ``speed``.

        ``SLACK`` is spent once and comes back with time that no joint needed, so over any span the
        goals travel at most ``speed * (span + SLACK)``.
        """
        given = (SIX(*goals), len(goals), ctypes.c_double(now))
        self._in_c.so101_limiter_yielded(self._at, *given)
        return self.goal[: len(goals)]

    def refuse(self, found: int) -> None:
        """Raise ``CommandRefused`` if C has found a reason, a joint, plus 8 if its velocity is."""
        if found < 0:
            return
        i = found & 7
        if found >= 8:
            happened = (
                f"change its speed from {to_deg(self.before):.0f} to {to_deg(self.asked):.0f} deg/s"
                f" at once; steps of {to_deg(self.allowed):.0f} deg/s up to"
                f" {to_deg(self.speed):.0f} deg/s"
            )
        else:
            happened = (
                f"move by {to_deg(self.step):.1f} deg within {1000.0 * self.elapsed:.0f} ms;"
                f" {to_deg(self.allowed):.1f} deg"
            )
        raise CommandRefused(
            f"{self._names[i]} was to {happened} are allowed, so nothing was sent and the servos"
            " keep their last goal. Let the arm hold, then move again",
            joint=self._names[i],
        )


def limited(value: float, most: float) -> float:
    if value > most:
        return most
    return -most if value < -most else value
