"""Write id, baud rate and settings to a servo of the arm.

EEPROM is read, compared and written only where it differs, unlocked only meanwhile. A servo answers
at its new id or rate right after the order, so it is locked again *there*; with the old address the
lock would go to nobody and the memory stay open.

What is never written: voltage limits, because a servo that complains about its supply is right; and
the position loop's gains as long as they are in use, because the driver reads them and corrects for
the droop they allow. A loop softer than any program wants on purpose is what a crashed one left
behind; that is put back to the factory's.

A servo that becomes another joint's starts without calibration. One that keeps its id keeps its
homing offset and limits, so running the setup over a finished arm does no harm.
"""

from __future__ import annotations

from collections.abc import Mapping

from so101_motion.calib.motors.arm_identification import PROTECTIONS, ServoFacts
from so101_motion.calib.motors.servo_search import Tuner
from so101_motion.common.errors import ServoFault
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import RETRIES, Bus
from so101_motion.drivers.bus.registers import Register

OVERLOAD_PERCENT = 80
"""Drive that counts as an overload [%]; as delivered (FT). LeRobot lowers it on a jaw; a shoulder
that was once a jaw would give way under its own arm."""

JAW_TORQUE = 500
"""Largest drive of the jaw [0.1 %], as in LeRobot: what closes on something stiff must not be able
to overload itself. The servo takes it up when it is switched on."""

_FULL_TORQUE = 1000
_SOFTEST = 16  # P gain; LeRobot's, the softest any program uses on purpose
_GAINS = {reg.P_GAIN: 32, reg.D_GAIN: 32, reg.I_GAIN: 0}  # as delivered (FT, WS)
_UNCALIBRATED = {
    reg.HOMING_OFFSET: 0,
    reg.MIN_POSITION: 0,
    reg.MAX_POSITION: reg.TICKS_PER_TURN - 1,
}
_WRITING = 10  # how often a servo that writes its memory is asked whether it is back, 40 ms each


def settings(joint: str, facts: ServoFacts, *, moved: bool) -> dict[Register, int]:
    """The settings for the servo's EEPROM.

    Args:
        joint: Whose it is to be.
        facts: What it holds now.
        moved: Whether it was another joint's, or nobody's, before.
    """
    is_jaw = joint == GRIPPER_JOINT
    wanted = {
        reg.RETURN_DELAY: 0,
        reg.STATUS_LEVEL: 1,
        reg.OPERATING_MODE: 0,
        reg.PHASE: facts.holds(reg.PHASE) & ~reg.MULTI_TURN,
        reg.UNLOADING: facts.holds(reg.UNLOADING) | PROTECTIONS,
        reg.MAX_TORQUE: JAW_TORQUE if is_jaw else _FULL_TORQUE,
    }
    if not is_jaw:
        wanted[reg.OVERLOAD_TORQUE] = OVERLOAD_PERCENT
    if facts.holds(reg.P_GAIN) < _SOFTEST:
        wanted |= _GAINS
    if moved or not facts.has_sound_limits:
        wanted |= _UNCALIBRATED
    return wanted


def program(bus: Bus, servo_id: int, wanted: Mapping[Register, int]) -> tuple[str, ...]:
    """Store ``wanted`` in a servo for good, and switch its torque off.

    Returns:
        The names of what was changed.
    """
    bus.write(servo_id, reg.TORQUE_ENABLE, 0)
    changed = bus.store(servo_id, wanted)
    bus.write(servo_id, reg.LOCK, 1)  # other programs leave it open
    return changed


def change_id(bus: Bus, servo_id: int, new_id: int) -> None:
    """Change the id of the only servo on the bus for good; its torque must be off."""
    if servo_id != new_id:
        bus.change_id(servo_id, new_id)


def change_rate(tuner: Tuner, servo_id: int, baud: int) -> None:
    """Change a servo's baud rate for good, and tune the bus to it.

    Raises:
        BusError: It cannot be reached.
        ServoFault: It does not take the rate; then it and the tuner are where they were.
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
    """Whether a servo answers within the time that writing its memory may take."""
    return any(bus.answering((servo_id,)) for _ in range(_WRITING))
