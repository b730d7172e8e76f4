"""Find the one connected servo, check that no other is connected, and write its id and settings.

An id must never be changed while several servos listen: all that have the old id would take the new
one, and from then on their replies would collide.

A ping to all finds every id at once, but only servos that listen at the port's rate hear it. So the
port is tuned through the eight rates a servo can have, the likeliest first. Each rate takes as long
as 254 answers would, 23 ms at the fastest and 0.6 s at the slowest; all eight take 1.9 s. A rate at
which a servo answers is asked a second time, because no servo may be missed.

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

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Self, TypeVar

from so101_motion.calib.access import BusAccess
from so101_motion.calib.motors.arm_identification import ServoFacts, colliding, read_facts
from so101_motion.calib.record.record import SERVO_IDS
from so101_motion.common.errors import (
    CorruptReply,
    MotorSetupError,
    NoReply,
    PortUnavailable,
    ServoFault,
    in_series,
)
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import RETRIES, Bus
from so101_motion.drivers.bus.registers import Register
from so101_motion.drivers.feetech.servo_settings import mended

T = TypeVar("T")

LIKELIEST_FIRST = (1_000_000, 500_000, 115_200, 57_600, 38_400, 250_000, 128_000, 76_800)
"""Every rate of ``BAUDS``. Servos come with the first; the next are what other programs and other
brands use. Chosen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RateAnswers:
    """The servos that answer at one rate."""

    baud: int  # the rate [bit/s]
    ids: tuple[int, ...]  # ids of those that answer
    garbled: bool  # whether there were corrupt replies

    @property
    def is_silence(self) -> bool:
        return not self.ids and not self.garbled


class Tuner:
    """Tunes a lent bus to any rate; the end of a ``with`` block restores the port's own."""

    def __init__(self, access: BusAccess) -> None:
        self._access = access
        # the port's own rate [bit/s], and the present one
        self.home = self.baud = access.call(lambda bus: bus.port.baud)

    def tune(self, baud: int) -> None:
        if baud != self.baud:
            self._access.at_baud(baud)
            self.baud = baud

    def call(self, job: Callable[[Bus], T]) -> T:
        return self._access.call(job)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if error is None:
            self.tune(self.home)
            return
        with contextlib.suppress(PortUnavailable):  # the first error counts
            self.tune(self.home)


def listen(tuner: Tuner) -> RateAnswers:
    """Find the servos at the present rate; asks each that answers a second time."""
    roll = again = tuner.call(Bus.ping_all)
    if roll.ids or roll.garbled:
        again = tuner.call(Bus.ping_all)
    return RateAnswers(
        baud=tuner.baud,
        ids=tuple(sorted({*roll.ids, *again.ids})),
        garbled=roll.garbled and again.garbled,
    )


def find_first_rate(
    tuner: Tuner, *, hint: int | None = None, on_rate: Callable[[int], None] = lambda baud: None
) -> RateAnswers | None:
    """The first rate at which a servo answers, from ``hint`` on; the tuner stays there."""
    rates = dict.fromkeys((hint or tuner.home, tuner.home, *LIKELIEST_FIRST))
    # The likeliest in between: a servo that was plugged in just now takes a moment to start, and a
    # single answer may have been lost.
    order = [rate for baud in rates for rate in (baud, tuner.home)]
    return next((heard for heard in sweep(tuner, order, on_rate) if not heard.is_silence), None)


def find_all_rates(
    tuner: Tuner, *, on_rate: Callable[[int], None] = lambda baud: None
) -> list[RateAnswers]:
    rates = dict.fromkeys((tuner.home, *LIKELIEST_FIRST))
    return [heard for heard in sweep(tuner, rates, on_rate) if not heard.is_silence]


def sweep(
    tuner: Tuner, rates: Iterable[int], on_rate: Callable[[int], None] = lambda baud: None
) -> Iterator[RateAnswers]:
    """Listen at each of ``rates`` [bit/s] in turn, as long as the caller goes on."""
    for baud in rates:
        on_rate(baud)
        tuner.tune(baud)
        yield listen(tuner)


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


_MORE = 3
"""How often to listen again for a servo that must be there, because replies get lost. Chosen."""


def find_alone(
    tuner: Tuner,
    joint: str,
    *,
    hint: int | None = None,
    on_rate: Callable[[int], None] = lambda baud: None,
) -> ServoFacts:
    """Find the one connected servo, whatever its id and rate; the tuner stays at its rate."""
    facts = _read_only_one(tuner, joint, find_first_rate(tuner, hint=hint, on_rate=on_rate))
    if not facts.fits_arm:
        raise MotorSetupError(
            joint,
            "wrong model",
            f"the servo {facts.servo_id} that is connected is a {facts.model}, not an STS3215",
            "connect a servo of the arm's kit",
        )
    return facts


def require_alone(tuner: Tuner, joint: str) -> None:
    """Check that no other servo answers at any rate; takes two seconds.

    The tuner comes back to its rate; there ``find_alone`` has seen that only one answers.
    """
    there = tuner.baud
    for others in sweep(tuner, (baud for baud in LIKELIEST_FIRST if baud != there)):
        if not others.is_silence:
            raise MotorSetupError(
                joint,
                "several servos",
                f"one servo answers at {there} baud, and another at {others.baud}",
                _alone(joint),
            )
    tuner.tune(there)


def read_back(tuner: Tuner, joint: str) -> ServoFacts:
    servo_id = SERVO_IDS[joint]
    heard = listen(tuner)
    for _ in range(_MORE):
        if not heard.is_silence:
            break
        heard = listen(tuner)
    if heard.ids != (servo_id,) or heard.garbled:
        raise _not_taken(
            joint, f"only {servo_id} should answer now, but {in_series(heard.ids) or 'none'} did"
        )
    facts = tuner.call(lambda bus: read_facts(bus, servo_id))
    wanted = {
        **settings(joint, facts, moved=False),
        reg.ID: servo_id,
        reg.BAUD_RATE: reg.BAUDS.index(tuner.baud),
        reg.LOCK: 1,
        reg.TORQUE_ENABLE: 0,
    }
    wrong = [
        f"{register.name} is {facts.holds(register)} instead of {value}"
        for register, value in wanted.items()
        if facts.holds(register) != value
    ]
    if wrong:
        raise _not_taken(joint, f"servo {servo_id}: {', '.join(wrong)}")
    return facts


def _read_only_one(tuner: Tuner, joint: str, heard: RateAnswers | None) -> ServoFacts:
    nobody = MotorSetupError(
        joint,
        "no servo",
        "the adapter is connected, but no servo answers at any baud rate",
        "switch the arm's power supply on (USB does not feed the servos) and plug the"
        f" 3-pin cable of the servo of {joint} into the adapter",
    )
    if heard is None:
        raise nobody
    if len(heard.ids) > 1:
        raise _several(joint, heard.ids)
    if heard.garbled or not heard.ids:
        raise _same_id(joint, heard.ids)
    servo_id = heard.ids[0]
    try:
        facts = tuner.call(lambda bus: read_facts(bus, servo_id))
    except NoReply as error:  # it was unplugged just now
        raise nobody from error
    except CorruptReply as error:
        raise _same_id(joint, heard.ids) from error
    if tuner.call(lambda bus: colliding(bus, heard.ids)):
        raise _same_id(joint, heard.ids)
    return facts


def _several(joint: str, ids: tuple[int, ...]) -> MotorSetupError:
    kind, fix, reason = (
        "several servos",
        _alone(joint),
        f"several servos are connected: {in_series(ids)} answer",
    )
    if set(SERVO_IDS.values()) <= set(ids):
        reason = "a whole arm is connected, all six ids answer"
        fix = f"skip it to verify the arm; or, to set this servo up again, {fix}"
    elif SERVO_IDS[joint] in ids:
        kind = "id taken"
        reason = (
            f"a servo that already has the id of {joint}, {SERVO_IDS[joint]}, is connected beside"
            f" others ({in_series(ids)} answer)"
        )
    return MotorSetupError(joint, kind, reason, fix)


def _same_id(joint: str, ids: tuple[int, ...]) -> MotorSetupError:
    as_whom = f" as servo {ids[0]}" if ids else ""
    return MotorSetupError(
        joint,
        "same id",
        f"several servos answer{as_whom} at once, so their replies collide",
        f"{_alone(joint)}; if it is alone, check the plugs of its cable",
    )


def _not_taken(joint: str, reason: str) -> MotorSetupError:
    return MotorSetupError(
        joint, "not taken", reason, "switch the servo's power off and on and try again"
    )


def _alone(joint: str) -> str:
    return f"connect only the servo of {joint}, unplug the others"
