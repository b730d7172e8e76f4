"""The emulated arm, given the goals of a recorded one: what would its servos have reported?

A recording is a dictionary of arrays: ``t_cmd_s`` (n,) and ``command`` (n, 6), when which goals
were sent; ``t_s`` (m,) and ``position`` (m, 6), when and what was measured. Five joints in radians
from the middle of their calibrated travel, the jaw from 0 (closed) to 1 (open); times in seconds.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from itertools import repeat
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.errors import ConfigError
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.electric import Supply
from so101_motion.drivers.emulator.joint_figures import SO101, TICKS_PER_RAD
from so101_motion.drivers.emulator.servo import Servo
from so101_motion.drivers.emulator.world import World
from so101_motion.drivers.servo_types import STS3215_7V4, STS3215_12V, ServoType, type_of
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.datasets.check import angles, meaning
from so101_motion.tasks.datasets.data_set import open_data_set
from so101_motion.tasks.datasets.units import units_of

Array = NDArray[np.float64]
Recording = Mapping[str, Array]


_REPORTED = ("p_gain", "d_gain", "acceleration", "goal_velocity", "max_acceleration")
_SETTLE = 1.0
"""How long the first goal is held before the recording begins [s]; chosen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Arm:
    """What the emulated arm is like.

    Attributes:
        kind: The type of its servos.
        registers: What registers of every servo hold, by name.
        read_age: How old each servo's position is at its time stamp, shape (6,), [s]. Chosen: the
            servos were read one after the other, a millisecond each; with 3 ms each, every joint
            would begin a step later than recorded.
    """

    kind: ServoType
    registers: Mapping[str, int] = field(default_factory=lambda: {"p_gain": 16, "d_gain": 32})
    read_age: tuple[float, ...] = (0.006, 0.005, 0.004, 0.003, 0.002, 0.001)


ARMS = {"7.4": Arm(kind=STS3215_7V4), "12": Arm(kind=STS3215_12V)}
"""By the supply that its servos are made for [V]."""


def arm_of(file: Path) -> Arm | None:
    """What the arm that made a file of ``so101 report-arm`` is like; None for other files."""
    if file.suffix != ".json":
        return None
    held = json.loads(file.read_text())["servos"]["shoulder_pan"]
    kind = type_of(held["max_voltage"] / 10.0)
    return Arm(kind=kind, registers={name: held[name] for name in _REPORTED}, read_age=(0.0,) * 6)


def load(file: Path) -> dict[str, dict[str, Array]]:
    """The recordings in a file of ``so101 report-arm``, or in an npz whose keys are MOTION/NAME."""
    found: dict[str, dict[str, Array]] = {}
    if file.suffix == ".json":
        motions = json.loads(file.read_text())["motions"]
        return {
            name: {key: np.asarray(rows, dtype=np.float64) for key, rows in arrays.items()}
            for name, arrays in motions.items()
        }
    with np.load(file) as archive:
        for key in archive:
            motion, name = key.rsplit("/", 1)
            found.setdefault(motion, {})[name] = np.asarray(archive[key], dtype=np.float64)
    return found


def load_lerobot(root: Path) -> dict[str, dict[str, Array]]:
    """The episodes of a LeRobot data set: actions as goals, states as positions."""
    data_set = open_data_set(root)
    calibration = data_set.calibration
    verdict, _, _ = meaning(data_set, "", calibration)
    units, found = units_of(verdict.kind, calibration), {}
    for episode in data_set.episodes():
        action, state = angles(data_set, units, episode)
        if state is None:
            raise ConfigError("lerobot", str(root), "has no observation.state to compare with")
        for q in (action, state):
            q[:, 5] = (q[:, 5] - SO101[5].lower) / (SO101[5].upper - SO101[5].lower)
        known = np.isfinite(action).all(axis=1) & np.isfinite(state).all(axis=1)
        t = episode.t[known]
        found[f"episode {episode.index}"] = {
            "t_cmd_s": t, "command": action[known], "t_s": t, "position": state[known],
        }  # fmt: skip
    return found


def emulate(recordings: Sequence[Recording], arm: Arm) -> list[Array]:
    """What the emulated servos report at the recordings' times, each (m, 6) as ``position``."""
    with ProcessPoolExecutor() as pool:
        return list(pool.map(emulate_one, recordings, repeat(arm)))


@cache
def _model() -> RobotModel:
    return RobotModel.load()


def emulate_one(recording: Recording, arm: Arm) -> Array:
    """One recording, whole, from its first measured position at rest."""
    command, times = _in_joint_angles(recording["command"]), recording["t_s"]
    begins = _in_joint_angles(recording["position"][:1])[0]
    servos = [Servo(joint, arm.kind, q=float(q)) for joint, q in zip(SO101, begins, strict=True)]
    world = World(servos, gravity=_model().gravity_torque, supply=Supply(arm.kind.volts))
    for servo in servos:
        for name, value in {**arm.registers, "min_position": 0, "max_position": 0}.items():
            _write(servo, reg.REGISTERS[name.upper()], value)
    origin = float(recording["t_cmd_s"][0])
    begin = min(float(times[0]), origin)
    events: list[tuple[float, int, int]] = [
        *((float(t), 7, k) for k, t in enumerate(recording["t_cmd_s"])),
        *(
            (float(t) - age, joint, k)
            for joint, age in enumerate(arm.read_age)
            for k, t in enumerate(times)
        ),
    ]
    _send(servos, command[0])
    for servo in servos:
        _write(servo, reg.TORQUE_ENABLE, 1)
    found = np.empty((len(times), 6))
    for t, what, k in sorted(events):
        world.advance(max(t - begin, 0.0) + _SETTLE)
        if what == 7:
            _send(servos, command[k])
        else:
            found[k, what] = _read(servos[what])
    return found


def _in_joint_angles(command: Array) -> Array:
    """Commands with the jaw in radians, between the stops of its joint."""
    q = command.copy()
    jaw = SO101[5]
    q[:, 5] = jaw.lower + np.clip(command[:, 5], 0.0, 1.0) * (jaw.upper - jaw.lower)
    return q


def _send(servos: Sequence[Servo], q: Array) -> None:
    for servo, angle in zip(servos, q, strict=True):
        ticks = servo.joint.zero_ticks + servo.joint.direction * float(angle) * TICKS_PER_RAD
        _write(servo, reg.GOAL_POSITION, round(ticks))


def _read(servo: Servo) -> float:
    shown = int.from_bytes(servo.read(reg.PRESENT_POSITION.address, 2) or b"", "little")
    ticks = reg.PRESENT_POSITION.decode(shown)
    return servo.joint.direction * (ticks - servo.joint.zero_ticks) / TICKS_PER_RAD


def _write(servo: Servo, row: reg.Register, value: int) -> None:
    servo.write(bytes((row.address,)) + row.encode(value).to_bytes(row.size, "little"))
