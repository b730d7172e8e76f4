"""The emulated servo on the recordings' pendulum, driven through its registers.

It computes the same as ``servo_model``, but with the emulator itself: ticks, whole duties, control
periods, protections.
"""

from __future__ import annotations

import math
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from benchmarks.servo_model import GRAVITY, RAD_PER_TICK, Array, Parameters, Recordings
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.electric import Supply
from so101_motion.drivers.emulator.joint_figures import Joint
from so101_motion.drivers.emulator.servo import Servo
from so101_motion.drivers.emulator.world import World
from so101_motion.drivers.servo_types import STS3215_12V, ServoType

_CENTRE = 2048


def emulate(recordings: Recordings, kind: ServoType = STS3215_12V) -> Array:
    """Positions at the recordings' sample times as an emulated servo reports them [rad].

    Shape (n, k). The recordings are shared out among the cores.
    """
    rows = [recordings[i : i + 1] for i in range(len(recordings))]
    with ProcessPoolExecutor() as pool:
        found = pool.map(_emulate_one, rows, [kind] * len(rows), chunksize=8)
        return np.concatenate(list(found))


def _emulate_one(recording: Recordings, kind: ServoType) -> Array:
    t, goal, torque_on = recording.t[0], recording.goal[0], recording.torque_on[0]
    world = _pendulum(recording, kind)
    servo = world.servos[0]
    for row, value in (
        (reg.P_GAIN, int(recording.kp[0])), (reg.D_GAIN, 0), (reg.MIN_POSITION, 0),
        (reg.MAX_POSITION, 0),
    ):  # fmt: skip
        _write(servo, row, value)
    found = np.empty((1, len(t)))
    driven = False
    for k, now in enumerate(t):
        world.advance(round(float(now), 3))
        shown = servo.read(reg.PRESENT_POSITION.address, 2)
        found[0, k] = (int.from_bytes(shown or b"", "little") - _CENTRE) * RAD_PER_TICK
        if torque_on[k] != driven:
            driven = bool(torque_on[k])
            _write(servo, reg.TORQUE_ENABLE, int(driven))
        if driven:
            _write(servo, reg.GOAL_POSITION, _CENTRE + round(goal[k] / RAD_PER_TICK))
    return found


def _pendulum(recording: Recordings, kind: ServoType) -> World:
    mass, length = float(recording.mass[0]), float(recording.length[0])
    parameters = Parameters()
    arm = parameters.arm_mass_short if length < 0.125 else parameters.arm_mass_long
    joint = Joint(
        name="pendulum",
        lower=-math.pi,
        upper=math.pi,
        inertia=(mass + arm / 3.0) * length**2,
    )
    servo = Servo(joint, kind, q=float(recording.position[0, 0]))
    weight = GRAVITY * (mass + arm / 2.0) * length

    def gravity(q: Array) -> Array:
        holding: Array = weight * np.sin(q)
        return holding

    return World([servo], gravity=gravity, supply=Supply(float(recording.volts[0]), 0.0))


def _write(servo: Servo, row: reg.Register, value: int) -> None:
    servo.write(bytes((row.address,)) + row.encode(value).to_bytes(row.size, "little"))
