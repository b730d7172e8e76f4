"""Guide the arm by hand: the joints carry their weight and yield to a push.

A joint holds an angle, its *anchor*, softly: like a spring with the requested P gain. Pushed beyond
the dead band it takes the anchor along, so it stays where it is left. An offset of the goal carries
its weight, as when it holds (``gravity_compensation.py``).

The servo's own spring is stiffer than that, and its gain is in EEPROM, which is not changed. So the
goal is a point between the joint and the anchor; it moves with the joint, a hundred times a second.
The torque limit, in RAM, is what carries the weight and a little more, or what a wall pushes with:
the joint can never push harder than that against a hand, whatever else goes wrong.

*A joint in motion* is helped against its friction and its motor brake, which are most of what a
hand feels. But the servo's set-point is late: at 30 deg/s it is 1.5 deg behind, and would pull the
joint back with all that the limit leaves. So the limit of a moving joint is exactly the wanted
drive, and where that drives it on, the goal lies beyond it by more than the set-point lags. Then
the limit decides how hard the servo drives, and it acts at once.

That is why such a joint cannot drive itself on. Let J be its inertia, K its motor brake per speed,
T the age of the speed that the limit is computed from, and v the speed at which it is let go. The
servo makes at most the share h (``HELP_BRAKE``) of K times the speed T ago, counted up to c
(``FAST``), and a share of the friction that leaves some of it. With h < 1 the joint slows down,
however old the speed is. Without any friction it would still go D, where
J v = K D - h K (D + T min(v, c)), so D = (v J / K + h T min(v, c)) / (1 - h). J is at most
0.036 kg m^2, K is 1.3 N m s/rad at a servo of 12 V, and T is 0.06 s: half the window of the speed,
half a cycle and the servo's loop. That is 5 deg at 30 deg/s and 12 deg at 90 deg/s. Friction is
helped only while the joint moves, or a joint that has stopped would creep on.

*A load that was learnt* while the arm held may be wrong in another pose, or gone: somebody has
taken the object out of the jaws, and the arm would fly up as soon as the hand lets go. So it is
treated like friction: carried at first, and while a joint sinks under it. A joint that gives way to
it, moving where it pushes, counts on it no longer after twice ``ENGAGING``. However much of it is
really there opposes the motion then, so a hand that lifts the joint lifts the load itself. What was
learnt is taken for a mass in the gripper as far as possible: one too large only makes the arm
heavier to lift, one too small would let it sink where its arm is longer.

A weight that nothing has learnt would let a joint sink once it is released. While it is slow, the
joint therefore learns a small offset that keeps it at its anchor. A slow hand teaches it one, too,
hence the bound. The offset may always shrink.

*Walls.* Where the arm would touch something ``LOOK_AHEAD`` later, the anchor stays behind, and the
hand feels a damped spring that pushes with ``Compliance.wall`` at most. A hand that is stronger
takes the anchor along, so the joint does not go back far when it is let go. Only the joints that
lead into contact are held back. A joint that comes to a wall within ``LEAD`` is no longer helped
against its motor brake: its set-point is back at the joint when the wall begins to push.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np

from so101_motion.common.compliance import Compliance, Wall
from so101_motion.common.units import to_rad
from so101_motion.drivers.feetech.gravity_compensation import ENGAGING, Trim
from so101_motion.drivers.feetech.servo_model import full_drive_error

LEARNING = 5.0
"""Gain of the learnt offset [1/s], as when the joint holds."""

UNSURE = 0.3
"""Bound of the learnt offset as a share of the joint's modelled weight: for an object in the
gripper or another supply voltage. Chosen: 50 g in the jaws are that much at the shoulder."""

UNSURE_DRIVE = 0.01
"""Share of full drive that is added to this bound. Chosen."""

SLOW = to_rad(6.0)
"""A slower joint learns [rad/s]; chosen, nobody guides an arm so slowly for long."""

CONTENT = 0.6
"""Share of the dead band within which a joint learns nothing. Chosen: with play and friction it
would otherwise swing about its anchor for ever, once in 14 s."""

HELP_FRICTION = 0.5
"""Share of the friction that is compensated for the hand. Chosen: the rest holds the joint, and a
quarter is left if friction is a third less than modelled."""

HELP_BRAKE = 0.6
"""Share of the motor brake that is compensated, up to ``FAST``. Chosen as large as the way of a
joint that is let go allows, see above. How strong the motor is cancels out: it makes both."""

FAST = to_rad(60.0)
"""A joint is helped no more than at this speed [rad/s]. Chosen with ``HELP_BRAKE``."""

LEAD = 0.1
"""How far beyond a moving joint its goal lies, by its speed above ``SLOW`` [s]. It covers the lag
of the set-point up to ``FAST``: 0.065 s to stop from there by 464 deg/s^2, and 0.03 s until a goal
acts. More would change nothing, because the limit decides. It grows by ``FAST`` at most, and only
as long as the goal is no faster than twice that."""

STANDING = 0.3
"""How long after a motion the limit of a standing joint is back [s]: by then its servo's set-point
has returned to the joint. Chosen: from ``LEAD`` at ``FAST`` that takes 0.3 s."""

WALL_DEPTH = to_rad(2.5)
"""How far an anchor stays behind a joint at a wall, beyond the dead band [rad]; there the wall
pushes hardest. Chosen by trial, with the next: walls twice as strong keep fitted servos still."""

LOOK_AHEAD = 0.02
"""A wall acts on where a joint will be so much later [s], which damps its spring. Chosen by trial:
with 0.03 s servos that differ swing to and fro between two walls that are twice as strong; without
it a joint is still at 40 deg/s a tenth of a second before it stops, with it at 1."""

_ROUNDING = 1e-9

N = 5
"""The joints of the arm; the jaw is not guided."""


class HandGuiding:
    """Computes the goals of the arm joints while a hand guides them.

    ``trim`` has carried them until now, at ``q`` [rad]. ``wall`` says how far a hand may lead them
    without resistance; None for anywhere.
    """

    def __init__(
        self,
        compliance: Compliance,
        trim: Trim,
        q: Sequence[float],
        now: float,
        wall: Wall | None = None,
    ) -> None:
        self._compliance, self._trim, self._now, self._wall = compliance, trim, now, wall
        self._anchor = list(q[:N])
        self._q, self._way = list(q), [0.0] * N
        self._moving, self._ahead, self._goals = [0.0] * N, [0.0] * N, list(q[:N])
        self._mass, self._known = trim.taken_for_mass()  # [kg], [rad]: what holding has learnt
        self._trusted = [1.0] * N  # the share of both that each joint counts on
        self._learnt = [0.0] * N
        self._softness = [
            min(full_error / full_drive_error(1) * compliance.p_gain, 1.0)
            for full_error in trim.full_drive_errors
        ]

    def step(
        self, q: Sequence[float], qd: Sequence[float], now: float
    ) -> tuple[list[float], list[float]]:
        """The goals of the arm joints [rad] and the shares of full drive they may use, ``now`` [s].

        ``q`` and ``qd`` are measured, of all six joints [rad, rad/s].
        """
        band = self._compliance.dead_band
        dt, self._now = now - self._now, now
        goals, shares = [], []
        self._way = [
            min(max(way + (now - before) / ENGAGING, -1.0), 1.0)
            for way, now, before in zip(self._way, q, self._q, strict=False)
        ]
        self._trust(q)
        self._q = list(q)
        off, walled = self._lead(q, qd)
        speeds = [0.0 if i in walled else min(max(qd[i], -FAST), FAST) for i in range(N)]
        ways = [
            HELP_FRICTION * way * moving
            for way, moving in zip(self._way, self._moving, strict=True)
        ]
        masses = [self._mass * trusted for trusted in self._trusted]
        weights = self._trim.explain(q, ways, [HELP_BRAKE * v for v in speeds], masses)
        for i, speed in enumerate(speeds):
            away, full_error = self._anchor[i] - q[i], self._trim.full_drive_errors[i]
            at_wall = abs(off[i]) > band
            if not at_wall:
                self._learn(i, away, qd[i], dt, weights[i])
            carried = weights[i] + self._trusted[i] * self._known[i] + self._learnt[i]
            limit = abs(carried) / full_error + self._compliance.resistance
            self._moving[i] = max(min(abs(speed) / SLOW, 1.0), self._moving[i] - dt / STANDING)
            if at_wall:
                push = self._compliance.wall * min((abs(off[i]) - band) / WALL_DEPTH, 1.0)
                self._ahead[i] = 0.0
                goals.append(q[i] + math.copysign(push * full_error, off[i]) + carried)
                shares.append(max(limit, abs(carried) / full_error + push))
                continue
            stiffest = self._compliance.resistance * full_error
            wanted = min(max(self._softness[i] * away, -stiffest), stiffest) + carried
            lead = LEAD * max(abs(speed) - SLOW, 0.0) if wanted * speed > 0.0 else 0.0
            reach = (self._goals[i] - q[i] - wanted) * math.copysign(1.0, wanted) + 2.0 * FAST * dt
            self._ahead[i] = max(min(lead, self._ahead[i] + FAST * dt, reach), 0.0)
            goals.append(q[i] + wanted + math.copysign(self._ahead[i], wanted))
            own = self._trim.models[i].drive(wanted)
            shares.append(limit + self._moving[i] * (own - limit))
        self._goals = goals
        return goals, shares

    def _trust(self, q: Sequence[float]) -> None:
        """Find how far each joint counts on the load that was learnt before."""
        for i, per_kg in enumerate(self._trim.per_kg(q)[:N]):
            torque = self._mass * per_kg + self._trim.models[i].stiffness * self._known[i]
            way = (q[i] - self._q[i]) * float(np.sign(torque)) / (2.0 * ENGAGING)
            self._trusted[i] = min(max(self._trusted[i] - way, 0.0), 1.0)

    def _lead(self, q: Sequence[float], qd: Sequence[float]) -> tuple[list[float], Collection[int]]:
        """Take the anchors along; where walls do not let them go, leave them behind.

        Returns:
            How far behind walls hold each of them [rad], and the joints that come to one soon.
        """
        band, here, off = self._compliance.dead_band, self._anchor, [0.0] * N
        self._anchor = [_near(at, q[i], band) for i, at in enumerate(here)]
        if self._wall is None:
            return off, ()
        later = np.array([[LOOK_AHEAD], [LOOK_AHEAD + LEAD]])
        ahead = np.array(q[:N]) + later * np.array(qd[:N])
        guided = np.clip(here, ahead - band, ahead + band)
        if np.array_equal(guided, [here, here]):
            return off, ()
        allowed = self._wall(np.array(here), guided)
        held = np.abs(allowed - guided) > _ROUNDING
        for i in np.flatnonzero(held[0]):
            at = float(ahead[0, i])
            self._anchor[i] = _near(float(allowed[0, i]), at, band + WALL_DEPTH)
            off[i] = self._anchor[i] - at
        return off, set(np.flatnonzero(held.any(axis=0)).tolist())

    def _learn(self, i: int, away: float, qd: float, dt: float, weight: float) -> None:
        learnt = self._learnt[i]
        if abs(away) < CONTENT * self._compliance.dead_band or (
            abs(qd) > SLOW and away * learnt >= 0.0
        ):
            return
        bound = UNSURE * abs(weight) + UNSURE_DRIVE * self._trim.full_drive_errors[i]
        self._learnt[i] = min(max(learnt + LEARNING * dt * away, -bound), bound)


def _near(angle: float, q: float, most: float) -> float:
    return min(max(angle, q - most), q + most)
