"""What a calibration asks of the bus before it records; to be run on the port's thread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from so101_motion.calib.eeprom import read_held, restorable
from so101_motion.calib.record import JOINTS
from so101_motion.calib.recording import around
from so101_motion.calib.view import JointProgress
from so101_motion.drivers import registers as reg
from so101_motion.drivers.bus import RETRIES, Bus
from so101_motion.drivers.presence import not_there
from so101_motion.drivers.registers import TICKS_PER_TURN
from so101_motion.errors import CalibrationError

_REVERSED = 0x80  # bit of register 18: the encoder counts down (FT)

_STILL = 171
"""How far a joint may move between being read and having its new offset checked [tick]; 15 deg,
chosen: a hand trembles, a servo that understands offsets otherwise is off by more."""


def servo_id(joint: str) -> int:
    """The servo that moves a joint."""
    return JOINTS.index(joint) + 1


def find(bus: Bus, joints: Sequence[str]) -> dict[str, JointProgress]:
    """What the joints' servos hold.

    Raises:
        BusError: A servo does not answer.
    """
    require(bus, joints)
    return {joint: _find(bus, joint) for joint in joints}


def _find(bus: Bus, joint: str) -> JointProgress:
    held = read_held(bus, servo_id(joint))
    return JointProgress(
        joint=joint,
        before=restorable(held),
        held=held,
        driven=bus.read(servo_id(joint), reg.TORQUE_ENABLE) == 1,
        counts_down=bool(bus.read(servo_id(joint), reg.PHASE) & _REVERSED),
    )


def release(bus: Bus, joints: Sequence[str]) -> None:
    """Let go of the joints.

    Raises:
        BusError: A servo does not answer.
    """
    for joint in joints:
        bus.write(servo_id(joint), reg.TORQUE_ENABLE, 0)


def require(bus: Bus, joints: Sequence[str]) -> None:
    """See that the joints' servos are there.

    Raises:
        NoReply: One is not; it says which, and where to look.
    """
    answering = bus.answering(map(servo_id, joints))
    missing = [servo_id(joint) for joint in joints if servo_id(joint) not in answering]
    if missing:
        raise not_there(bus, missing, answering)


def read_positions(bus: Bus, joints: Sequence[str]) -> dict[str, int]:
    """Where the joints are, 0 to 4095 [tick], all at one instant if possible.

    Raises:
        NoReply: A servo does not answer.
    """
    row, ids = reg.PRESENT_POSITION, tuple(map(servo_id, joints))
    answers = bus.sync_read(ids, row.address, row.size, tries=1 + RETRIES)
    missing = [i for i in ids if i not in answers]
    if missing:
        raise not_there(bus, missing, answers)
    return {joint: row.decode(answers[servo_id(joint)].data) % TICKS_PER_TURN for joint in joints}


def check_homed(bus: Bus, homes: Mapping[str, int]) -> None:
    """See that the servos read in the homing pose what their new offsets promise.

    Args:
        bus: Where they are.
        homes: What each should read [tick].

    Raises:
        CalibrationError: One does not.
        NoReply: A servo does not answer.
    """
    for joint, ticks in read_positions(bus, tuple(homes)).items():
        if abs(around(ticks - homes[joint])) > _STILL:
            raise CalibrationError(
                joint,
                f"reads {ticks} with its new homing offset instead of {homes[joint]}",
                "hold the arm still and start again; if that does not help, its servo's firmware"
                " is unknown here",
            )
