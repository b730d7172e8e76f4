"""Guide the arm by hand: the joints carry their weight and yield to a push.

How it works. A joint holds an angle, its *anchor*, softly: like a spring with the requested P gain.
Pushed beyond the dead band it takes the anchor along, so it stays where it is left. An offset of
the goal carries its weight, as when it holds (``gravity_compensation.py``).

The servo's own spring is stiffer than that, and its gain is in EEPROM, which is not changed. So the
goal is not the anchor but a point between the joint and the anchor; it moves with the joint, a
hundred times a second. The torque limit, in RAM, is what carries the weight and a little more, or
what a wall pushes with: the joint can never push harder than that against a hand, whatever else
goes wrong.

A weight that the model does not know would let a joint sink once it is released. While it is slow,
the joint therefore learns a small offset that keeps it at its anchor. A slow hand teaches it one,
too, hence the bound. The offset may always shrink, so a joint that a hand has led slowly catches
itself when it is released.

*Walls.* Where the arm would touch something ``LOOK_AHEAD`` later, the anchor stays behind, and the
hand feels a damped spring that pushes with ``Compliance.wall`` at most. A hand that is stronger
takes the anchor along, so the joint does not go back far when it is let go. Only the joints that
lead into contact are held back, so a hand can lead the arm along a wall.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from so101_motion.common.compliance import Compliance, Wall
from so101_motion.common.units import to_rad
from so101_motion.drivers.feetech.gravity_compensation import ENGAGING, Trim
from so101_motion.drivers.feetech.servo_model import yielding

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

HELP = 0.5
"""Share of friction and motor brake that is compensated for the hand. Chosen: the rest holds the
joint and slows it down, and stays positive if friction or torque are a third off."""

WALL_DEPTH = to_rad(2.5)
"""How far an anchor stays behind a joint at a wall, beyond the dead band [rad]; there the wall
pushes hardest. Chosen by trial, with the next: walls twice as strong keep fitted servos still."""

LOOK_AHEAD = 0.04
"""A wall acts on where a joint will be so much later [s], which damps its spring. Chosen by trial:
with 0.08 s, a depth of 2 deg and a third more force, joints swung to and fro between two walls."""

_ROUNDING = 1e-9

N = 5
"""The joints of the arm; the jaw is not guided."""


class HandGuiding:
    """Computes the goals of the arm joints while a hand guides them.

    Args:
        compliance: How stiff they are.
        trim: The gravity compensation that has carried them until now.
        q: Their angles [rad].
        now: The time [s].
        wall: How far they may be led without resistance; None for anywhere.
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
        self._known, self._learnt = trim.rest, [0.0] * N
        self._softness = [
            min(give / yielding(1) * compliance.p_gain, 1.0) for give in trim.yielding
        ]

    def step(
        self, q: Sequence[float], qd: Sequence[float], now: float
    ) -> tuple[list[float], list[float]]:
        """The goals of the arm joints now, and the drive that they may use.

        Args:
            q: Measured angles of all six joints [rad].
            qd: Measured velocities [rad/s].
            now: The time [s].

        Returns:
            Goals [rad] and shares of full drive of the arm joints.
        """
        band = self._compliance.dead_band
        dt, self._now = now - self._now, now
        goals, shares = [], []
        self._way = [
            min(max(way + (now - before) / ENGAGING, -1.0), 1.0)
            for way, now, before in zip(self._way, q, self._q, strict=False)
        ]
        self._q = list(q)
        weights = self._trim.explain(q, [HELP * way for way in self._way], [HELP * v for v in qd])
        off = self._lead(q, qd)
        for i in range(N):
            away, resistance = self._anchor[i] - q[i], self._compliance.resistance
            pull = self._softness[i] * away
            if abs(off[i]) > band:  # at a wall
                push = self._compliance.wall * min((abs(off[i]) - band) / WALL_DEPTH, 1.0)
                pull = math.copysign(push * self._trim.yielding[i], off[i])
                resistance = max(push, resistance)
            else:
                self._learn(i, away, qd[i], dt, weights[i])
            carried = weights[i] + self._known[i] + self._learnt[i]
            goals.append(q[i] + pull + carried)
            shares.append(abs(carried) / self._trim.yielding[i] + resistance)
        return goals, shares

    def _lead(self, q: Sequence[float], qd: Sequence[float]) -> list[float]:
        """Take the anchors along; return how far those that a wall holds are behind [rad]."""
        band, here, off = self._compliance.dead_band, self._anchor, [0.0] * N
        self._anchor = [_near(at, q[i], band) for i, at in enumerate(here)]
        if self._wall is None:
            return off
        ahead = [q[i] + LOOK_AHEAD * qd[i] for i in range(N)]
        led = [_near(at, ahead[i], band) for i, at in enumerate(here)]
        if led == here:
            return off
        allowed = self._wall(np.array(here), np.array(led)).tolist()
        for i in range(N):
            if abs(allowed[i] - led[i]) > _ROUNDING:
                self._anchor[i] = _near(allowed[i], ahead[i], band + WALL_DEPTH)
                off[i] = self._anchor[i] - ahead[i]
        return off

    def _learn(self, i: int, away: float, qd: float, dt: float, weight: float) -> None:
        learnt = self._learnt[i]
        if abs(away) < CONTENT * self._compliance.dead_band or (
            abs(qd) > SLOW and away * learnt >= 0.0
        ):
            return
        bound = UNSURE * abs(weight) + UNSURE_DRIVE * self._trim.yielding[i]
        self._learnt[i] = min(max(learnt + LEARNING * dt * away, -bound), bound)


def _near(angle: float, q: float, most: float) -> float:
    """The angle nearest to ``angle`` that is at most ``most`` from ``q`` [rad]."""
    return min(max(angle, q - most), q + most)
