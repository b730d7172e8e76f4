"""Read the servos of an arm in use, and report what is wrong with them, worst first."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from so101_motion.calib.motors.arm_identification import ServoFacts, ServosOnBus
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.reply_counters import ReplyCounter
from so101_motion.drivers.feetech.servo_judgement import lossy_share, sag


def label(servo_id: int, names: Mapping[int, str]) -> str:
    """The name of a servo in a message; ``names`` has the joint of each, by id."""
    name = names.get(servo_id)
    return f"servo {servo_id}" + (f" ({name})" if name else "")


def explain(
    seen: ServosOnBus, names: Mapping[int, str], counters: Mapping[int, ReplyCounter]
) -> tuple[str, ...]:
    """What is wrong with the servos that should be there: ``names`` has their joints, by id."""
    servos = {i: facts for i, facts in seen.servos.items() if i in names}
    heard = sorted({*seen.servos, *seen.shared})
    if not servos:
        return (_nobody(heard),)
    said = partial(label, names=names)
    missing = _missing(sorted(names), sorted(names.keys() - servos.keys()), heard, said)
    return (*missing, *_each(servos, counters, said), *_together(servos, said))


def _nobody(heard: list[int]) -> str:
    if heard:
        return (
            "none of the arm's servos answers, but there are others:"
            f" {', '.join(map(str, heard))}. They have never been given their ids, or"
            " servo_ids is wrong; run the motor setup"
        )
    return (
        "the adapter is there but no servo answers: check that the arm's power supply is on and"
        " that the first 3-pin cable is plugged into the adapter; a wrong baudrate looks the same"
    )


def _missing(
    expected: list[int], missing: list[int], heard: list[int], said: Callable[[int], str]
) -> list[str]:
    found = []
    if missing:
        first, where = missing[0], "their plugs, and that each has its own id"
        if missing == [i for i in expected if i >= first] and first > expected[0]:
            before = expected[expected.index(first) - 1]
            where = f"the cable between {said(before)} and {said(first)}"
        names = ", ".join(map(said, missing))
        # Beside a whole arm they are wheels, a head or another arm's.
        if others := ", ".join(str(i) for i in heard if i not in expected):
            where += f"; if {others}, which answer, are this arm's, run the motor setup"
        found.append(f"no answer from {names}, the others answer: check {where}")
    return found


def _each(
    servos: Mapping[int, ServoFacts],
    counters: Mapping[int, ReplyCounter],
    said: Callable[[int], str],
) -> list[str]:
    shares = {
        i: lossy_share(counter.lost, counter.asked)
        for i, counter in counters.items()
        if i in servos
    }
    lost = {i: share for i, share in shares.items() if share}
    is_everyone = len(servos) > 1 and lost.keys() == servos.keys()
    found = []
    for servo_id, facts in servos.items():
        problems = [*map(str, facts.troubles), *_about_settings(facts)]
        counter = counters.get(servo_id, ReplyCounter())
        if garbled := lossy_share(counter.corrupt, counter.asked):
            problems.append(
                f"{100 * garbled:.1f} % of its answers are garbled: a loose cable, a brown-out, or"
                " another servo with the same id"
            )
        if servo_id in lost and not is_everyone:
            problems.append(
                f"{100 * lost[servo_id]:.1f} % of the questions to it got no answer: a loose cable"
            )
        found += [f"{said(servo_id)}: {problem}" for problem in problems]
    asked = sum(counter.asked for counter in counters.values())
    if late := lossy_share(sum(counter.late for counter in counters.values()), asked):
        found.append(
            f"{100 * late:.1f} % of the answers came late, none of them is lost: set the adapter's"
            " latency timer to 1 ms, and use neither a hub nor a virtual machine"
        )
    if is_everyone:
        found.append(
            f"{100 * min(lost.values()):.1f} % of the questions got no answer, with every servo:"
            " this computer is too busy, or the first cable is loose"
        )
    return found


def _about_settings(facts: ServoFacts) -> list[str]:
    found = [f"{odd.sentence}; {odd.fix}" for odd in facts.odd_settings]
    if not facts.fits_arm:
        found.append(f"is a {facts.model}, not an STS3215; replace it")
    if facts.model_note:
        found.append(facts.model_note)
    if facts.holds(reg.TORQUE_ENABLE) == 1 and facts.holds(reg.TORQUE_LIMIT) == 0:
        found.append("is driven but its torque limit is 0, so it ignores its goal; reinitialize it")
    if abs(facts.holds(reg.HOMING_OFFSET)) > 2047:
        offset = facts.holds(reg.HOMING_OFFSET)
        found.append(f"its homing offset {offset} is beyond 2047; calibrate again")
    if not 0 <= facts.holds(reg.PRESENT_POSITION) <= 4095:
        position = facts.holds(reg.PRESENT_POSITION)
        found.append(f"reports position {position}, outside 0 to 4095; calibrate again")
    return found


def _together(servos: Mapping[int, ServoFacts], said: Callable[[int], str]) -> list[str]:
    found = []
    firmware = {said(i): facts.firmware for i, facts in servos.items()}
    if len(set(firmware.values())) > 1:
        table = ", ".join(f"{name} {version}" for name, version in firmware.items())
        found.append(
            f"the servos have different firmware ({table}); works, but update them some day"
        )
    trouble = sag([servos[i].volts for i in sorted(servos)])
    return [*found, str(trouble)] if trouble is not None else found
