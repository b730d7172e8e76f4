"""Keep an arm that is led clear of itself and its surroundings, one short path at a time.

Three questions of a control cycle:

* ``look``: what is near, and what a joint has left to bear on?
* ``within_reach``: where is the place nearest to a target that what is near leaves room for? A
  guess, from distances that are taken as linear in the joint angles: led arms slide along things.
* ``admits``: is a path clear and bearable? A proof; whatever the guess was, nothing is touched by
  who takes only steps from which an admitted path leads to rest.

Belongs to one thread, like the ``CollisionModel``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.batch_check import BOUND, NEAR_ROW
from so101_motion.planning.collision.bodies import NEAR
from so101_motion.planning.collision.collision import ClosePair, CollisionModel
from so101_motion.planning.collision.course import NearArms
from so101_motion.planning.collision.led_apart import GAP
from so101_motion.planning.differential.nearest_within import BoundedStep
from so101_motion.planning.timing.torque import Load, TorqueReserve

RANGE = 0.05
"""From how near on, beyond the margin, bodies are approached more slowly [m]. Chosen: a tool that
moves at 0.25 m/s brakes within that at 0.6 m/s^2; what comes faster ``admits`` stops."""

BENT = 0.3
"""Share of the smallest margin by which a path may bend between its places; chosen."""

FAST = 0.01
"""From how long a path to rest on servos are taken to be inexact [m] of travel; chosen."""

INEXACT = 0.015
"""By how much more than its margin such a path keeps clear [m]. Servos that are stopped from speed
swing past the end of the ramp: led to and fro at 180 deg/s, a fitted emulated arm came 13 mm
nearer to a table than its command, and once farther."""

AHEAD, AHEAD_SHARE = 0.02, 0.2
"""How much more that is for servos that are driven ahead of the command, to make up for what they
lag behind: at most so much [m], and that share of the travel. Emulated, among hostile targets at
150 deg/s, a joint came 21 mm nearer to the table than its command."""

AHEAD_STEP = 0.002
"""That is rounded up to whole multiples of this [m]; chosen, small beside ``INEXACT``."""

PLACES = 4
"""At about how many places of a path it is seen whether bodies part; chosen, for they are short."""

_CLOSER = 1e-6
"""What pairs that are too close already may come closer by in one path [m]: rounding."""


class Guard:
    """Says what an arm that is led has room for.

    Bodies that are too close already may only part: no pair that is within its margin may come
    closer. What is too heavy already may only get lighter.

    Args:
        collision: What is in the way; from now on the guard's own.
        q_jaw: Where the jaw is wanted now [rad].
        load: What the servos have to bear; None not to look at it. From now on the guard's own.
        acceleration: What the joints do at most on paths that are shown to ``admits``, shape (5,),
            [rad/s^2]; None for paths of straight lines.

    Attributes:
        look_every: How far apart the places of a path that is shown may be [s]: between them it
            bends by no more than ``admits`` allows for.
        against: What the last ``within_reach`` found to stand against its target.
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
        self._widest = float(collision.margins.max(initial=collision.margin))
        self._range = min(NEAR, self._widest + RANGE)
        self._reach: list[float] = collision.reach.tolist()
        self._looked: Array | None = None
        self._rows, self._bounds, self._free = np.zeros((0, NEAR_ROW)), np.zeros((0, BOUND)), 0.0
        self._step = BoundedStep()
        self.against: tuple[ClosePair | TorqueReserve | str, ...] = ()

    @property
    def margin(self) -> float:
        """The smallest distance that any two bodies must keep [m]."""
        return float(self._collision.margins.min(initial=self._collision.margin))

    def look(self, q: Array) -> list[ClosePair | TorqueReserve]:
        """What has little left at ``q``, shape (5,), [rad]: joints, then bodies, nearest first."""
        heavy = self._see(q)
        order = np.lexsort((self._rows[:, 1], self._bounds[:, -1]))
        return [*heavy, *map(self._collision.described, self._rows[order])]

    def _see(self, q: Array) -> list[TorqueReserve]:
        """Look around at ``q``; what is heavy there."""
        near = self._collision.near_bounds(q, self._q_jaw(), within=self._range, gap=GAP)
        self._looked, (self._rows, self._bounds) = q, near
        self._free = min([self._range - self._widest, *self._bounds[:, -1].tolist()])
        return [] if self._load is None else self._load.heavy(q)

    def within_reach(self, q: Array, q_target: Array, others: Sequence[NearArms] = ()) -> Array:
        """The place nearest to a target that there seems to be room for, shape (5,), [rad].

        ``q_target`` itself if nothing stands against it; ``q`` if no place is found.

        Args:
            q: Where the arm is, shape (5,), [rad].
            q_target: Where it shall be, shape (5,), [rad].
            others: What is near of other arms.
        """
        heavy = self._see(q)
        bounds = [self._bounds, *(each.bounds for each in others)]
        if heavy:
            rows = [[*each.gradient, min(0.0, GAP - each.left), -np.inf] for each in heavy]
            bounds.append(np.array(rows))
        nearest, active = self._step.nearest(q_target - q, bounds)
        self.against = tuple(self._named(i, others, heavy) for i in active)
        if nearest is None:
            return q
        return q + nearest if active else q_target

    def _named(
        self, k: int, others: Sequence[NearArms], heavy: Sequence[TorqueReserve]
    ) -> ClosePair | TorqueReserve | str:
        """What the bound ``k`` stands for, counted as in ``within_reach``."""
        if k < len(self._rows):
            return self._collision.described(self._rows[k])
        k -= len(self._rows)
        for each in others:
            if k < len(each.bounds):
                return each.words(k)
            k -= len(each.bounds)
        return heavy[k]

    def admits(self, path: Array, *, ahead: bool = False) -> bool:
        """Whether the straight lines through a path may be gone.

        Args:
            path: Its places, shape (m, 5), m >= 2, [rad].
            ahead: Whether the servos are driven ahead of the command.
        """
        low, high = path.min(axis=0).tolist(), path.max(axis=0).tolist()
        load = self._load
        if load is not None and not (load.surely_admits(low, high) or load.admits(path)):
            return False
        extra = 0.0
        if self._looked is not None:
            spans = zip(low, high, self._looked.tolist(), self._reach, strict=True)
            travel = sum([max(most - at, at - least) * reach for least, most, at, reach in spans])
            if travel > FAST and self._bend:
                extra = INEXACT
                if ahead:  # in steps, for each value is a check of its own to be made and kept
                    extra += min(AHEAD_STEP * math.ceil(AHEAD_SHARE * travel / AHEAD_STEP), AHEAD)
            if travel <= self._free - extra:
                return True
        q_jaw = self._q_jaw()
        if self._collision.first_blocked(path, q_jaw, bend=self._bend, extra=extra) is None:
            return True
        margins = self._collision.margins + (self._bend + extra)
        lack = self._lacking(path[0], q_jaw, margins)
        if not lack.any():
            return False
        places = path[: 0 : -max(1, len(path) // PLACES)]
        return not self._collision.lacks_more(places, q_jaw, margins, lack + _CLOSER)

    def _lacking(self, q: Array, q_jaw: float, margins: Array) -> Array:
        """As ``CollisionModel.lacking``; where it was looked already, that is known."""
        seen = self._widest + INEXACT + AHEAD + self._bend <= self._range
        if self._looked is None or not seen or not np.array_equal(q, self._looked):
            return self._collision.lacking(q, q_jaw, margins)
        lack, pairs = np.zeros(len(margins)), self._rows[:, 0].astype(int)
        lack[pairs] = np.maximum(margins[pairs] - self._rows[:, 1], 0.0)
        return lack

    def words(self, each: ClosePair | TorqueReserve | str) -> str:
        """What has little left, such as ``"the jaw close to the floor"``."""
        if isinstance(each, str):
            return each
        if isinstance(each, TorqueReserve):
            return f"{each.joint} bearing all that it may"
        called = self._collision.scene.called
        return f"{called(each.first)} close to {called(each.second)}"


def room_of(each: ClosePair | TorqueReserve) -> float:
    """How much nearer two bodies may come [m], or what a joint has left as a share."""
    return each.distance - each.margin if isinstance(each, ClosePair) else each.left
