"""Find the one connected servo, check that no other is connected, and read its setup back.

An id must never be changed while several servos listen: all that have the old id would take the new
one, and from then on their replies would collide.
"""

from __future__ import annotations

from collections.abc import Callable

from so101_motion.calib.motors import servo_program
from so101_motion.calib.motors.arm_identification import ServoFacts, colliding, read_facts
from so101_motion.calib.motors.servo_search import (
    LIKELIEST_FIRST,
    RateAnswers,
    Tuner,
    find_first_rate,
    listen,
    sweep,
)
from so101_motion.calib.record.record import SERVO_IDS
from so101_motion.common.errors import CorruptReply, MotorSetupError
from so101_motion.drivers.bus import registers as reg

_MORE = 3
"""How often to listen again for a servo that must be there, because replies get lost. Chosen."""


def find_alone(
    tuner: Tuner, joint: str, *, hint: int | None, on_rate: Callable[[int], None]
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
        if others.ids or others.garbled:
            raise MotorSetupError(
                joint,
                "several servos",
                f"one servo answers at {there} baud, and another at {others.baud}",
                _alone(joint),
            )
    tuner.tune(there)


def read_back(tuner: Tuner, joint: str) -> ServoFacts:
    """Read the newly assigned servo of ``joint`` back and check it."""
    servo_id = SERVO_IDS[joint]
    heard = listen(tuner)
    for _ in range(_MORE):
        if not heard.is_silence:
            break
        heard = listen(tuner)
    if heard.ids != (servo_id,) or heard.garbled:
        raise _not_taken(
            joint, f"only {servo_id} should answer now, but {_list(heard.ids) or 'none'} did"
        )
    facts = tuner.call(lambda bus: read_facts(bus, servo_id))
    wanted = {
        **servo_program.settings(joint, facts, moved=False),
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
    if heard is None:
        raise MotorSetupError(
            joint,
            "no servo",
            "the adapter is connected, but no servo answers at any baud rate",
            "switch the arm's power supply on (USB does not feed the servos) and plug the"
            f" 3-pin cable of the servo of {joint} into the adapter",
        )
    if len(heard.ids) > 1:
        raise _several(joint, heard.ids)
    if heard.garbled or not heard.ids:
        raise _same_id(joint, heard.ids)
    servo_id = heard.ids[0]
    try:
        facts = tuner.call(lambda bus: read_facts(bus, servo_id))
    except CorruptReply as error:
        raise _same_id(joint, heard.ids) from error
    if tuner.call(lambda bus: colliding(bus, heard.ids)):
        raise _same_id(joint, heard.ids)
    return facts


def _several(joint: str, ids: tuple[int, ...]) -> MotorSetupError:
    if set(SERVO_IDS.values()) <= set(ids):
        return MotorSetupError(
            joint,
            "several servos",
            "a whole arm is connected, all six ids answer",
            f"verify it; or, to set this servo up again, {_alone(joint)}",
        )
    if SERVO_IDS[joint] in ids:
        return MotorSetupError(
            joint,
            "id taken",
            f"a servo that already has the id of {joint}, {SERVO_IDS[joint]}, is connected beside"
            f" others ({_list(ids)} answer)",
            _alone(joint),
        )
    return MotorSetupError(
        joint, "several servos", f"several servos are connected: {_list(ids)} answer", _alone(joint)
    )


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


def _list(ids: tuple[int, ...]) -> str:
    named = [str(each) for each in ids]
    return " and ".join(filter(None, (", ".join(named[:-1]), *named[-1:])))
