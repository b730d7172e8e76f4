"""Find out how an arm's servos differ from their type, and what the hand carries.

While a joint turns steadily, motor, friction and weight are in balance. The motor's voltage is
known: a position loop without integral makes it from the distance between its set-point and its
joint, and both are on record. The set-point follows from the goals that were sent, as the firmware
makes it travel. So each stretch of steady motion is one equation. Stretches both ways tell
friction from weight, two speeds tell friction from dead time, and different poses tell a weak motor
from a load: a load weighs on other joints in other proportions than the arm itself.

All of it is one least-squares problem with a prior: figures are near their type's, as far as the
motions say nothing else. How sure a figure is comes from the same equations.

Play has no part in steady motion. It is what lets a joint without load stand still when it turns
round, or when its load changes sides, and is found by emulating the joint on its record with one
play after another and looking at those moments alone.

A joint that bears no weight tells friction and torque only as a ratio, as long as it turns
steadily. With an empty hand all figures are therefore changed once more, until an emulated joint
does what the real one did while it sped up and turned round, too: ``TwinFit``.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.geometry import Array
from so101_motion.common.units import to_rad
from so101_motion.drivers.bus.ticks import RAD_PER_TICK, TICKS_PER_RAD
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.joint_figures import MAX_DUTY, SO101
from so101_motion.drivers.emulator.motion import SLOWEST, Profile
from so101_motion.drivers.emulator.servo import Servo
from so101_motion.drivers.feetech.servo_model import ServoModel
from so101_motion.drivers.servo_types import AS_SOLD, START_DUTY, ServoFigures, ServoType
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.torque import place_in_hand


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointRecord:
    """The record of one joint, k samples."""

    index: int  # index of the joint
    kind: ServoType  # the type of its servo
    p_gain: int  # register 21
    acceleration: float  # of the servo's own set-point [rad/s^2]
    zero_ticks: float  # position at angle zero [tick]
    direction: int  # 1 if the servo counts up with the angle, else -1
    t: Array  # times of the readings, shape (k,), [s]
    ticks: Array  # its position, shape (k,), [tick]
    q: Array  # the angles of all arm joints, shape (k, 5), [rad]
    qd_ref: Array  # velocity of its setpoints, shape (k,), [rad/s]
    volts: Array  # supply, shape (k,), [V]
    t_goals: Array  # when goals were sent, shape (m,), [s]
    goals: Array  # the goals, shape (m,), [tick]


def setpoints(record: JointRecord) -> Array:
    """Where the servo's own set-point was in every millisecond of the record [tick]."""
    profile = Profile(float(record.goals[0]))
    profile.acceleration = record.acceleration * TICKS_PER_RAD
    profile.speed = record.kind.speed_limit * TICKS_PER_RAD
    profile.floor = SLOWEST
    due = (record.t_goals + record.kind.goal_delay).tolist()
    begin, end = float(record.t[0]), float(record.t[-1])
    found = np.empty(round((end - begin) * 1000.0) + 1)
    at, early = 0, max(math.ceil((begin - due[0]) * 1000.0), 0)
    for step in range(-early, len(found)):
        now = begin + step / 1000.0
        if step >= 0:
            found[step] = profile.position
        while at < len(due) and due[at] <= now:
            profile.target = float(record.goals[at])
            at += 1
        profile.step()
    return found


def predicted(
    record: JointRecord, figures: ServoFigures, weight: Array, play: float | None = None
) -> Array:
    """Where the joint would be read, shape (k,), [tick]; ``weight`` holds it, shape (k,), [N m]."""
    return np.floor(unrounded(record, figures, weight, play) + 0.5)


def unrounded(
    record: JointRecord, figures: ServoFigures, weight: Array, play: float | None = None
) -> Array:
    """The same before the encoder rounds it to whole ticks; arguments as for ``predicted``."""
    if play is not None:
        figures = replace(figures, play=play)
    joint = replace(
        SO101[record.index],
        lower=-math.pi, upper=math.pi, zero_ticks=round(record.zero_ticks),
        direction=record.direction,
        acceleration_slope=record.acceleration * TICKS_PER_RAD, acceleration_offset=0.0,
        acceleration_ceiling=math.inf,
    )  # fmt: skip
    q = record.direction * (float(record.ticks[0]) - joint.zero_ticks) / TICKS_PER_RAD
    servo = Servo(joint, figures.of(record.kind), q=q)
    servo.memory.keep(reg.P_GAIN, record.p_gain)
    servo.write(bytes((reg.P_GAIN.address, record.p_gain)))
    servo.write(bytes((reg.ACCELERATION.address, 1)))
    drive, found, at = servo.drive, np.empty(len(record.t)), 0
    origin = drive.encoder - drive.position
    between = 0.5 * (weight + np.append(weight[1:], weight[-1]))  # until the next sample
    for k, now in enumerate(record.t.tolist()):
        found[k] = drive.shaft.output - origin
        drive.load, drive.volts = -record.direction * float(between[k]), float(record.volts[k])
        end = float(record.t[k + 1]) if k + 1 < len(record.t) else now
        for step in range(round((end - now) * 1000.0)):
            while at < len(record.goals) and record.t_goals[at] <= now + step / 1000.0 + 1e-9:
                goal = int(record.goals[at]).to_bytes(2, "little")
                servo.write(bytes((reg.GOAL_POSITION.address,)) + goal)
                at += 1
            drive.step()
    return found


def replayed(
    record: JointRecord, figures: ServoFigures, weight: Array, play: float | None = None
) -> JointRecord:
    """The record that the emulated joint makes of the same goals; arguments as ``predicted``."""
    ticks = predicted(record, figures, weight, play)
    q = record.q.copy()
    q[:, record.index] = record.direction * (ticks - record.zero_ticks) / TICKS_PER_RAD
    return replace(record, ticks=ticks, q=q)


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
    """The search for the figures of one servo with which its emulated twin does what its joint did.

    Steady motion says much of a servo, but not all: a joint that bears no weight tells friction and
    torque only as a ratio there, and play has no part in it. Both show where a joint speeds up,
    slows down and turns round: there the motor moves a known inertia besides. So the whole record
    is used here. The twin gets the goals that were sent; torque, friction, delay and play are
    changed, by Gauss-Newton, until the twin's positions differ least from those that were read.

    The search changes the voltages that inertia and friction take, ``1 / torque`` and ``friction /
    torque``, for the twin's position is nearly linear in them: steps do not end beside the truth,
    and a wrong torque is not taken for a wrong friction.

    A twin sticks, slips and counts whole ticks, so the slightest change makes it differ by 0.15
    tick here and there. A tenth more torque of a joint without weight moves it by 0.1. Slopes are
    therefore not taken from neighbours but by regression through eight twins a round, all figures
    changed in each, and through those of earlier rounds nearby. With slopes from pairs of
    neighbours the torque at which a joint breaks away was up to 25 % off, on recordings that give
    13 % now.

    The twin's positions are taken before they are rounded to ticks, and a delay between two whole
    milliseconds is a mix of both.

    A weight that changes sides takes the output through the play at a moment that nobody knows to
    10 ms, so the play that suits the whole record is a little too large. That of a joint with
    weight is therefore a mean of two (``SEEN``): this one, and the one that ``servo_fit.play`` saw
    at such moments alone.

    The inertia is that of the rotor of the servo's type, and a rough one of the links, a third of
    the whole at the pan and a twentieth at the roll. What it is off by, as a share, the torque of a
    joint without weight is off by, too.

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


Gravity = Callable[[Array], Array]
"""Torques that hold configurations of the arm, shapes (k, 5) [rad] and (k, 5) [N m]."""

N = 5

STEADY = 0.2  # for how long the setpoints must have had one speed [s]; chosen: the lag has built up

STRETCH = 0.4
"""How long a stretch of steady motion is taken together [s]; chosen: 40 readings, whose rounding
to ticks averages out, and 6 deg at 15 deg/s, over which the weight hardly changes."""

NOISE = 0.015  # of one stretch [N m]: a quarter of a tick of goal minus position. Chosen

PRIOR_DEVIATIONS = {"torque": 0.15, "friction": 0.3, "delay": 0.008, "mass": 0.3, "moment": 0.02}
"""Standard deviations of the prior: shares, [s], [kg], and of the load's moment about the place
where it is expected [kg m]. Chosen: what is wider than arms are likely to differ."""

KNOWN = 0.08
"""Share of ``PRIOR_DEVIATIONS`` for figures of an earlier identification. Chosen: torque is known
to 1.2 %."""

PLAY_STEP = to_rad(0.2)  # plays that are multiples of it are tried [rad]

MOST_PLAY = 8
"""Largest play that is tried at first, in steps: every second multiple of ``PLAY_STEP`` up to it,
1.6 deg. Then the multiples next to the best one are tried."""

AROUND = (0.2, 0.5)  # for how long before and after such a moment play is looked for [s]; chosen

WEIGHTLESS = 0.01  # a smaller load is on neither side [N m]; chosen

PLAY_SEEN = 0.02
"""The error of the best play must be smaller than that without play by this share of it. Chosen."""

_ROUNDS = 6
_CORRECTIONS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """The load in the hand."""

    mass: float  # its mass [kg]
    com: tuple[float, float, float]  # its centre of mass in the tool frame [m]
    mass_deviation: float  # standard deviation of the mass [kg]


@dataclass(frozen=True, slots=True, kw_only=True)
class Identified:
    """The result of an identification."""

    servos: Mapping[str, ServoFigures]  # the servo's figures, by joint
    # their standard deviations by steady motion alone, by joint; without the play
    deviations: Mapping[str, ServoFigures]
    load: Load | None  # the load in the hand; None if the user said it is empty
    volts: float  # supply, mean over the motions [V]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Row:
    """A stretch of steady motion of joint ``i``."""

    i: int  # index of the joint
    torque: float  # the motor's torque if it is like its type, back-EMF subtracted [N m]
    speed: float  # the joint's speed [rad/s]
    weight: float  # the torque that holds the joint there, without load [N m]
    per_load: Array  # what each of mass and moments adds to ``weight``, shape (4,)
    per_delay: float  # what one more second of delay subtracts from ``torque`` [N m/s]


def load_columns(gravity_of: Callable[[float, Array], Gravity], q: Array) -> Array:
    """What mass and moments of a load add to the torques at ``q`` (k, 5) [rad]; shape (4, k, 5)."""
    none = gravity_of(0.0, np.zeros(3))(q)
    mass = gravity_of(1.0, np.zeros(3))(q) - none
    along = [gravity_of(1.0, axis)(q) - none - mass for axis in np.eye(3)]
    return np.stack([mass, *along])


def identify(
    records: Mapping[str, JointRecord],
    gravity_of: Callable[[float, Array], Gravity],
    *,
    hand: Array | None,
    known: Mapping[str, ServoFigures] | None = None,
) -> Identified:
    """Identify servos, load and play, with the bias of ``fit`` removed.

    Motion is never quite steady: joints stick and slip, and positions are whole ticks, which biases
    the figures. To measure the bias, emulated joints with those figures play the same goals, and
    their records are fitted as well; the difference is subtracted. Arguments as for ``fit``.

    With an empty hand the figures are then changed until emulated joints do what the real ones did.
    """
    first = found = fit(records, gravity_of, hand=hand, known=known)
    plays: dict[str, float | None] = {}
    for _ in range(_CORRECTIONS):
        weights = weights_of(records, gravity_of, found.load)
        for name in records.keys() - plays.keys():
            plays[name] = play(records[name], found.servos[name], weights[name])
        servos = {name: replace(each, play=plays[name]) for name, each in found.servos.items()}
        twins = {
            name: replayed(record, servos[name], weights[name]) for name, record in records.items()
        }
        again = fit(twins, gravity_of, hand=hand, known=known)
        found = _corrected(replace(found, servos=servos), first, again)
    if hand is not None:
        return found
    weights = weights_of(records, gravity_of, None)
    fine = {
        name: TwinFit(records[name], weights[name]).best(
            each, torque_is_open=first.deviations[name].torque > OPEN
        )
        for name, each in found.servos.items()
    }
    return replace(found, servos=fine)


def weights_of(
    records: Mapping[str, JointRecord],
    gravity_of: Callable[[float, Array], Gravity],
    load: Load | None,
) -> dict[str, Array]:
    """The torque that holds each joint at each sample, shape (k,), [N m]."""
    gravity = gravity_of(0.0, np.zeros(3))
    if load is not None and load.mass > 0.0:
        gravity = gravity_of(load.mass, np.array(load.com))
    return {name: gravity(record.q)[:, record.index] for name, record in records.items()}


def _corrected(used: Identified, first: Identified, again: Identified) -> Identified:
    """Remove the bias: the arm gave ``first``, emulated joints with ``used`` gave ``again``."""
    servos = {
        name: replace(
            each,
            torque=each.torque * first.servos[name].torque / again.servos[name].torque,
            friction=max(
                each.friction + first.servos[name].friction - again.servos[name].friction, 0.0
            ),
            dead_time=max(
                each.dead_time + first.servos[name].dead_time - again.servos[name].dead_time, 0.0
            ),
        )
        for name, each in used.servos.items()
    }
    load = used.load
    if load is not None and first.load is not None and again.load is not None:
        mass = load.mass + first.load.mass - again.load.mass
        moment = [
            load.mass * a + first.load.mass * b - again.load.mass * c
            for a, b, c in zip(load.com, first.load.com, again.load.com, strict=True)
        ]
        if mass > 1e-3:
            x, y, z = (each / mass for each in moment)
            load = replace(load, mass=mass, com=(x, y, z))
    return replace(used, servos=servos, load=load)


def fit(
    records: Mapping[str, JointRecord],
    gravity_of: Callable[[float, Array], Gravity],
    *,
    hand: Array | None,
    known: Mapping[str, ServoFigures] | None = None,
) -> Identified:
    """Identify the servos, and the load if there may be one.

    Args:
        records: What each joint did, by name; joints may be missing.
        gravity_of: As for ``load_columns``.
        hand: Where a load is expected in the tool frame [m]; None if the hand is empty.
        known: Servo figures of an earlier time, which are then near the truth.
    """
    names = list(records)
    models = {name: ServoModel(record.kind, record.p_gain) for name, record in records.items()}
    rows = [
        row
        for i, (name, record) in enumerate(records.items())
        for row in _rows(i, record, models[name], gravity_of)
    ]
    n = len(names)
    believed = [(known or {}).get(name, ServoFigures()) for name in names]
    delays = [models[name].kind.goal_delay for name in names]
    prior = np.array(
        [1.0 / each.torque for each in believed]
        + [each.friction for each in believed]
        + [(each.dead_time - 1.0) * delay for each, delay in zip(believed, delays, strict=True)]
        + [0.0] * 4
    )
    near = KNOWN if known else 1.0
    servo_deviations = [
        near * PRIOR_DEVIATIONS[figure] for figure in ("torque", "friction", "delay") for _ in names
    ]
    load_deviations = [PRIOR_DEVIATIONS["mass"]] + [PRIOR_DEVIATIONS["moment"]] * 3
    deviation = np.array(servo_deviations + (load_deviations if hand is not None else [1e-9] * 4))
    place = np.zeros(3) if hand is None else np.asarray(hand, dtype=np.float64)
    x, covariance = _solved(rows, [models[name] for name in names], prior, deviation, place)
    sd = np.sqrt(np.diag(covariance))
    servos = {
        name: ServoFigures(
            torque=float(1.0 / x[i]), friction=float(x[n + i]),
            dead_time=float(max(1.0 + x[2 * n + i] / delays[i], 0.0)),
        )
        for i, name in enumerate(names)
    }  # fmt: skip
    deviations = {
        name: ServoFigures(
            torque=float(sd[i]), friction=float(sd[n + i]),
            dead_time=float(sd[2 * n + i] / delays[i]),
        )
        for i, name in enumerate(names)
    }  # fmt: skip
    return Identified(
        servos=servos,
        deviations=deviations,
        load=None if hand is None else _load(x[3 * n :], place, float(sd[3 * n])),
        volts=float(np.mean([np.mean(record.volts) for record in records.values()])),
    )


def play(record: JointRecord, figures: ServoFigures, weight: Array) -> float | None:
    """The play that explains a motion best [rad], or None; ``weight`` as for ``predicted``."""
    shown = _shows_play(record, weight)
    if not shown.any():
        return None

    @functools.cache
    def error(k: int) -> float:
        found = predicted(record, figures, weight, k * PLAY_STEP)
        return float(np.mean(np.abs(found - record.ticks)[shown]))

    best = min(range(0, MOST_PLAY + 1, 2), key=error)
    if error(best) > (1.0 - PLAY_SEEN) * error(0):
        return None
    best = min((max(best - 1, 0), best, best + 1), key=error)
    if best == 0:
        return 0.0
    # The error grows in proportion to what a play is off.
    less, here, more = error(best - 1), error(best), error(best + 1)
    return PLAY_STEP * (best + 0.5 * (less - more) / max(max(less, more) - here, 1e-9))


def _shows_play(record: JointRecord, weight: Array) -> NDArray[np.bool_]:
    """Which samples are near a moment when the joint turns round or its load changes sides."""
    seen = np.zeros(len(record.t), dtype=np.bool_)
    before, after = AROUND
    load = np.where(np.abs(weight) < WEIGHTLESS, 0.0, weight)
    for sides in (np.sign(record.qd_ref), np.sign(load)):
        at = np.flatnonzero(sides)
        for k in at[1:][sides[at[1:]] != sides[at[:-1]]]:
            seen |= (record.t >= record.t[k] - before) & (record.t <= record.t[k] + after)
    return seen


def _load(found: Array, hand: Array, deviation: float) -> Load:
    mass = float(found[0])
    offset = found[1:] / mass if mass > 1e-3 else np.zeros(3)
    x, y, z = (hand + offset).tolist()
    return Load(mass=mass, com=(x, y, z), mass_deviation=deviation)


def _rows(
    i: int,
    record: JointRecord,
    model: ServoModel,
    gravity_of: Callable[[float, Array], Gravity],
) -> Iterator[_Row]:
    kind = model.kind
    volts = _volts(record, model)
    weight = gravity_of(0.0, np.zeros(3))(record.q)[:, record.index]
    columns = load_columns(gravity_of, record.q)[:, :, record.index]
    for cut in _stretches(record):
        t = record.t[cut]
        turned = np.polyfit(t - t[0], record.q[cut, record.index], 1)[0]
        begin, end = (round(float(each - record.t[0]) * 1000.0) for each in (t[0], t[-1]))
        mean = float(np.mean(volts[begin:end]))
        share = max(abs(mean) / float(np.mean(record.volts[cut])), START_DUTY)
        slope = kind.duty_shape * share ** (1.0 - 1.0 / kind.duty_shape)
        stiffness = slope * float(np.mean(record.volts[cut])) / model.full_drive_error
        yield _Row(
            i=i,
            torque=kind.torque_per_volt * (mean - kind.back_emf * float(turned)),
            speed=float(turned),
            weight=float(np.mean(weight[cut])),
            per_load=columns[:, cut].mean(axis=1),
            per_delay=kind.torque_per_volt * stiffness * float(turned),
        )


def _volts(record: JointRecord, model: ServoModel) -> Array:
    """The voltage that drove the motor in every millisecond, along the joint's angle [V].

    At the readings alone it would not do: they come in step with the goals, and the set-point does
    not move evenly between two of them.
    """
    setpoint = setpoints(record)
    t = record.t[0] + np.arange(len(setpoint)) / 1000.0
    ticks = np.floor(np.interp(t, record.t, record.ticks) + 0.5)
    error = np.floor(setpoint) - ticks
    error = np.sign(error) * np.maximum(np.abs(error) - 1.0, 0.0)  # the dead zone
    demand = np.trunc(error * record.p_gain / 4.0) / 1000.0
    demand += START_DUTY * np.sign(demand)
    duty = np.sign(demand) * np.minimum(np.abs(demand) ** model.kind.duty_shape, MAX_DUTY)
    volts: Array = record.direction * duty * np.interp(t, record.t, record.volts)
    return volts


def _stretches(record: JointRecord) -> Iterator[slice]:
    """Where the setpoints have one speed, in pieces."""
    speed, t = record.qd_ref, record.t
    begin: int | None = None
    for k in range(1, len(t) + 1):
        goes_on = k < len(t) and abs(speed[k]) > 0.05 and abs(speed[k] - speed[k - 1]) < 1e-3
        if goes_on and begin is None:
            begin = k
        if begin is None:
            continue
        first = begin + int(np.searchsorted(t[begin:k] - t[begin], STEADY))
        if goes_on and t[k] - t[first if first < k else k - 1] < STRETCH:
            continue
        if first < k and t[k - 1] - t[first] > 0.5 * STRETCH:
            yield slice(first, k)
        begin = None if not goes_on else max(k - int(STEADY / max(t[k] - t[k - 1], 1e-3)), begin)


def _solved(
    rows: list[_Row], models: list[ServoModel], prior: Array, deviation: Array, hand: Array
) -> tuple[Array, Array]:
    """The most likely parameters and their covariance, by Gauss-Newton."""
    n, x = len(models), prior.copy()
    scale = 1.0 / deviation
    for _ in range(_ROUNDS):
        off, slopes = _residuals(rows, models, x, n, hand)
        for k in np.flatnonzero(deviation > 1e-8):
            moved = x.copy()
            step = 1e-4 * deviation[k]
            moved[k] += step
            slopes[:, k] = (_residuals(rows, models, moved, n, hand)[0] - off) / step
        normal = slopes.T @ slopes / NOISE**2 + np.diag(scale**2)
        gradient = slopes.T @ off / NOISE**2 + scale**2 * (x - prior)
        x = x - np.linalg.solve(normal, gradient)
    return x, np.asarray(np.linalg.inv(normal))


def _residuals(
    rows: list[_Row], models: list[ServoModel], x: Array, n: int, hand: Array
) -> tuple[Array, Array]:
    mass, moments = x[3 * n], x[3 * n + 1 :]
    load = np.concatenate([[mass], mass * hand + moments])
    off = np.empty(len(rows))
    for k, row in enumerate(rows):
        kind, way = models[row.i].kind, float(np.sign(row.speed))
        weight = row.weight + float(row.per_load @ load)
        dry = models[row.i].friction(weight, way, row.speed)
        friction = x[n + row.i] * (way * dry + kind.viscous * row.speed)
        off[k] = x[row.i] * (weight + friction) + row.per_delay * x[2 * n + row.i] - row.torque
    return off, np.zeros((len(rows), len(x)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """How far an emulated joint was from the real one, mean of its whole motion [rad]."""

    as_sold: float  # with the figures of the servo's type
    as_known: float  # with the saved figures, or those just found


def figures(
    records: Mapping[str, JointRecord],
    *,
    hand_is_empty: bool,
    known: Mapping[str, ServoFigures],
    judges_found: bool,
) -> tuple[Identified, dict[str, Prediction]]:
    """Identify the servos from records, and test how well the figures predict the joints' motion.

    It takes half a minute of a processor, so it runs in a process of its own, which starts soon
    because this file imports neither arm nor port.

    Args:
        records: The record of each joint, by name; a load's mass needs those of all joints.
        hand_is_empty: Whether the hand is known to be empty.
        known: Earlier figures, from an empty hand; with a load in the hand they stay nearly fixed,
            and only the load is identified freely.
        judges_found: Whether the predictions use the new figures; else the known ones.
    """
    found = identify(
        records,
        gravity_of,
        hand=None if hand_is_empty else place_in_hand(RobotModel.load()),
        known=None if hand_is_empty else known,  # with an empty hand the servos are identified anew
    )
    weights = weights_of(records, gravity_of, found.load)
    servos = found.servos if judges_found else known

    def off(joint: str, figures: ServoFigures) -> float:
        record = records[joint]
        ticks = predicted(record, figures, weights[joint])
        return float(np.mean(np.abs(ticks - record.ticks))) * RAD_PER_TICK

    return found, {
        joint: Prediction(
            as_sold=off(joint, AS_SOLD), as_known=off(joint, servos.get(joint, AS_SOLD))
        )
        for joint in records
    }


def gravity_of(mass: float, place: Array) -> Gravity:
    """The holding torques of the arm with ``mass`` [kg] at ``place`` in the tool frame [m]."""
    model = RobotModel.load()
    return (model.with_payload(mass, place) if mass else model).holding_torques
