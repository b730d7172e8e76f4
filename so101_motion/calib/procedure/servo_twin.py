"""Replay the recorded goals of one joint on an emulated servo.

The record has the goals that the real servo was sent, and when. The emulated servo gets the same
goals and bears the weight that the joint had at each recorded angle; its positions are the result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.drivers.bus.ticks import TICKS_PER_RAD
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.joint_figures import SO101
from so101_motion.drivers.emulator.motion import SLOWEST, Profile
from so101_motion.drivers.emulator.servo import Servo
from so101_motion.drivers.servo_types import ServoFigures, ServoType


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
