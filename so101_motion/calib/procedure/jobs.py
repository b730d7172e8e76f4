"""Read, release and check the servos before a calibration records the travels of the joints.

All of it runs on the port's thread.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from so101_motion.calib.procedure.eeprom import read_held, restorable
from so101_motion.calib.procedure.travel import around
from so101_motion.calib.procedure.view import JointProgress
from so101_motion.calib.record.record import SERVO_IDS
from so101_motion.common.errors import CalibrationError
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import RETRIES, Bus
from so101_motion.drivers.bus.registers import TICKS_PER_TURN
from so101_motion.drivers.feetech.presence import missing_servos

_REVERSED = 0x80  # bit of register 18: the encoder counts down (FT)

_STILL = 171
"""How far a joint may move between being read and the check of its new offset [tick]; 15 deg,
chosen: a hand trembles, and a servo that interprets offsets differently is off by more."""


def find(bus: Bus, joints: Sequence[str]) -> dict[str, JointProgress]:
    """Read the state of the joints' servos before the calibration."""
    require(bus, joints)
    return {joint: _find(bus, joint) for joint in joints}


def _find(bus: Bus, joint: str) -> JointProgress:
    held = read_held(bus, SERVO_IDS[joint])
    return JointProgress(
        joint=joint,
        before=restorable(held),
        held=held,
        driven=bus.read(SERVO_IDS[joint], reg.TORQUE_ENABLE) == 1,
        counts_down=bool(bus.read(SERVO_IDS[joint], reg.PHASE) & _REVERSED),
    )


def release(bus: Bus, joints: Sequence[str]) -> None:
    """Switch the torque of the joints off."""
    for joint in joints:
        bus.write(SERVO_IDS[joint], reg.TORQUE_ENABLE, 0)


def let_go(bus: Bus) -> None:
    """Switch the torque of every servo off that answers, the jaw's as well."""
    for servo_id in sorted(bus.answering(SERVO_IDS.values())):
        bus.write(servo_id, reg.TORQUE_ENABLE, 0)


def is_driving(bus: Bus) -> bool | None:
    """Whether any servo drives its joint; None if none answers."""
    row = reg.TORQUE_ENABLE
    answers = bus.sync_read(tuple(SERVO_IDS.values()), row.address, row.size, tries=1 + RETRIES)
    return any(row.decode(each.data) for each in answers.values()) if answers else None


def require(bus: Bus, joints: Sequence[str]) -> None:
    """Check that the joints' servos answer."""
    answering = bus.answering(map(SERVO_IDS.__getitem__, joints))
    missing = [SERVO_IDS[joint] for joint in joints if SERVO_IDS[joint] not in answering]
    if missing:
        raise missing_servos(bus, missing, answering)


def read_positions(bus: Bus, joints: Sequence[str]) -> dict[str, int]:
    """Read the positions of the joints, 0 to 4095 [tick], in one transaction if possible."""
    row, ids = reg.PRESENT_POSITION, tuple(map(SERVO_IDS.__getitem__, joints))
    answers = bus.sync_read(ids, row.address, row.size, tries=1 + RETRIES)
    missing = [i for i in ids if i not in answers]
    if missing:
        raise missing_servos(bus, missing, answers)
    return {joint: row.decode(answers[SERVO_IDS[joint]].data) % TICKS_PER_TURN for joint in joints}


def check_homed(bus: Bus, homes: Mapping[str, int]) -> None:
    """Check that the servos report the homing pose with their new offsets.

    Args:
        bus: Their bus.
        homes: What each should read [tick].

    Raises:
        CalibrationError: A servo reads something else.
        NoReply: A servo does not answer.
    """
    for joint, ticks in read_positions(bus, tuple(homes)).items():
        if abs(around(ticks - homes[joint])) > _STILL:
            raise CalibrationError(
                joint,
                f"reads {ticks} with its new homing offset instead of {homes[joint]}",
                "hold the arm still and start again; if that does not help, this software does not"
                " know its servo's firmware",
            )
