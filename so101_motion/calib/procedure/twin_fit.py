"""Change the figures of one servo until its emulated twin does what its joint did.

Steady motion says much of a servo, but not all: a joint that bears no weight tells friction and
torque only as a ratio there, and play has no part in it. Both show where a joint speeds up, slows
down and turns round: there the motor moves a known inertia besides. So the whole record is used
here. The twin gets the goals that were sent; torque, friction, delay and play are changed, by
Gauss-Newton, until the twin's positions differ least from those that were read.

The twin's positions are taken before they are rounded to ticks, and a delay between two whole
milliseconds is a mix of both: so a small change of a figure is a small change of the motion.
Rounded, the search ended up to 12 % beside the truth.

The inertia is that of the rotor of the servo's type, and a rough one of the links, a third of the
whole at the pan and a twentieth at the roll. What it is off by, as a share, the torque of a joint
without weight is off by, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from so101_motion.calib.procedure.servo_twin import JointRecord, unrounded
from so101_motion.common.geometry import Array
from so101_motion.drivers.emulator.hardware import SO101
from so101_motion.drivers.servo_types import ServoFigures

OPEN = 0.04
"""A torque that is less sure than this share of it is first looked for farther away. Chosen: where
a joint bears weight it is known to 0.01."""

SCALES = (0.8, 0.9, 1.1, 1.2)
"""Of torque and friction together, where that looks; chosen, as wide as servos are to differ."""

AROUND = (-0.16, -0.12, -0.08, -0.04, 0.0, 0.04, 0.08, 0.12, 0.16)
"""Torques around the one that was found, through whose errors a parabola is laid. Chosen: servos
stick, slip and count whole ticks, so the error is not smooth, and its lowest point is up to 0.1
beside the parabola's."""

_STEPS = (0.05, 0.05, 0.0, 0.08)  # for slopes, of torque, friction, delay and play
_WIDTHS = (0.3, 0.3, 8.0, 0.5)  # of a weak prior around where the search stands; [ms] the third
_LARGEST = 3.0  # [tick], what is farther off counts no more: it has another reason
_ROUNDS = 5
_ENOUGH = 0.003  # a smaller change ends the search
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
        self._play = SO101[record.index].lash
        self._known: dict[tuple[float, ...], Array] = {}

    def best(self, figures: ServoFigures, *, torque_is_open: bool) -> ServoFigures:
        """The figures near ``figures`` with which the twin is nearest to the joint.

        Args:
            figures: Where the search begins; a play that is None is left alone.
            torque_is_open: Whether torque and friction may both be far off in the same proportion.
        """
        play = self._play if figures.play is None else figures.play
        begin = (figures.torque, figures.friction, figures.dead_time * self._delay)
        x = np.array([*begin, play / self._play])
        if torque_is_open:
            tried = [x * (scale, scale, 1.0, 1.0) for scale in (1.0, *SCALES)]
            x = min(tried, key=lambda each: _cost(self._off(each)[0]))
        x, normal = self._nearest(x, varies_play=figures.play is not None)
        if torque_is_open:
            x = self._lowest(x, normal)
        return replace(
            figures,
            torque=float(x[0]),
            friction=float(x[1]),
            dead_time=float(x[2]) / self._delay,
            play=None if figures.play is None else float(x[3]) * self._play,
        )

    def _nearest(self, x: Array, *, varies_play: bool) -> tuple[Array, Array]:
        """The nearest figures by Gauss-Newton, and the normal matrix there."""
        prior = 0.1 * np.diag(1.0 / np.square(_WIDTHS))
        off, per_ms = self._off(x)
        normal = prior
        for _ in range(_ROUNDS):
            slopes = np.zeros((len(off), len(x)))
            slopes[:, _DELAY] = per_ms
            whole = x.copy()
            whole[_DELAY] = round(x[_DELAY])
            for i in (0, 1, 3) if varies_play else (0, 1):
                more, less = whole.copy(), whole.copy()
                more[i] += _STEPS[i]
                less[i] -= _STEPS[i]
                slopes[:, i] = (self._at(more) - self._at(less)) / (2.0 * _STEPS[i])
            counts = np.abs(off) <= _LARGEST
            normal = slopes[counts].T @ slopes[counts] + prior
            step = -np.linalg.solve(normal, slopes[counts].T @ off[counts])
            for share in (1.0, 0.5, 0.25):
                found = np.maximum(x + share * step, (0.1, 0.0, 0.0, 0.0))
                found_off, found_per_ms = self._off(found)
                if _cost(found_off) < _cost(off):
                    x, off, per_ms = found, found_off, found_per_ms
                    break
            else:
                break
            if np.abs(step / (1.0, 1.0, self._delay, 1.0)).max() < _ENOUGH:
                break
        return x, normal

    def _lowest(self, x: Array, normal: Array) -> Array:
        """Where the parabola of the error is lowest as the torque changes, and the rest with it."""
        covariance = np.linalg.inv(normal)
        along = covariance[:, 0] / covariance[0, 0]
        found = [_cost(self._off(np.maximum(x + far * along, 0.0))[0]) for far in AROUND]
        bend, slope, _ = np.polyfit(AROUND, found, 2)
        if bend <= 0.0:
            return x
        far = float(np.clip(-0.5 * slope / bend, AROUND[0], AROUND[-1]))
        lowest: Array = np.maximum(x + far * along, (0.1, 0.0, 0.0, 0.0))
        return lowest

    def _off(self, x: Array) -> tuple[Array, Array]:
        """How far off the twin is at each sample [tick], and how that grows with the delay."""
        low, high = x.copy(), x.copy()
        low[_DELAY] = np.floor(x[_DELAY])
        high[_DELAY] = low[_DELAY] + 1.0
        share = x[_DELAY] - low[_DELAY]
        early, late = self._at(low), self._at(high)
        return (1.0 - share) * early + share * late, late - early

    def _at(self, x: Sequence[float] | Array) -> Array:
        """How far off the twin is with a delay of whole milliseconds [tick]."""
        key = tuple(round(float(each), 6) for each in x)
        if key not in self._known:
            torque, friction, delay, play = key
            figures = ServoFigures(
                torque=torque, friction=max(friction, 0.0), dead_time=delay / self._delay,
                play=max(play, 0.0) * self._play,
            )  # fmt: skip
            found = unrounded(self._record, figures, self._weight)
            self._known[key] = found - self._record.ticks
        return self._known[key]


def _cost(off: Array) -> float:
    return float(np.mean(np.minimum(np.square(off), _LARGEST**2)))
