"""Set up a servo: write those registers that differ from the values the driver needs.

EEPROM: settings with which it would not move well (``servo_settings.py``) are set right, and it
gets its homing offset and limits where a calibration is given, all until power-off: nothing is
stored. A servo with a setting that forbids to move it is refused. RAM: the speed and acceleration
caps and the torque limit. A servo that restarts comes up limp, with no cap at all, so this runs
again whenever one was silent.

A servo that is driven stays driven, and its joint stays where it is:

* A goal outside new limits is left as it is, and the caps are set to a crawl before the limits are
  written, in case the firmware then moves. See ``out_of_range.py``.
* A servo whose gains or mode are set right gets a goal with which it pulls as hard as before; it is
  limp for some milliseconds.
* A servo that cannot reach its goal for lack of torque (a program died that had lowered the limit)
  would jump there once the limit is raised. Its goal is first moved to where it pulls as before.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from operator import eq
from typing import TypeVar

from so101_motion.common.errors import CorruptReply, ServoFault
from so101_motion.common.units import to_rad
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.registers import TICKS_PER_TURN, Memory, Register
from so101_motion.drivers.bus.ticks import JointMap, Ticks, to_speed_ticks
from so101_motion.drivers.feetech.servo_settings import odd_settings, read_registers
from so101_motion.drivers.position_check import ENOUGH
from so101_motion.drivers.servo_types import ServoType, type_of

T = TypeVar("T")

CRAWL_SPEED = to_rad(8.0)
"""Speed at which a joint outside its limits comes in [rad/s]. Chosen: slow enough to see it and to
take a hand away; the servo itself turns no slower than 4 to 9 deg/s."""

CRAWL: Mapping[Register, int] = {
    reg.ACCELERATION: 1,
    reg.GOAL_VELOCITY: to_speed_ticks(CRAWL_SPEED),
}
"""The caps of such a joint."""

OUTSIDE_TICKS = 4
"""A joint so little beyond its limits counts as inside [tick]: 0.35 deg, half the play of the
gears. Chosen."""

NEAR_TICKS = 16
"""Two positions read one after the other agree if they are no farther apart [tick]: 1.4 deg, the
travel of the fastest joint in 2 ms. Chosen."""

_NEAR_LOAD = 100
"""Two readings of the load agree if they are no farther apart [0.1 % drive]. Chosen."""

_NEAR_VOLTS = 3  # the same of the supply [0.1 V]

_READINGS = 12  # after so many that do not agree it is given up

_START = reg.TORQUE_ENABLE.address
_COUNT = reg.TORQUE_LIMIT.address + reg.TORQUE_LIMIT.size - _START


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoCondition:
    """How a servo was found, under its present homing offset."""

    torque: bool  # whether it drives its joint
    # the goal of its position loop. None if the goal register is so far off that the servo would
    # pull as hard as it can
    goal_ticks: Ticks | None
    present_ticks: Ticks
    p_gain: int
    volts: float  # its supply [V]
    kind: ServoType  # its type, by its supply
    max_acceleration: int  # cap of its acceleration, in units of register 41
    torque_limit: int  # its torque limit now, in thousandths of full drive
    # whether its caps have been set to a crawl, because its goal is outside its limits
    crawls: bool


def prepare(bus: Bus, joint: JointMap, ram: Mapping[Register, int]) -> ServoCondition:
    """Set up a servo; its torque stays on or off, and a driven joint stays where it is.

    ``ram`` has the values of RAM registers. If the torque limit is not among them, it becomes the
    value that the servo starts with. Raises ``ServoFault`` if its settings forbid to move it.
    """
    servo_id = joint.servo_id
    shift = 0
    if joint.homing_offset is not None:
        shift = agreed(lambda: bus.read(servo_id, reg.HOMING_OFFSET)) - joint.homing_offset
    raw = agreed(
        lambda: bus.read(servo_id, reg.PRESENT_VOLTAGE), lambda a, b: abs(a - b) <= _NEAR_VOLTS
    )
    volts = reg.PRESENT_VOLTAGE.scale * raw
    kind = type_of(volts)
    changed = _adapt(bus, joint, kind)
    full = agreed(lambda: bus.read(servo_id, reg.MAX_TORQUE))
    p_gain = agreed(lambda: bus.read(servo_id, reg.P_GAIN))
    block = agreed(lambda: bus.read_block(servo_id, _START, _COUNT, what="a read of its settings"))
    torque, limit = reg.TORQUE_ENABLE.cut(block, _START) == 1, reg.TORQUE_LIMIT.cut(block, _START)
    goal = _pull(bus, servo_id, block, p_gain=p_gain, may_do_more=limit < full)
    if torque and goal is not None and limit < full:
        bus.write(servo_id, reg.GOAL_POSITION, goal)
    here = read_position(bus, servo_id) if goal is None else goal
    here = (here + shift) % TICKS_PER_TURN if shift else here
    crawls = torque and is_outside(joint, Ticks(here))
    changed += _fill(bus, servo_id, CRAWL, anew=changed) if crawls else ()
    if torque and shift:
        bus.write(servo_id, reg.TORQUE_ENABLE, 0)
    changed += bus.overlay(servo_id, _calibration(joint))
    if torque and shift:
        if not crawls:
            bus.write(servo_id, reg.GOAL_POSITION, here)
        bus.write(servo_id, reg.TORQUE_ENABLE, 1)  # without a goal it holds what it finds
    ram = {reg.TORQUE_LIMIT: full, **ram, **(CRAWL if crawls else {})}
    _fill(bus, servo_id, ram, anew=changed)
    return ServoCondition(
        torque=torque,
        goal_ticks=None if goal is None else Ticks(here),
        present_ticks=Ticks(read_position(bus, servo_id)),
        p_gain=p_gain,
        volts=volts,
        kind=kind,
        max_acceleration=agreed(lambda: bus.read(servo_id, reg.MAX_ACCELERATION)),
        torque_limit=ram[reg.TORQUE_LIMIT],
        crawls=crawls,
    )


def read_position(bus: Bus, servo_id: int) -> int:
    """The position of a servo [tick], on which four answers in a row agree."""

    def near(one: int, other: int) -> bool:
        away = (one - other) % TICKS_PER_TURN
        return min(away, TICKS_PER_TURN - away) <= NEAR_TICKS

    return agreed(lambda: bus.read(servo_id, reg.PRESENT_POSITION), near, ENOUGH)


def agreed(read: Callable[[], T], alike: Callable[[T, T], bool] = eq, times: int = 2) -> T:
    """Call ``read`` until ``times`` results in a row are alike, else raise ``CorruptReply``."""
    seen = [read()]
    in_a_row = 1
    while in_a_row < times:
        if len(seen) > _READINGS:
            raise CorruptReply(
                f"the answers of a servo do not agree: {', '.join(map(str, seen))}; keep its joint"
                " still and check the plugs of its cable",
                raw=b"",
            )
        seen.append(read())
        in_a_row = in_a_row + 1 if alike(*seen[-2:]) else 1
    return seen[-1]


def engage(bus: Bus, servo_id: int, goal: int) -> None:
    """Drive a joint to ``goal`` [tick]."""
    bus.write(servo_id, reg.GOAL_POSITION, goal)
    bus.write(servo_id, reg.TORQUE_ENABLE, 1)


def is_outside(joint: JointMap, ticks: Ticks) -> bool:
    """Whether a position is so far outside the joint's limits that no goal can keep it there."""
    where = joint.unrolled(ticks)
    return not joint.lower_ticks - OUTSIDE_TICKS <= where <= joint.upper_ticks + OUTSIDE_TICKS


def _pull(bus: Bus, servo_id: int, block: bytes, *, p_gain: int, may_do_more: bool) -> int | None:
    """The goal with which a servo pulls as hard as it does now [tick]; None if not known."""
    goal, limit = reg.GOAL_POSITION.cut(block, _START), reg.TORQUE_LIMIT.cut(block, _START)
    present = read_position(bus, servo_id)
    most = 4 * limit // max(p_gain, 1)  # its drive is p_gain / 4 thousandths a tick
    if abs(goal - present) <= most:
        return goal
    if may_do_more:
        return present + (most if goal > present else -most)
    return None  # no arm's weight needs full drive: the joint is held fast, or the goal is old


def _adapt(bus: Bus, joint: JointMap, kind: ServoType) -> tuple[str, ...]:
    """Set the settings right that are wrong, until power-off; return their names."""
    servo_id = joint.servo_id
    eeprom = [row.name for row in reg.REGISTERS.values() if row.memory is Memory.EEPROM]

    def settings() -> dict[str, int]:
        held = read_registers(bus, servo_id)
        return {name: held[name] for name in eeprom}

    held = agreed(settings)
    volts = {reg.PRESENT_VOLTAGE.name: round(kind.volts / reg.PRESENT_VOLTAGE.scale)}
    odd = odd_settings(held | volts, counts_down=joint.direction < 0)
    if odd and odd[0].forbids:
        raise ServoFault(
            f"{bus.label(servo_id)}: {odd[0].sentence}, so it must not be moved; {odd[0].fix}",
            servo_id=servo_id,
        )
    wanted = {row: value for one in odd if one.is_adapted for row, value in one.as_new.items()}
    changed: tuple[str, ...] = ()
    if (level := wanted.pop(reg.STATUS_LEVEL, None)) is not None:
        changed = bus.overlay(servo_id, {reg.STATUS_LEVEL: level})  # then it answers what follows
    if not wanted or bus.read(servo_id, reg.TORQUE_ENABLE) != 1:
        return changed + bus.overlay(servo_id, wanted)
    # It would jump to a goal that it was too soft to reach, or fall, because a change of mode makes
    # it limp. So it gets a new goal, with which it pulls as hard as before.
    load = agreed(
        lambda: bus.read(servo_id, reg.PRESENT_LOAD), lambda a, b: abs(a - b) <= _NEAR_LOAD
    )
    bus.write(servo_id, reg.TORQUE_ENABLE, 0)
    changed += bus.overlay(servo_id, wanted)
    read_position(bus, servo_id)  # perhaps still as before the change; see ``emulator/servo.py``
    here, p_gain = read_position(bus, servo_id), wanted.get(reg.P_GAIN, held["p_gain"])
    rows = (reg.MIN_POSITION, reg.MAX_POSITION)
    lower, upper = (wanted.get(row, held[row.name]) for row in rows)
    if not lower <= here <= upper:  # the servo would drive it in as fast as it can
        _fill(bus, servo_id, CRAWL, anew=())
    engage(bus, servo_id, here - round(4 * load / p_gain))
    return changed


def _fill(
    bus: Bus, servo_id: int, ram: Mapping[Register, int], *, anew: Collection[str]
) -> tuple[str, ...]:
    """Write the RAM registers that differ; return their names.

    After any of the registers ``anew`` was changed all are written, because the servo takes them up
    when they are written.
    """
    block = bus.read_block(servo_id, _START, _COUNT, what="a read of its settings")
    differing = {
        row: value for row, value in ram.items() if anew or row.cut(block, _START) != value
    }
    for register, value in differing.items():
        bus.write(servo_id, register, value)
    return tuple(register.name for register in differing)


def _calibration(joint: JointMap) -> dict[Register, int]:
    if joint.homing_offset is None:
        return {}
    return {
        reg.HOMING_OFFSET: joint.homing_offset,
        reg.MIN_POSITION: joint.lower_ticks,
        reg.MAX_POSITION: joint.upper_ticks,
    }
