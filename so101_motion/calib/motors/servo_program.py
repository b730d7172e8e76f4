"""Write id, baud rate and settings to a servo of the arm.

EEPROM is read, compared and written only where it differs, and unlocked only for that. A servo
answers at its new id or rate right after it is changed, so it is locked again *there*; a lock sent
to the old address would reach no servo, and the memory would stay open.

Voltage limits are never written, because a servo that complains about its supply is right. Settings
with which a servo does not move well (``servo_settings.py``) are set as new, whatever they are; the
others are left alone, gains too, because the driver reads them and corrects for their droop.

A servo that is moved to another joint starts without calibration. One that keeps its id keeps its
homing offset and limits, so running the setup on a finished arm does no harm.
"""

from __future__ import annotations

from collections.abc import Mapping

from so101_motion.calib.motors.arm_identification import ServoFacts
from so101_motion.calib.motors.servo_search import Tuner
from so101_motion.common.errors import ServoFault
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import RETRIES, Bus
from so101_motion.drivers.bus.registers import Register
from so101_motion.drivers.feetech.servo_settings import mended

OVERLOAD_PERCENT = 80
"""Drive that counts as an overload [%]; as delivered (FT). LeRobot lowers it on a jaw; a servo that
moves from the jaw to the shoulder would give way under the arm's weight."""

JAW_TORQUE = 500
"""Largest drive of the jaw [0.1 %], as in LeRobot: a jaw that closes on something stiff must not
overload itself. The servo applies it when it is switched on."""

_FULL_TORQUE = 1000
_UNCALIBRATED = {
    reg.HOMING_OFFSET: 0,
    reg.MIN_POSITION: 0,
    reg.MAX_POSITION: reg.TICKS_PER_TURN - 1,
}
_WRITING = 10  # how often a servo that writes its memory is asked whether it is back, 40 ms each


def settings(joint: str, facts: ServoFacts, *, moved: bool) -> dict[Register, int]:
    """The settings for the EEPROM of a servo; ``moved`` if it had another id before."""
    is_jaw = joint == GRIPPER_JOINT
    wanted = {
        **repairs(facts),
        reg.RETURN_DELAY: 0,
        reg.MAX_TORQUE: JAW_TORQUE if is_jaw else _FULL_TORQUE,
    }
    if not is_jaw:
        wanted[reg.OVERLOAD_TORQUE] = OVERLOAD_PERCENT
    return wanted | _UNCALIBRATED if moved else wanted


def repairs(facts: ServoFacts) -> dict[Register, int]:
    """The settings for the EEPROM of a servo that stays what it is: those it has, mended."""
    wanted = mended(facts.held)
    return wanted if facts.has_sound_limits else wanted | _UNCALIBRATED


def program(
    bus: Bus, servo_id: int, wanted: Mapping[Register, int], *, anew: bool = False
) -> tuple[str, ...]:
    """Store ``wanted`` for good, and switch torque off; returns the names of changed registers."""
    bus.write(servo_id, reg.TORQUE_ENABLE, 0)
    changed = bus.store(servo_id, wanted, anew=anew)
    bus.write(servo_id, reg.LOCK, 1)  # other programs leave it open
    return changed


def change_id(bus: Bus, servo_id: int, new_id: int) -> None:
    """Change the id of the only servo on the bus for good; its torque must be off."""
    if servo_id != new_id:
        bus.change_id(servo_id, new_id)


def change_rate(tuner: Tuner, servo_id: int, baud: int) -> None:
    """Change a servo's baud rate for good, and tune the bus to it.

    Raises:
        ServoFault: It does not take the rate; it and the tuner keep the old one.
    """
    old = tuner.baud
    if baud == old:
        return
    code = reg.BAUDS.index(baud)
    for _ in range(1 + RETRIES):
        tuner.call(lambda bus: bus.write(servo_id, reg.LOCK, 0))
        tuner.call(lambda bus: bus.post(servo_id, reg.BAUD_RATE, code))
        tuner.tune(baud)
        if tuner.call(lambda bus: answers_again(bus, servo_id)):
            tuner.call(lambda bus: bus.write(servo_id, reg.LOCK, 1))
            return
        tuner.tune(old)
    tuner.call(lambda bus: bus.write(servo_id, reg.LOCK, 1))
    raise ServoFault(
        f"servo {servo_id} did not take the baud rate {baud}; switch its power off and on, then"
        " try again",
        servo_id=servo_id,
    )


def answers_again(bus: Bus, servo_id: int) -> bool:
    return any(bus.answering((servo_id,)) for _ in range(_WRITING))
