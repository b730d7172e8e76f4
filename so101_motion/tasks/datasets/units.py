"""Convert a data set's numbers between LeRobot's units and angles of the model, and find its units.

* ``degrees``: from the middle of each joint's recorded travel, LeRobot's default since January
  2026. It divides a turn into 4095 parts where servos count 4096.
* ``range``: -100 to 100 over that travel, LeRobot's default from June 2025 until then.
* ``old``: degrees from the arm stretched out horizontally, shoulder_lift and wrist_roll counting
  the other way round; LeRobot before June 2025.
* ``model``: degrees with the zero of the robot model; ours.

The jaw is in per cent of its travel in all of them. Travels that are not known are assumed to be
from stop to stop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import so101_description
from numpy.typing import NDArray

from so101_motion.calib.record.lerobot import STRETCHED, TURNED
from so101_motion.calib.record.record import JOINTS, WIDEST, JointCalibration
from so101_motion.calib.record.store import Stored
from so101_motion.calib.record.zero import (
    MIDDLE,
    STOPS,
    SWEPT,
    Zero,
    by_stops,
    encoder_zeros,
    expected_travel,
)
from so101_motion.common.encoder_zeros import EncoderZeros
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array, freeze
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_deg, to_rad
from so101_motion.drivers.bus.registers import TICKS_PER_TURN
from so101_motion.drivers.bus.ticks import RAD_PER_TICK, TICKS_PER_RAD

JAW_CLOSED, JAW_OPEN = so101_description.ROBOT.limits[GRIPPER_JOINT]  # [rad]

DEGREES, RANGE, OLD, MODEL = "degrees", "range", "old", "model"
KINDS = (DEGREES, RANGE, OLD, MODEL)

IN_WORDS = {
    DEGREES: "degrees from the middle of each travel (LeRobot's use_degrees)",
    RANGE: "-100 to 100 over each travel",
    OLD: "degrees from the stretched arm (LeRobot before June 2025)",
    MODEL: "degrees with the model's zero",
}

_LEROBOTS_TURN = TICKS_PER_TURN - 1  # LeRobot divides a turn by this
_FULL_TURN = (0, TICKS_PER_TURN - 1)  # LeRobot's travel of wrist_roll


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Units:
    """Converts a data set's numbers to angles of the model, and back."""

    kind: str  # one of ``KINDS``
    factor: Array  # the model's angle for each unit, shape (6,), [rad]
    offset: Array  # the model's angle at 0, shape (6,), [rad]
    lower: Array  # the lower end of the travel, shape (6,), [rad]
    upper: Array  # the upper end, shape (6,), [rad]
    zeros: tuple[str, ...]  # source of each arm joint's zero, as in ``Zero.by``, or ``"assumed"``
    is_jaw_known: bool  # whether a calibration gives the jaw's travel
    calibration: Stored | None = None  # of the arm that was recorded; None if it is not known

    def __post_init__(self) -> None:
        freeze(self, factor=(6,), offset=(6,), lower=(6,), upper=(6,))

    @property
    def encoder_zeros(self) -> EncoderZeros | None:
        """The zeros that its angles count from; None unless all of the arm's joints are known."""
        known = self.calibration
        if known is None or not all(joint in known.calibration for joint in ARM_JOINTS):
            return None
        zeros = known.zeros
        if self.kind in (DEGREES, RANGE):
            zeros = {j: _zero(j, known.calibration[j], known)[0] for j in ARM_JOINTS}
        return encoder_zeros(known.calibration, zeros)

    def to_model(self, x: Array) -> Array:
        """Convert numbers of the data set to angles of the model [rad], shapes (n, 6)."""
        return np.asarray(x * self.factor + self.offset)

    def from_model(self, q: Array) -> Array:
        """Convert angles of the model [rad] to numbers of the data set, shapes (n, 6)."""
        return np.asarray((q - self.offset) / self.factor)

    def numbers(self, q: Array, aperture: float) -> list[float]:
        """A row of the data set: joint angles, shape (5,), [rad], and an aperture, 0 to 1."""
        return [*self.from_model(np.append(q, 0.0))[:5].tolist(), 100.0 * aperture]

    def aperture(self, q_jaw: Array) -> Array:
        """How far jaws are open, 0 to 1, by the travel of the arm that was recorded."""
        lower, upper = self.lower[5], self.upper[5]
        return np.asarray(np.clip((q_jaw - lower) / (upper - lower), 0.0, 1.0))


def units_of(kind: str, calibration: Stored | None = None) -> Units:
    """The units of a kind, for an arm with this calibration; ``ConfigError`` for no such kind."""
    if kind not in KINDS:
        raise ConfigError("units", kind, f"must be one of {', '.join(KINDS)}")
    joints = [_joint(kind, joint, calibration) for joint in JOINTS]
    factor, offset, lower, upper = np.array([numbers for numbers, _ in joints]).T
    return Units(
        kind=kind,
        factor=factor,
        offset=offset,
        lower=lower,
        upper=upper,
        zeros=tuple(zero_by for _, zero_by in joints[:5]),
        is_jaw_known=calibration is not None and GRIPPER_JOINT in calibration.calibration,
        calibration=calibration,
    )


def exact_units_of(kind: str, calibration: Stored | None, *, option: str) -> Units:
    """The units of a kind; ``ConfigError`` if they need a calibration that is missing.

    ``option`` is the name of the calibration's setting, for errors.
    """
    units = units_of(kind, calibration)
    if kind in (DEGREES, RANGE):
        if calibration is None:
            reason = f"is needed for {IN_WORDS[kind]}, because it has the zeros and travels"
            raise ConfigError(option, None, reason)
        missing = [joint for joint in JOINTS if joint not in calibration.calibration]
        if missing:
            raise ConfigError(option, str(calibration.path), f"lacks {', '.join(missing)}")
    return units


def _joint(
    kind: str, joint: str, stored: Stored | None
) -> tuple[tuple[float, float, float, float], str]:
    """Factor, offset, lower and upper end of a joint, as in ``Units``, and its zero's source."""
    entry = None if stored is None else stored.calibration.get(joint)
    travel = _travel(joint, entry)
    if joint == GRIPPER_JOINT:
        upper = JAW_CLOSED + (JAW_OPEN - JAW_CLOSED if entry is None else travel * RAD_PER_TICK)
        share = (upper - JAW_CLOSED) / 100.0
        return (share, JAW_CLOSED, JAW_CLOSED, upper), ""
    zero, known = _zero(joint, entry, stored)
    half = travel / 2.0 * RAD_PER_TICK
    lower, upper = zero.angle - half, zero.angle + half
    if entry is None or travel > WIDEST:  # a whole turn, as LeRobot writes down for wrist_roll
        lower, upper = STOPS[joint]
    if kind in (OLD, MODEL):
        turned = kind == OLD and TURNED[joint]
        offset = STRETCHED[joint] if kind == OLD else 0.0
        return (to_rad(-1.0 if turned else 1.0), offset, lower, upper), "model"
    if kind == RANGE:
        factor = half / 100.0
    else:  # LeRobot counts degrees as the servo counts, whatever drive_mode says
        turned = entry is not None and entry.drive_mode != 0
        factor = (-1.0 if turned else 1.0) * _LEROBOTS_TURN / 360.0 * RAD_PER_TICK
    return (factor, zero.angle, lower, upper), known


def _travel(joint: str, entry: JointCalibration | None) -> float:
    """The recorded travel, or the usual one if there is none [tick]."""
    if entry is not None:
        return float(entry.range_max - entry.range_min)
    if joint in SWEPT:
        return expected_travel(joint)
    if joint == GRIPPER_JOINT:
        return float(JAW_OPEN - JAW_CLOSED) * TICKS_PER_RAD
    return float(_FULL_TURN[1] - _FULL_TURN[0])


def _zero(joint: str, entry: JointCalibration | None, stored: Stored | None) -> tuple[Zero, str]:
    """The model's angle in the middle of the travel, and how it is known."""
    if entry is None or stored is None:
        if joint in SWEPT:
            lower, upper = STOPS[joint]
            return Zero(by="stops", angle=(lower + upper) / 2.0), "assumed"
        return MIDDLE, "assumed"
    known = stored.zeros.get(joint) or by_stops(joint, entry) or MIDDLE
    return known, known.by


# Finding the units


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """How well numbers fit the units of a kind."""

    kind: str
    outside: float  # the share of frames in which some arm joint is beyond its stops, 0 to 1
    worst_deg: float  # how far the furthest is beyond them [deg]


_BEYOND = math.radians(5.0)  # a joint may seem to be beyond a stop [rad]: play. Chosen.


CERTAIN, LIKELY, UNKNOWN = "certain", "likely", "unknown"

_RELEASES = {
    RANGE: ("so100_follower", "so101_follower", "so100_follower_end_effector"),
    DEGREES: ("so_follower", "so101_motion"),
}
"""Robot types, of two arms with ``bi_`` before, by the units that are the default in every release
that writes them (for so_follower in all but 0.4.3). Source: LeRobot 0.3.3, 0.4.2, 0.4.4 and
0.6.1, and our plugin."""

_COUNTS = {DEGREES: (TICKS_PER_TURN - 1) / 180.0, OLD: TICKS_PER_TURN / 360.0}
"""Positions times this are whole numbers, as servos count; a middle may be half a count."""

_TRAVELS = np.arange(700, TICKS_PER_TURN)  # [tick] that a joint of -100 to 100 may have
_NEAR = 1e-3  # [tick]; 32-bit numbers are off by 1e-4
_FEWEST, _MOST = 8, 300  # different positions of a joint that tell its counts


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The units of a data set."""

    kind: str  # one of ``KINDS``
    certainty: str  # ``"certain"``, ``"likely"``, or ``"unknown"`` where the evidence is not enough
    why: str  # the evidence as text


_TO_PER_CENT = ": scale it to 0 to 100 before it is replayed or converted"
"""What to do about a jaw in other units."""


class UnitsGuess:
    """Finds the units of a data set from its numbers, its names and the release that wrote it."""

    def __init__(self, calibration: Stored | None = None) -> None:
        self._kinds = {kind: units_of(kind, calibration) for kind in KINDS}
        self._outside = dict.fromkeys(KINDS, 0)
        self._worst = dict.fromkeys(KINDS, 0.0)
        self._frames = self._clipped = 0
        self._largest = 0.0
        self._positions: list[Array] = [np.zeros(0)] * 6
        self._jaw = np.array([np.inf, -np.inf])

    def add(self, x: Array) -> None:
        """Add some frames, shape (n, 6), in the data set's units."""
        jaw = x[np.isfinite(x[:, 5]), 5]
        if len(jaw):
            self._jaw = np.array([min(self._jaw[0], jaw.min()), max(self._jaw[1], jaw.max())])
        for i, known in enumerate(self._positions):
            if len(known) < _MOST:
                values = x[np.isfinite(x[:, i]), i]
                self._positions[i] = np.unique(np.concatenate([known, values]))[:_MOST]
        x = x[np.isfinite(x[:, :5]).all(axis=1), :5]
        if not len(x):
            return
        self._frames += len(x)
        self._largest = max(self._largest, float(np.abs(x).max()))
        self._clipped += int((np.abs(np.abs(x) - 100.0) < 1e-4).any(axis=1).sum())
        for kind, units in self._kinds.items():
            q = x * units.factor[:5] + units.offset[:5]
            lower, upper = (np.array([STOPS[joint][end] for joint in ARM_JOINTS]) for end in (0, 1))
            over = np.maximum(lower - q, q - upper).max(axis=1)
            self._outside[kind] += int((over > _BEYOND).sum())
            self._worst[kind] = max(self._worst[kind], float(to_deg(float(over.max()))))

    def fits(self) -> tuple[Fit, ...]:
        frames = max(self._frames, 1)
        return tuple(
            Fit(kind=kind, outside=self._outside[kind] / frames, worst_deg=self._worst[kind])
            for kind in KINDS
        )

    @property
    def too_small(self) -> str:
        """Why the arm's numbers are too small for any of the units; empty if they are not."""
        if not 0.0 < self._largest <= 3.2 or self._by_counts():
            return ""
        unit = "radians or numbers from -1 to 1" if self._largest <= 1.0 else "radians"
        return (
            f"no arm joint is ever beyond {self._largest:.2f}, so these are hardly degrees or"
            f" -100 to 100; perhaps they are {unit}"
        )

    def doubts(self) -> tuple[str, ...]:
        lowest, highest = self._jaw.tolist()
        found = [self.too_small] if self.too_small else []
        if lowest < -10.0 or highest > 110.0:
            found.append(
                f"the jaw goes from {lowest:.0f} to {highest:.0f}, so it is hardly in per cent of"
                f" its travel{_TO_PER_CENT}"
            )
        elif lowest >= -1.0 and highest <= 1.8 and self._jaw_is_too_fine(highest - lowest):
            unit = "0 to 1" if lowest >= -0.05 and highest <= 1.05 else "radians"
            found.append(
                f"the jaw is never beyond {max(highest, -lowest):.2f}, so it is hardly in per cent"
                f" of its travel; perhaps in {unit}{_TO_PER_CENT}"
            )
        return tuple(found)

    def _jaw_is_too_fine(self, spread: float) -> bool:
        """Whether a jaw that moved this little was at more places than servo counts in per cent."""
        counts = spread / 100.0 * TICKS_PER_TURN
        return spread > 0.5 or (spread > 0.0 and len(self._positions[5]) > counts + 2.0)

    def best(self, robot: str, version: str, names: tuple[str, ...]) -> Verdict:
        """The likeliest kind by robot type, version and joint names, how certain, and why."""
        has_new_names = any(name.endswith(".pos") for name in names)
        if any("main_" in name for name in names):
            why = "only LeRobot before June 2025 named joints main_shoulder_pan and so on"
            return Verdict(kind=OLD, certainty=CERTAIN, why=why)
        if kind := self._by_counts():
            why = "the positions are whole servo counts in these units, and in no others"
            return Verdict(kind=kind, certainty=CERTAIN, why=why)
        if self._largest <= 100.0001 and self._clipped:
            why = "no number is beyond 100, and some are exactly 100"
            return Verdict(kind=RANGE, certainty=CERTAIN, why=why)
        outside = {fit.kind: fit.outside for fit in self.fits()}
        if min(outside.values()) > 0.5:
            why = "the joints would be beyond their stops in all of them"
            return Verdict(kind=DEGREES, certainty=UNKNOWN, why=why)
        if outside[OLD] + 0.05 < outside[DEGREES] and self._largest > 100.5:
            share = f"{100.0 * outside[DEGREES]:.0f} % of the frames would be beyond the stops"
            why = f"in degrees from the middle of the travels {share}"
            return Verdict(kind=OLD, certainty=LIKELY, why=why)
        if self._largest > 100.5:
            return Verdict(kind=DEGREES, certainty=LIKELY, why="some numbers are beyond 100")
        if not has_new_names and version.startswith("v2") and not robot.endswith("_follower"):
            why = "LeRobot since June 2025 names joints shoulder_pan.pos and so on"
            return Verdict(kind=OLD, certainty=LIKELY, why=why)
        for kind, robots in _RELEASES.items():
            if robot.removeprefix("bi_") in robots:
                why = f"it is the default of the releases that write robot type {robot}"
                return Verdict(kind=kind, certainty=LIKELY, why=why)
        if has_new_names and version.startswith("v2"):
            why = f"it was the default while LeRobot wrote version {version} with these names"
            return Verdict(kind=RANGE, certainty=LIKELY, why=why)
        why = f"robot type {robot or 'none'} and the numbers fit degrees as well as -100 to 100"
        return Verdict(kind=DEGREES, certainty=UNKNOWN, why=why)

    def _by_counts(self) -> str:
        """The only kind in which positions are whole counts; empty if there is none.

        A servo measures whole counts: degrees of 1/4095 turn in ``degrees``, of 1/4096 in ``old``,
        parts of some travel in ``range``.
        """
        joints = []
        for values in self._positions[:5]:
            values = values[(np.abs(values) > 1.0) & (np.abs(np.abs(values) - 100.0) > 1e-3)]
            if len(values) >= _FEWEST:
                joints.append(values)
        if not joints:
            return ""
        for kind, scale in _COUNTS.items():
            if all(_are_counts(values * scale) for values in joints):
                return kind
        return RANGE if all(_is_of_a_travel(values) for values in joints) else ""


def _whole(x: Array) -> NDArray[np.bool_]:
    return np.asarray(np.abs(x - np.round(x)) < _NEAR)


def _are_counts(x: Array) -> bool:
    """Whether numbers are whole; but not all multiples of more than 2, as rounded ones would be."""
    steps = np.diff(np.round(x)).astype(int)
    return bool(_whole(x).mean() > 0.98 and np.gcd.reduce(steps) <= 2)


def _is_of_a_travel(x: Array) -> bool:
    """Whether numbers of -100 to 100 are whole counts of one travel, and not of any."""
    if np.abs(x).max() > 100.0:
        return False
    share = _whole((x[:, None] + 100.0) / 200.0 * _TRAVELS).mean(axis=0)
    travels = _TRAVELS[share > 0.98]
    return len(travels) > 0 and bool((travels % travels[0] == 0).all())
