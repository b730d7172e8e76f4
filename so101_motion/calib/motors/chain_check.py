"""Check the six servos of a finished arm; writes nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from functools import partial

from so101_motion.calib.motors.arm_identification import ServoFacts, ServosOnBus, look
from so101_motion.calib.motors.setup_view import MotorCheck, Verification
from so101_motion.calib.motors.single_servo import LIKELIEST_FIRST, Tuner
from so101_motion.calib.record.record import NEW_IDS, SERVO_IDS, misplaced
from so101_motion.common.errors import in_series
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.feetech.servo_settings import REPAIR


def verify(tuner: Tuner) -> Verification:
    """Look at all servos at the port's own rate, and for missing ones at the others."""
    seen = tuner.call(look)
    missing = [i for i in SERVO_IDS.values() if i not in seen.servos and i not in seen.shared]
    return judged(seen, elsewhere=_at_other_rates(tuner, missing) if missing else {})


def judged(
    seen: ServosOnBus,
    ids: Mapping[str, int] = SERVO_IDS,
    elsewhere: Mapping[int, int] | None = None,
) -> Verification:
    """Judge servos of an arm whose ``ids`` are by joint; ``elsewhere`` has other rates by id."""
    elsewhere = elsewhere or {}
    motors = {joint: _check(joint, i, seen, ids, elsewhere.get(i)) for joint, i in ids.items()}
    wrong = misplaced(seen.servos, seen.travels) if ids == SERVO_IDS else ""
    return Verification(
        motors=motors,
        unexpected_ids=seen.unexpected_ids,
        notes=tuple(_notes(seen)),
        sentence=f"not yet: {wrong}; {NEW_IDS}"
        if wrong
        else _verdict(seen, motors, set(elsewhere.values())),
        misplaced=wrong,
    )


def _at_other_rates(tuner: Tuner, missing: list[int]) -> dict[int, int]:
    found: dict[int, int] = {}
    for baud in LIKELIEST_FIRST:
        asked = [i for i in missing if i not in found]
        if baud != tuner.home and asked:
            tuner.tune(baud)
            found |= dict.fromkeys(tuner.call(partial(Bus.answering, servo_ids=asked)), baud)
    tuner.tune(tuner.home)
    return found


def _check(
    joint: str, servo_id: int, seen: ServosOnBus, ids: Mapping[str, int], other_baud: int | None
) -> MotorCheck:
    if servo_id in seen.shared:
        return MotorCheck(
            joint=joint,
            servo_id=servo_id,
            status="duplicate",
            error=f"several servos answer as {servo_id} ({joint}) at once{_absent(seen)}",
            fix=f"connect them one at a time and set each up, {joint} first",
        )
    facts = seen.servos.get(servo_id)
    if facts is None:
        return _missing(joint, servo_id, seen, ids, other_baud)
    status, error, fix = _trouble(joint, facts, seen)
    return MotorCheck(
        joint=joint, servo_id=servo_id, status=status, facts=facts, error=error, fix=fix
    )


def _missing(
    joint: str, servo_id: int, seen: ServosOnBus, ids: Mapping[str, int], other_baud: int | None
) -> MotorCheck:
    if other_baud is not None:
        error = f"servo {servo_id} ({joint}) talks at {other_baud} baud, not at {seen.baud}"
        fix = f"{REPAIR} sets {seen.baud}"
    elif seen.is_empty:
        error = f"servo {servo_id} ({joint}) does not answer, nor does any other"
        fix = "switch the arm's power supply on and plug the first cable in"
    elif shared := [name for name, i in ids.items() if i in seen.shared]:
        error = f"servo {servo_id} ({joint}) does not answer: it may be one of those that answer as"
        error += f" {_listed(seen.shared, ' or ')}"
        fix = f"connect them one at a time: so101 setup --joint {shared[0]}, then --joint {joint}"
    elif not any(i > servo_id and i in seen.servos for i in ids.values()):
        error = f"servo {servo_id} ({joint}) does not answer"
        # Servos behind a broken cable are silent as well. A robot's wheels may be on another.
        heard = [i for i in (*seen.servos, *seen.shared) if i < servo_id]
        last = max(heard, default=servo_id - 1)
        between = f"the cable between servos {last} and {last + 1}" if last else "the first cable"
        fix = f"check {between}"
        if others := _listed(seen.unexpected_ids, " or "):
            fix += f", or set {joint} up again if it answers as {others}"
    else:
        error = f"servo {servo_id} ({joint}) does not answer, though servos behind it do"
        fix = f"check its plugs; if they are in, its id is wrong: so101 setup --joint {joint}"
    return MotorCheck(joint=joint, servo_id=servo_id, status="not_responding", error=error, fix=fix)


def _trouble(joint: str, facts: ServoFacts, seen: ServosOnBus) -> tuple[str, str, str]:
    if not facts.fits_arm:
        error = f"servo {facts.servo_id} ({joint}) is a {facts.model}, not an STS3215"
        return "wrong_model", error, "replace it"
    supply = facts.supply_trouble
    if supply is not None:
        return "wrong_voltage", f"servo {facts.servo_id} ({joint}): {supply[0]}", supply[1]
    if facts.odd_settings:
        sentences = ", ".join(odd.sentence for odd in facts.odd_settings)
        error = f"servo {facts.servo_id} ({joint}): {sentences}"
        return "wrong_settings", error, facts.odd_settings[0].fix
    kinds = Counter(servo.nominal_volts for servo in seen.servos.values())
    usual = kinds.most_common(1)[0][0]
    if facts.nominal_volts != usual:
        error = f"servo {facts.servo_id} ({joint}) is a {facts.nominal_volts:g} V servo"
        return "wrong_voltage", f"{error} among {usual:g} V servos", "replace it"
    return "ok", "", ""


def _absent(seen: ServosOnBus) -> str:
    absent = [i for i in SERVO_IDS.values() if i not in seen.servos and i not in seen.shared]
    return f", and none as {_listed(absent, ' or ')}" if absent else ""


def _listed(ids: Iterable[int], by: str = ", ") -> str:
    return by.join(map(str, ids))


def _notes(seen: ServosOnBus) -> list[str]:
    notes = []
    versions = {servo_id: facts.firmware for servo_id, facts in seen.servos.items()}
    if len(set(versions.values())) > 1:
        table = ", ".join(f"servo {servo_id} {version}" for servo_id, version in versions.items())
        notes.append(f"the servos have different firmware ({table}), which does not hurt")
    notes += [
        f"servo {i} {facts.model_note}" for i, facts in seen.servos.items() if facts.model_note
    ]
    if seen.unexpected_ids:
        others = _listed(seen.unexpected_ids)
        notes.append(f"servos with ids that are not an arm's are left alone: {others}")
    return notes


def _verdict(seen: ServosOnBus, motors: Mapping[str, MotorCheck], elsewhere: set[int]) -> str:
    wrong = [check for check in motors.values() if check.status != "ok"]
    if seen.is_empty and elsewhere:
        bauds = in_series(sorted(elsewhere))
        return f"no servo answers at {seen.baud} baud, but at {bauds} baud, so the supply is on"
    if seen.is_empty:
        return "no servo answers: is the arm's power supply on?"
    if wrong:
        more = f", and {len(wrong) - 1} more" if len(wrong) > 1 else ""
        return f"not yet: {wrong[0].error}{more}"
    return "all six servos are set up correctly"
