"""Bringing a servo into the state the driver relies on, by changing only what differs.

EEPROM: position mode, positions within one turn, writes acknowledged, and, where a calibration is
given, its homing offset and limits. RAM: the speed and acceleration caps and, where one was asked
for, a torque limit. A servo that restarts forgets its RAM and comes up limp, with no cap at all, so
this runs again whenever one was silent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from so101_motion.drivers import registers as reg
from so101_motion.drivers.bus import Bus
from so101_motion.drivers.registers import Register
from so101_motion.drivers.ticks import JointMap, Ticks

_START = reg.TORQUE_ENABLE.address
_COUNT = reg.TORQUE_LIMIT.address + reg.TORQUE_LIMIT.size - _START


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoCondition:
    """How a servo was found.

    Attributes:
        torque: Whether it drives its joint.
        goal_ticks: Where it was sent last.
        present_ticks: Where it is.
        p_gain: Proportional gain of its position loop.
        changed: Names of the registers that had to be changed.
    """

    torque: bool
    goal_ticks: Ticks
    present_ticks: Ticks
    p_gain: int
    changed: tuple[str, ...]


def prepare(bus: Bus, joint: JointMap, ram: Mapping[Register, int]) -> ServoCondition:
    """Make a servo ready; its torque and its goal stay as they are.

    Args:
        bus: Where it is.
        joint: Which one, and what its calibration is.
        ram: What RAM registers must hold.

    Raises:
        BusError: It cannot be reached or does not take a value.
    """
    servo_id = joint.servo_id
    changed = bus.store(servo_id, _eeprom(bus, joint))
    block = bus.read_block(servo_id, _START, _COUNT, what="its settings")
    for register, value in ram.items():
        if register.cut(block, _START) != value:
            bus.write(servo_id, register, value)
            changed += (register.name,)
    return ServoCondition(
        torque=reg.TORQUE_ENABLE.cut(block, _START) == 1,
        goal_ticks=Ticks(reg.GOAL_POSITION.cut(block, _START)),
        present_ticks=Ticks(bus.read(servo_id, reg.PRESENT_POSITION)),
        p_gain=bus.read(servo_id, reg.P_GAIN),
        changed=changed,
    )


def _eeprom(bus: Bus, joint: JointMap) -> dict[Register, int]:
    phase = bus.read(joint.servo_id, reg.PHASE)
    wanted = {
        reg.STATUS_LEVEL: 1,
        reg.OPERATING_MODE: 0,
        reg.PHASE: phase & ~reg.MULTI_TURN,
    }
    if joint.homing_offset is not None:
        wanted |= {
            reg.HOMING_OFFSET: joint.homing_offset,
            reg.MIN_POSITION: joint.lower_ticks,
            reg.MAX_POSITION: joint.upper_ticks,
        }
    return wanted
