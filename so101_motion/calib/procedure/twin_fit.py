"""Change the figures of one servo until its emulated twin does what its joint did.

Steady motion says much of a servo, but not all: a joint that bears no weight tells friction and
torque only as a ratio there, and play has no part in it. Both show where a joint speeds up, slows
down and turns round: there the motor moves a known inertia besides. So the whole record is used
here. The twin gets the goals that were sent; torque, friction, delay and play are changed, by
Gauss-Newton, until the twin's positions differ least from those that were read.

The search changes the voltages that inertia and friction take, ``1 / torque`` and ``friction /
torque``, for the twin's position is nearly linear in them: steps do not end beside the truth, and a
wrong torque is not taken for a wrong friction.

A twin sticks, slips and counts whole ticks, so the slightest change makes it differ by 0.15 tick
here and there. A tenth more torque of a joint without weight moves it by 0.1. Slopes are
therefore not taken from neighbours but by regression through eight twins a round, all figures
changed in each, and through those of earlier rounds nearby. With slopes from pairs of neighbours
the torque at which a joint breaks away was up to 25 % off, on recordings that give 13 % now.

The twin's positions are taken before they are rounded to ticks, and a delay between two whole
milliseconds is a mix of both.

A weight that changes sides takes the output through the play at a moment that nobody knows to
10 ms, so the play that suits the whole record is a little too large. That of a joint with weight is
therefore a mean of two (``SEEN``): this one, and the one that ``servo_fit.play`` saw at such
moments alone.

The inertia is that of the rotor of the servo's type, and a rough one of the links, a third of the
whole at the pan and a twentieth at the roll. What it is off by, as a share, the torque of a joint
without weight is off by, too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from so101_motion.calib.procedure.servo_twin import JointRecord, unrounded
from so101_motion.common.geometry import Array
from so101_motion.drivers.servo_types import ServoFigures

OPEN = 0.04
"""A torque that is less sure than this share of it is first looked for farther away. Chosen: where
a joint bears weight it is known to 0.01."""

FAR, NEAR, FINE = (0.12, 0.06, 1.0, 0.12), (0.06, 0.04, 1.0, 0.08), (0.02, 0.03, 1.0, 0.05)
"""How far twins are from the place of the search: in ``1 / torque``, in ``friction / torque``, in
milliseconds of delay, of which the whole ones on both sides are taken, and in shares of the usual
play. Chosen by trial: with ``NEAR``, the torque of a joint without weight changes its motion about
as much as sticking and slipping do; a weight shows the torque with ``FINE``, too."""

ROUNDS = {True: (FAR, NEAR, NEAR, NEAR), False: (NEAR, FINE)}
"""The rounds of a search, by whether the torque is open."""

SEEN = 0.6
"""Weight of the play seen at such moments. Chosen on recordings of 20 emulated arms, each joint
alone and all in a row: this play is 0 to 2 % too small on average, the other 2 to 7 % too large,
and each of both varies by 3 % from one recording to the next."""

_CORNERS = np.array(
    [(a, b, c, a * b * c) for a in (-1.0, 1.0) for b in (-1.0, 1.0) for c in (-1.0, 1.0)]
)
_STEADY = 0.1  # weight of a prior around the place of the search, three times as wide as the twins
_LARGEST = 3.0  # [tick], what is farther off does not count: it has another reason
_FARTHEST = np.array((2.0, 2.0, 3.0, 2.0))  # step of a round, in distances of its twins
_LEAST = np.array((0.1, 0.0, 0.0, 0.0))
_MS = 1000.0
_DELAY = 2


class TwinFit:
    """The search for the figures of one servo.

    Args:
        record: What its joint did.
        weight: The torque that holds the joint at each sample, shape (k,), [N m].
    """

    def __init__(self, record: JointRecord, weight: Array) -> None:
        self._record, self._weight = record, weight
        self._delay = record.kind.goal_delay * _MS
        self._play = record.kind.play
        self._twins: list[Array] = []
        self._off: list[Array] = []

    def best(self, figures: ServoFigures, *, torque_is_open: bool) -> ServoFigures:
        """The figures near ``figures`` with which the twin is nearest to the joint.

        Args:
            figures: Where the search begins; a play that is None is left alone.
            torque_is_open: Whether torque and friction may both be far off in the same proportion.
        """
        play = self._play if figures.play is None else figures.play
        inertia, friction = 1.0 / figures.torque, figures.friction / figures.torque
        x = np.array([inertia, friction, figures.dead_time * self._delay, play / self._play])
        free = np.array([True, True, True, figures.play is not None])
        for distances in ROUNDS[torque_is_open]:
            x = self._nearer(x, np.array(distances), free)
        found = self._figures(x, varies_play=figures.play is not None)
        if torque_is_open or figures.play is None or found.play is None:
            return found
        return replace(found, play=SEEN * figures.play + (1.0 - SEEN) * found.play)

    def _nearer(self, x: Array, distances: Array, free: NDArray[np.bool_]) -> Array:
        """One round of the search from ``x``, with twins at ``distances`` from there."""
        whole = x.copy()
        whole[_DELAY] = np.floor(x[_DELAY]) + 0.5
        for corner in _CORNERS:
            at = whole + corner * np.where(free, distances, 0.0) * (1.0, 1.0, 0.5, 1.0)
            self._add(np.maximum(at, _LEAST))
        aside = np.array(self._twins) - x
        near = np.all(np.abs(aside) <= 2.0 * distances + 1e-9, axis=1)
        near |= np.arange(len(near)) >= len(near) - len(_CORNERS)
        columns = np.column_stack([np.ones(int(near.sum())), aside[near][:, free]])
        lines = np.linalg.lstsq(columns, np.array(self._off)[near], rcond=None)[0]
        counts = np.abs(lines[0]) <= _LARGEST
        off, slopes = lines[0][counts], lines[1:].T[counts]
        prior = np.diag(_STEADY / np.square(3.0 * distances[free]))
        step = np.zeros(len(x))
        step[free] = -np.linalg.solve(slopes.T @ slopes + prior, slopes.T @ off)
        farthest = _FARTHEST * distances
        nearer: Array = np.maximum(x + np.clip(step, -farthest, farthest), _LEAST)
        return nearer

    def _add(self, x: Array) -> None:
        """Let the twin with ``x`` do what the joint did, and note how far off it is [tick]."""
        figures = self._figures(x, varies_play=True)
        self._twins.append(x)
        self._off.append(unrounded(self._record, figures, self._weight) - self._record.ticks)

    def _figures(self, x: Array, *, varies_play: bool) -> ServoFigures:
        inertia, friction, delay, play = (float(each) for each in x)
        return ServoFigures(
            torque=1.0 / inertia,
            friction=friction / inertia,
            dead_time=delay / self._delay,
            play=play * self._play if varies_play else None,
        )
