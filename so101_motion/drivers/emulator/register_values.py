"""Convert stored registers to the drive's settings, and measurements to registers."""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection
from typing import NamedTuple

from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.drive import Drive, Settings
from so101_motion.drivers.emulator.joint_figures import Joint
from so101_motion.drivers.emulator.memory import Memory
from so101_motion.drivers.emulator.motion import Gains, Profile
from so101_motion.drivers.emulator.protection import CURRENT_UNIT, Limits
from so101_motion.drivers.emulator.registers import TICKS_PER_TURN, Register

SLOWEST = 100.0
"""Slowest profile by unit of register 83 [tick/s]. Measured: unloaded joints never run under
8.8 deg/s (viam-devrel/so-101, one arm); the firmware's arithmetic says 50."""


def settings_from(memory: Memory) -> Settings:
    """The drive's settings from the registers."""
    value = memory.value
    phase = value(reg.PHASE)
    gains = Gains(
        p=value(reg.P_GAIN),
        d=value(reg.D_GAIN),
        i=value(reg.I_GAIN),
        startup=value(reg.STARTUP_FORCE),
        i_limit=4 * value(reg.I_LIMIT),
        cw_dead_zone=value(reg.CW_DEAD_ZONE),
        ccw_dead_zone=value(reg.CCW_DEAD_ZONE),
        window=value(reg.D_WINDOW),
        still=value(reg.MOVING_THRESHOLD),
        limit=value(reg.TORQUE_LIMIT),
    )
    return Settings(
        gains=gains,
        limits=Limits.of(memory),
        mode=value(reg.MODE),
        span=(memory.raw(reg.MIN_POSITION), memory.raw(reg.MAX_POSITION)),
        drive_sign=-1.0 if phase & reg.PHASE_DRIVE_REVERSED else 1.0,
        encoder_reversed=bool(phase & reg.PHASE_ENCODER_REVERSED),
    )


_UNLIMITED = 1e6
"""An acceleration that reaches any speed at once [tick/s^2]."""


def plan_profile(memory: Memory, joint: Joint, profile: Profile, *, top_speed: float) -> None:
    """Set the profile's acceleration, cruising speed and floor from the registers.

    With register 41 at 0 nothing limits the acceleration: recordings of an arm and of a pendulum
    both contradict the ceiling that register 85 would set (``benchmarks.bench_real_arm``). Else the
    firmware's manual says 100 tick/s^2 per unit and caps register 41 at register 85. The measured
    line has another slope, an offset and a ceiling, and those are used here. The ceiling was
    measured with register 85 as delivered; a larger register 85 raises it in proportion, which is
    chosen, not measured.

    Args:
        memory: The registers.
        joint: The servo's joint.
        profile: The profile to set.
        top_speed: The set-point is never faster [tick/s], whatever register 84 says.
    """
    value = memory.value
    top, units = value(reg.MAX_ACCELERATION), value(reg.ACCELERATION)
    if top and units > top:
        units = top
        memory.set(reg.ACCELERATION, top)
    profile.acceleration = _UNLIMITED
    if units:
        profile.acceleration = min(
            joint.acceleration_slope * units + joint.acceleration_offset,
            joint.acceleration_ceiling * max(top / reg.MAX_ACCELERATION.default, 1.0),
        )
    profile.floor = SLOWEST * value(reg.MIN_SPEED)
    cap, speed = _top_speed(memory, top_speed), abs(_goal_speed(memory))
    if speed:
        profile.speed = min(max(speed, profile.floor), cap)
    else:
        profile.speed = cap if value(reg.PHASE) & reg.PHASE_ZERO_IS_MAX else 0.0


def _top_speed(memory: Memory, top_speed: float) -> float:
    return min(50.0 * memory.value(reg.MAX_SPEED), top_speed)


def _goal_speed(memory: Memory) -> float:
    """The speed in register 46 [tick/s]."""
    in_ticks = memory.value(reg.PHASE) & reg.PHASE_SPEED_IN_TICKS
    return float(
        memory.value(reg.GOAL_VELOCITY) * (1 if in_ticks else memory.value(reg.SPEED_UNIT))
    )


GOAL_OF_MODE = {
    reg.POSITION_MODE: reg.GOAL_POSITION,
    reg.SPEED_MODE: reg.GOAL_VELOCITY,
    reg.PWM_MODE: reg.GOAL_TIME,
    reg.STEP_MODE: reg.GOAL_POSITION,
}
"""The register that holds the goal, by mode; writing it starts the servo."""


class Triggers(NamedTuple):
    """What a write triggers in a servo.

    Attributes:
        offset: The homing offset is another.
        mode: The mode is.
        settings: Settings of the drive are.
        torque: Torque is switched.
        profile: Speed or acceleration of the profile are others.
        goal_of_modes: The modes in which it is a goal.
    """

    offset: bool
    mode: bool
    settings: bool
    torque: bool
    profile: bool
    goal_of_modes: frozenset[int]


@functools.cache
def triggers_of(start: int, stop: int) -> Triggers:
    """What a write triggers that reaches the addresses from ``start`` to before ``stop``."""

    def touched(*rows: Register) -> bool:
        return any(row.address < stop and start < row.address + row.size for row in rows)

    return Triggers(
        offset=touched(reg.OFFSET),
        mode=touched(reg.MODE),
        settings=start < reg.TORQUE_ENABLE.address
        or touched(reg.TORQUE_LIMIT, reg.MOVING_THRESHOLD, reg.D_WINDOW),
        torque=touched(reg.TORQUE_ENABLE),
        profile=touched(reg.ACCELERATION, reg.GOAL_VELOCITY) or stop > 80,
        goal_of_modes=frozenset(mode for mode, row in GOAL_OF_MODE.items() if touched(row)),
    )


def goal_of(memory: Memory, *, top_speed: float) -> float:
    """The goal for ``Drive.send``, from the goal register of the present mode.

    Args:
        memory: The registers.
        top_speed: As for ``plan_profile``.
    """
    mode = memory.value(reg.MODE)
    if mode == reg.SPEED_MODE:
        cap = _top_speed(memory, top_speed)
        return max(min(_goal_speed(memory), cap), -cap)
    if mode == reg.PWM_MODE:
        return -float(memory.value(reg.GOAL_TIME))  # as the load; servolab 1.0.0 measured it, too
    if mode == reg.STEP_MODE:
        return float(memory.value(reg.GOAL_POSITION) * memory.value(reg.RESOLUTION))
    return float(_clamped_goal(memory))


def _clamped_goal(memory: Memory) -> int:
    """The goal position [tick], clamped to the servo's limits if it has any."""
    goal = memory.value(reg.GOAL_POSITION) * memory.value(reg.RESOLUTION)
    lower, upper = memory.raw(reg.MIN_POSITION), memory.raw(reg.MAX_POSITION)
    return goal if lower == upper else min(max(goal, lower), upper)


def _in_register(memory: Memory, ticks: int) -> int:
    """A position as its register shows it [tick]."""
    if memory.raw(reg.PHASE) & reg.PHASE_MULTI_TURN:
        return int(ticks / memory.value(reg.RESOLUTION))
    return ticks % TICKS_PER_TURN


def _turns(memory: Memory) -> bool:
    """Whether it is in a mode without positions: speed or PWM."""
    return memory.value(reg.MODE) in (reg.SPEED_MODE, reg.PWM_MODE)


def _unapplied_offset(memory: Memory) -> int:
    """What the homing offset lacks: it does not apply in speed and PWM mode [tick] (FW)."""
    return reg.decode_offset(memory.raw(reg.OFFSET)) if _turns(memory) else 0


_Measurement = Callable[[Memory, Drive, int], float]

OF_FRAME = (reg.PRESENT_POSITION, reg.SETPOINT)
"""The measurements that mode and homing offset shift."""

_MEASUREMENTS: tuple[tuple[Register, _Measurement], ...] = (
    (reg.TORQUE_ENABLE, lambda _memory, drive, _scatter: drive.torque),
    (
        reg.PRESENT_POSITION,
        lambda memory, drive, scatter: _in_register(
            memory, drive.position + scatter + _unapplied_offset(memory)
        ),
    ),
    (reg.PRESENT_VELOCITY, lambda _memory, drive, _scatter: drive.speed),
    # Negative where the drive pushes towards higher ticks: in 97 % of the 243,529 samples of public
    # recordings that show a load, 98 % of those more than 3 deg from the goal (not in this
    # repository, so no test holds this against them). The firmware's error is position less goal.
    (reg.PRESENT_LOAD, lambda _memory, drive, _scatter: -drive.demand),
    (reg.PRESENT_VOLTAGE, lambda _memory, drive, _scatter: drive.volts * 10.0),
    (reg.PRESENT_TEMPERATURE, lambda _memory, drive, _scatter: int(drive.motor.temperature)),
    (reg.STATUS, lambda _memory, drive, _scatter: drive.guard.flags),
    (reg.MOVING, lambda _memory, drive, _scatter: drive.moving),
    (
        reg.SETPOINT,
        lambda memory, drive, _scatter: _in_register(memory, int(drive.profile.position)),
    ),
    (
        reg.PRESENT_CURRENT,
        lambda _memory, drive, _scatter: (
            drive.motor.current * drive.settings.drive_sign / CURRENT_UNIT
        ),
    ),
    (reg.PROFILE_SPEED, lambda _memory, drive, _scatter: drive.profile.velocity),
)


@functools.cache
def _measured_in(start: int, stop: int) -> tuple[tuple[Register, _Measurement], ...]:
    """What is measured for a read of these addresses; torque always, because goals change it."""
    return tuple(
        (row, measure)
        for row, measure in _MEASUREMENTS
        if row is reg.TORQUE_ENABLE or (row.address < stop and start < row.address + row.size)
    )


def show_measurements(
    memory: Memory,
    drive: Drive,
    address: int,
    count: int,
    *,
    scatter: int = 0,
    but: Collection[Register] = (),
) -> None:
    """Write the present measurements to the registers that are about to be read.

    Args:
        memory: The registers.
        drive: What is measured.
        address: The first address that will be read.
        count: How many will be.
        scatter: Noise of the encoder [tick].
        but: Registers that stay as they are.
    """
    for row, measure in _measured_in(address, address + count):
        if row in but or (row is reg.SETPOINT and _turns(memory)):
            continue
        memory.set(row, row.encode(round(measure(memory, drive, scatter))))
