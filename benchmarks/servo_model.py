"""A vectorised model of one STS3215 on a pendulum, and recordings to compare it with.

The servo turns an arm with a point mass at its end. The model is open loop: it sees when which goal
was sent, the P gain, whether torque was on, mass, length and supply voltage, and starts at rest at
the first measured position. Many recordings and many parameter sets are simulated at once, so that
one call gives a whole Jacobian.

It is the emulated servo (``so101_motion.drivers.emulator``) without registers and whole ticks, and
its parameters are the emulator's.

The control law is the servo's: a set-point that travels to the goal at limited speed, a
proportional loop, a duty. The motor makes torque in proportion to voltage and loses some to its
back-EMF. Friction has the form of Rhoban/bam's model M5 (load-dependent Coulomb friction with a
Stribeck part): it grows with what the gears carry, from either side.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.state import ARM_JOINTS
from so101_motion.drivers.emulator.joint_figures import MAX_DUTY, SO101, TICKS_PER_RAD
from so101_motion.drivers.emulator.motion import SLOWEST
from so101_motion.drivers.feetech.lag_compensation import braking
from so101_motion.drivers.servo_types import START_DUTY, STS3215_12V
from so101_motion.planning.kinematics.model import RobotModel

Array = NDArray[np.float64]

RAD_PER_TICK = 1.0 / TICKS_PER_RAD
GRAVITY = 9.80665  # [m/s^2]
FIRMWARE_GAIN = 1.0 / (4.0 * 1000.0 * RAD_PER_TICK)
"""Duty per radian of error and unit of the P register: ``P / 4`` thousandths of a duty a tick."""

_SPIKE = -np.pi  # what the recorder wrote when a reading had failed [rad]
_FLOOR = SLOWEST * RAD_PER_TICK  # a set-point travels at least this fast [rad/s]
_RING = 16  # control periods that a delayed duty is remembered for


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameters:
    """One servo and its pendulum. Every field is a number, or an array of shape (B,) for B sets.

    Attributes:
        torque_per_volt: Of the blocked motor, at the output [N m/V].
        back_emf: Voltage that its speed induces, at the output [V s/rad].
        armature: Inertia of rotor and gears, at the output [kg m^2].
        viscous: Damping of the gears [N m s/rad].
        coulomb: Dry friction without load [N m].
        load_external: Friction per torque of the world on the output [1].
        load_motor: Friction per torque of the motor [1].
        still_external: What is added to ``load_external`` at rest [1].
        still_motor: What is added to ``load_motor`` at rest [1].
        stribeck_speed: Speed at which the additions have fallen to 1/e [rad/s].
        speed_limit: Of the set-point on its way to the goal [rad/s].
        goal_delay: From a goal that was sent to the set-point that follows it [s].
        loop_delay: From a measured position to the duty it causes [s].
        duty_shape: Exponent from demanded duty to motor voltage; below 1, small duties do more.
        arm_mass_short: Of the pendulum's own 0.10 m arm [kg]; not known, so fitted.
        arm_mass_long: Of its 0.15 m arm [kg].
    """

    torque_per_volt: Any = STS3215_12V.torque_per_volt
    back_emf: Any = STS3215_12V.back_emf
    armature: Any = STS3215_12V.armature
    viscous: Any = STS3215_12V.viscous
    coulomb: Any = STS3215_12V.coulomb
    load_external: Any = STS3215_12V.load_external
    load_motor: Any = STS3215_12V.load_motor
    still_external: Any = STS3215_12V.still_external
    still_motor: Any = STS3215_12V.still_motor
    stribeck_speed: Any = STS3215_12V.stribeck_speed
    speed_limit: Any = STS3215_12V.speed_limit
    goal_delay: Any = STS3215_12V.goal_delay
    loop_delay: Any = STS3215_12V.loop_delay
    duty_shape: Any = STS3215_12V.duty_shape
    arm_mass_short: Any = 0.0672
    arm_mass_long: Any = 0.1214

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """The fields, in order."""
        return tuple(field.name for field in fields(cls))

    def values(self) -> dict[str, Any]:
        """The fields by name."""
        return {name: getattr(self, name) for name in self.names()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Recordings:
    """n recordings of k samples.

    Attributes:
        t: Time of each sample, shape (n, k), [s].
        goal: The goal as it was sent, shape (n, k), [rad]; 0 hangs straight down.
        torque_on: Whether the servo drove, shape (n, k).
        position: As measured, shape (n, k), [rad].
        valid: Which samples count, shape (n, k); failed readings, one or two in a row, do not.
        kp: Register P, shape (n,).
        mass: Point mass at the end of the arm, shape (n,), [kg].
        length: Of the arm, shape (n,), [m].
        volts: Supply, mean over the recording, shape (n,), [V].
        kind: The motion's name, shape (n,).
        load: Torque that holds the joint of an arm where it is, shape (n, k), [N m]; NaN on the
            pendulum, whose weight follows from mass, length and position.
        inertia: Of the links of an arm, shape (n,), [kg m^2]; NaN on the pendulum.
        acceleration: Limit of the set-point's, shape (n,), [rad/s^2]; infinite on the pendulum,
            whose set-points show none.
    """

    t: Array
    goal: Array
    torque_on: NDArray[np.bool_]
    position: Array
    valid: NDArray[np.bool_]
    kp: Array
    mass: Array
    length: Array
    volts: Array
    kind: NDArray[np.str_]
    load: Array
    inertia: Array
    acceleration: Array

    def __len__(self) -> int:
        return len(self.kp)

    def __getitem__(self, rows: Any) -> Recordings:
        """Some of them, by a mask, a slice or indices."""
        return Recordings(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def error(self, simulated: Array) -> Array:
        """Mean absolute error of ``simulated``, shape (..., n, k), over all valid samples [rad]."""
        off = np.abs(simulated - self.position)
        error: Array = np.where(self.valid, off, 0.0).sum(axis=(-2, -1)) / self.valid.sum()
        return error


def load(path: Path) -> Recordings:
    """Recordings from an ``.npz`` file, or all in a folder; or from a file of ``so101 report-arm``.

    An ``.npz`` has the arrays ``t_s``, ``goal_rad``, ``position_tick`` (4096 a turn), ``volts`` and
    ``torque_enable``, each of shape (n, k), and ``kp``, ``mass_kg``, ``length_m`` and
    ``trajectory``, each of shape (n,). A report has one recording a joint; the weight is the robot
    model's.

    Raises:
        FileNotFoundError: There is no such file, or no ``.npz`` file in the folder.
        KeyError: An array is missing.
    """
    files = sorted(path.glob("*.npz")) if path.is_dir() else [path]
    if not files:
        raise FileNotFoundError(f"no .npz file in {path}")
    parts = _of_report(path) if path.suffix == ".json" else [_read(file) for file in files]
    longest = max(part.t.shape[1] for part in parts)
    parts = [_padded(part, longest - part.t.shape[1]) for part in parts]
    return Recordings(
        **{
            f.name: np.concatenate([getattr(part, f.name) for part in parts])
            for f in fields(parts[0])
        }
    )


def _padded(part: Recordings, more: int) -> Recordings:
    """``part`` with ``more`` samples at its end that do not count."""

    def kept(values: Any) -> Any:
        return np.pad(values, ((0, 0), (0, more)), mode="edge")

    after = np.arange(1, more + 1) * np.mean(np.diff(part.t, axis=1), axis=1, keepdims=True)
    two = {f.name: getattr(part, f.name) for f in fields(part) if getattr(part, f.name).ndim == 2}
    padded = {name: kept(values) for name, values in two.items()}
    padded["t"] = np.concatenate([part.t, part.t[:, -1:] + after], axis=1)
    padded["valid"][:, part.t.shape[1] :] = False
    return replace(part, **padded)


def _read(file: Path) -> Recordings:
    with np.load(file, allow_pickle=False) as data:
        position = data["position_tick"].astype(float) * RAD_PER_TICK
        n = len(position)
        around = np.pad(position, ((0, 0), (1, 1)), mode="edge")
        jumps = np.maximum(np.abs(position - around[:, :-2]), np.abs(position - around[:, 2:]))
        spikes = (np.abs(position - _SPIKE) < 0.01) & (jumps > 0.5)
        return Recordings(
            t=data["t_s"].astype(float),
            goal=data["goal_rad"].astype(float),
            torque_on=data["torque_enable"].astype(bool),
            position=position,
            valid=~spikes,
            kp=data["kp"].astype(float),
            mass=data["mass_kg"].astype(float),
            length=data["length_m"].astype(float),
            volts=data["volts"].astype(float).mean(axis=1),
            kind=data["trajectory"].astype(str),
            load=np.full(position.shape, np.nan),
            inertia=np.full(n, np.nan),
            acceleration=np.full(n, np.inf),
        )


def _of_report(file: Path) -> list[Recordings]:
    report, model, parts = json.loads(file.read_text()), RobotModel.load(), []
    for joint, motion in report["motions"].items():
        i, registers = ARM_JOINTS.index(joint), report["servos"][joint]
        t, q, command = (np.array(motion[key]) for key in ("t_s", "position", "command"))
        newest = np.searchsorted(motion["t_cmd_s"], t, side="right") - 1
        parts.append(
            Recordings(
                t=(t - t[0])[None],
                goal=command[np.maximum(newest, 0), i][None],
                torque_on=np.ones((1, len(t)), dtype=bool),
                position=q[:, i][None],
                valid=np.ones((1, len(t)), dtype=bool),
                kp=np.array([float(registers["p_gain"])]),
                mass=np.zeros(1),
                length=np.zeros(1),
                volts=np.array([np.mean(motion["volts"])]),
                kind=np.array([f"sweep of {joint}"]),
                load=model.holding_torques(q[:, :5])[:, i][None],
                inertia=np.array([SO101[i].inertia]),
                acceleration=np.array([braking(i, registers["max_acceleration"])]),
            )
        )
    return parts


def simulate(recordings: Recordings, parameters: Parameters, *, dt: float = 1e-3) -> Array:
    """Positions at the recordings' sample times, shape (B, n, k), [rad].

    Args:
        recordings: What was done; of the measured positions only the first of each is looked at.
        parameters: B sets.
        dt: Integration step [s].
    """
    sets = {name: np.atleast_1d(np.asarray(v, float)) for name, v in parameters.values().items()}
    count = max(len(v) for v in sets.values())
    p = Parameters(**{k: np.broadcast_to(v, (count,))[:, None] for k, v in sets.items()})
    n, k = recordings.t.shape
    steps = round(float(recordings.t.max()) / dt) + 2
    track = np.empty((steps, count, n), np.float32)
    for step, q in enumerate(_motion(recordings, p, dt, steps)):
        track[step] = q
    place = np.clip(recordings.t / dt, 0, steps - 2)
    below = place.astype(int)
    share = place - below
    rows = np.arange(n)[:, None]
    found = np.empty((count, n, k))
    for i in range(count):
        found[i] = track[below, i, rows] * (1.0 - share) + track[below + 1, i, rows] * share
    return found


def _motion(recordings: Recordings, p: Parameters, dt: float, steps: int) -> Iterator[Array]:
    """The position of every lane, shape (B, n), step by step."""
    count, n = len(p.armature), len(recordings)
    arm = np.where(recordings.length < 0.125, p.arm_mass_short, p.arm_mass_long)
    length, mass = recordings.length, recordings.mass
    weight = GRAVITY * (mass * length + arm * length / 2.0)  # torque with the arm level [N m]
    links = np.where(
        np.isnan(recordings.inertia), (mass + arm / 3.0) * length**2, recordings.inertia
    )
    push = dt / (p.armature + links)
    loads = _Schedule(recordings.t, recordings.load, np.zeros((count, 1)))
    stiffness = FIRMWARE_GAIN * recordings.kp
    goals = _Schedule(recordings.t, recordings.goal, p.goal_delay)
    switch = _Schedule(recordings.t, recordings.torque_on, np.zeros((count, 1)))
    delay = np.minimum(p.loop_delay / dt, _RING - 2.0)
    whole = delay.astype(int)
    part = delay - whole
    ring = np.zeros((_RING, count, n))
    lanes = np.arange(count)[:, None], np.arange(n)[None, :]
    q = np.broadcast_to(recordings.position[:, 0], (count, n)).copy()
    w, setpoint, pace = np.zeros_like(q), q.copy(), np.zeros_like(q)
    limit = recordings.acceleration
    for step in range(steps):
        yield q
        on = switch.at(step * dt)
        goal = goals.at(step * dt)
        pace = np.where(on, _pace(goal - setpoint, pace, p.speed_limit, limit, dt), 0.0)
        setpoint = np.where(on, setpoint + pace * dt, q)
        off = setpoint - q
        demand = stiffness * (off - np.clip(off, -RAD_PER_TICK, RAD_PER_TICK))  # dead zone
        demand += START_DUTY * np.sign(demand)
        shaped = np.sign(demand) * np.abs(demand) ** p.duty_shape
        ring[step % _RING] = np.where(on, np.clip(shaped, -MAX_DUTY, MAX_DUTY), 0.0)
        now = ring[(step - whole) % _RING, *lanes]
        before = ring[(step - whole - 1) % _RING, *lanes]
        blocked = p.torque_per_volt * recordings.volts * ((1.0 - part) * now + part * before)
        brake = np.where(on, p.torque_per_volt * p.back_emf, 0.0)
        load = loads.at(step * dt)
        external = -np.where(np.isnan(load), weight * np.sin(q), load)
        friction = _friction(p, external, blocked - brake * w, np.abs(w))
        damped = 1.0 + push * (brake + p.viscous)
        free = (w + push * (blocked + external)) / damped
        slip = push * friction / damped
        w = np.where(np.abs(free) <= slip, 0.0, free - np.sign(free) * slip)
        q = q + w * dt


def _pace(way: Array, pace: Array, top: Array, limit: Array, dt: float) -> Array:
    """Velocity of the set-point in the coming step: the firmware's profile, ``Profile.step``."""
    straight: Array = np.clip(way / dt, -top, top)
    if np.isinf(limit).all():
        return straight
    side = np.where(way < 0.0, -1.0, 1.0)
    distance, speed, change = np.abs(way), side * pace, limit * dt
    faster = np.clip(speed + change, _FLOOR, top)
    choice = np.maximum(speed - change, _FLOOR)
    for each in (np.maximum(speed, _FLOOR), faster):
        choice = np.where(each * (each / (2.0 * limit) + dt / 2.0) <= distance, each, choice)
    choice = np.where(speed < 0.0, np.minimum(speed + change, 0.0), choice)
    arrives = (choice * dt >= distance) & (choice <= np.maximum(_FLOOR, change))
    limited = side * np.where(arrives, distance / dt, choice)
    return np.where(np.isinf(limit), straight, limited)


def _friction(p: Parameters, external: Array, motor: Array, speed: Array) -> Array:
    """Dry friction [N m]; Rhoban/bam's M5."""
    still = np.exp(-speed / p.stribeck_speed)
    loaded = np.abs(p.load_external * external - p.load_motor * motor)
    resting = np.abs(p.still_external * external - p.still_motor * motor)
    friction: Array = p.coulomb + loaded + still * resting
    return friction


class _Schedule:
    """Values that each recording was sent, looked up with a delay of each parameter set's own."""

    def __init__(self, t: Array, values: NDArray[Any], delay: Array) -> None:
        self._t, self._values, self._delay = t, values, delay
        self._rows = np.arange(len(t))[None, :]
        self._at = np.zeros((len(delay), len(t)), int)
        self._last = t.shape[1] - 1

    def at(self, now: float) -> NDArray[Any]:
        """The values in force at ``now`` [s], shape (B, n)."""
        following = np.minimum(self._at + 1, self._last)
        self._at = np.where(
            self._t[self._rows, following] + self._delay <= now, following, self._at
        )
        found: NDArray[Any] = self._values[self._rows, self._at]
        return found


def varied(parameters: Parameters, steps: Sequence[tuple[str, float]]) -> Parameters:
    """The set itself and, for each name, one with that parameter moved by the step given."""
    values = {name: np.full(len(steps) + 1, v, float) for name, v in parameters.values().items()}
    for row, (name, step) in enumerate(steps, start=1):
        values[name][row] += step
    return replace(parameters, **values)
