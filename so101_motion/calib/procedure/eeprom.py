"""What a calibration reads from servos and writes to them; all of it runs on the port's thread.

Homing offset and limits are three registers that cannot change at once, so the order matters.
While the offset changes the limits are open, 0 to 4095; then both limits change in a single write.
If that is cut short, the servo holds the old values, or looks like a new one, or holds the new
values; it never has limits that belong to another offset.

Torque is off while the offset changes, because the servo's goal would then mean another angle.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from so101_motion.calib.procedure.travel import around, representable
from so101_motion.calib.record import store
from so101_motion.calib.record.record import SERVO_IDS, HeldCalibration, JointCalibration
from so101_motion.calib.record.store import Stored
from so101_motion.common.errors import CalibrationError
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import RETRIES, Bus
from so101_motion.drivers.bus.registers import TICKS_PER_TURN, Memory, Register
from so101_motion.drivers.feetech.presence import missing_servos

_MAX = TICKS_PER_TURN - 1

_STILL = 171
"""How far a joint may move between being read and the check of its new offset [tick]; 15 deg,
chosen: a hand trembles, and a servo that interprets offsets differently is off by more."""

# Both limits, which lie side by side; 0 and 0, which makes a servo turn without end, is left legal.
_LIMITS = Register(
    "position limits", reg.MIN_POSITION.address, 4, Memory.EEPROM, 0, _MAX << 16 | _MAX,
    "two words", 1, "FT",
)  # fmt: skip


def read_held(bus: Bus, servo_id: int) -> HeldCalibration:
    limits = bus.read(servo_id, _LIMITS)
    return HeldCalibration(
        homing_offset=bus.read(servo_id, reg.HOMING_OFFSET),
        range_min=limits & 0xFFFF,
        range_max=limits >> 16,
    )


def restorable(held: HeldCalibration) -> HeldCalibration:
    """The nearest values that can be written back to a servo.

    Firmware 3.10 can hold offsets beyond 2047; the equivalent offset a turn away replaces those.
    Limits that make no sense become those of a new servo.
    """
    offset = representable(held.homing_offset)
    if max(held.range_min, held.range_max) > _MAX:
        return HeldCalibration(homing_offset=offset)
    return replace(held, homing_offset=offset)


def write_held(bus: Bus, servo_id: int, wanted: HeldCalibration) -> None:
    """Store ``wanted`` in a servo for good and read it back.

    All is written, also what the servo holds already: that may be forgotten at power-off. A joint
    that is driven is held where it is, unless that is outside the new limits: then it goes limp.
    """
    held = read_held(bus, servo_id)
    shift = held.homing_offset - wanted.homing_offset
    is_driven = bus.read(servo_id, reg.TORQUE_ENABLE) == 1
    goal = (bus.read(servo_id, reg.GOAL_POSITION) + shift) % TICKS_PER_TURN
    can_stay = wanted.range_min <= goal <= wanted.range_max
    if is_driven and (shift or not can_stay):
        bus.write(servo_id, reg.TORQUE_ENABLE, 0)
    bus.write(servo_id, reg.LOCK, 0)
    if shift:
        bus.write(servo_id, _LIMITS, _limits(0, _MAX))
    bus.write(servo_id, reg.HOMING_OFFSET, wanted.homing_offset)
    bus.write(servo_id, _LIMITS, _limits(wanted.range_min, wanted.range_max))
    bus.write(servo_id, reg.LOCK, 1)
    if is_driven and shift and can_stay:
        bus.write(servo_id, reg.GOAL_POSITION, goal)
        bus.write(servo_id, reg.TORQUE_ENABLE, 1)


def _limits(lower: int, upper: int) -> int:
    return upper << 16 | lower


def write_calibration(bus: Bus, stored: Stored) -> Path | None:
    """Store a file in the servos that answer, for good; returns where is kept what they held."""
    answering = bus.answering(entry.id for entry in stored.calibration.values())
    there = {joint: e for joint, e in stored.calibration.items() if e.id in answering}
    if not there:
        raise missing_servos(bus, [entry.id for entry in stored.calibration.values()], ())
    held: dict[str, JointCalibration] = {}
    for joint, entry in there.items():
        found = read_held(bus, entry.id)
        offset = representable(found.homing_offset)
        held[joint] = replace(entry, **asdict(found) | {"homing_offset": offset})
    kept = store.keep_held(stored.path, held)
    for entry in there.values():
        write_held(bus, entry.id, entry)
    return kept


# Before and during a calibration


def release(bus: Bus, servo_ids: Iterable[int]) -> None:
    for servo_id in servo_ids:
        bus.write(servo_id, reg.TORQUE_ENABLE, 0)


def let_go(bus: Bus) -> None:
    """Switch the torque of every servo off that answers, the jaw's as well."""
    release(bus, sorted(bus.answering(SERVO_IDS.values())))


def is_driving(bus: Bus) -> bool | None:
    """Whether any servo drives its joint; None if none answers."""
    row = reg.TORQUE_ENABLE
    answers = bus.sync_read(tuple(SERVO_IDS.values()), row.address, row.size, tries=1 + RETRIES)
    return any(row.decode(each.data) for each in answers.values()) if answers else None


def require(bus: Bus, joints: Iterable[str]) -> None:
    ids = [SERVO_IDS[joint] for joint in joints]
    answering = bus.answering(ids)
    if missing := [servo_id for servo_id in ids if servo_id not in answering]:
        raise missing_servos(bus, missing, answering)


def read_positions(bus: Bus, joints: Sequence[str]) -> dict[str, int]:
    """Read the positions of the joints, 0 to 4095 [tick], in one transaction if possible."""
    row, ids = reg.PRESENT_POSITION, tuple(map(SERVO_IDS.__getitem__, joints))
    answers = bus.sync_read(ids, row.address, row.size, tries=1 + RETRIES)
    if missing := [i for i in ids if i not in answers]:
        raise missing_servos(bus, missing, answers)
    return {joint: row.decode(answers[SERVO_IDS[joint]].data) % TICKS_PER_TURN for joint in joints}


def check_homed(bus: Bus, homes: Mapping[str, int]) -> None:
    """Check that the servos report the homing pose ``homes`` [tick] with their new offsets."""
    for joint, ticks in read_positions(bus, tuple(homes)).items():
        if abs(around(ticks - homes[joint])) > _STILL:
            raise CalibrationError(
                joint,
                f"reads {ticks} with its new homing offset instead of {homes[joint]}",
                "hold the arm still and start again; if that does not help, this software does not"
                " know its servo's firmware",
            )
