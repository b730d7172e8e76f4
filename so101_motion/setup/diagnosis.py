"""Read the servos of an arm in use, and report what is wrong with them, worst first."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from so101_motion.calib.motors.arm_identification import ServoFacts, read_facts
from so101_motion.common.errors import BusError, PortUnavailable
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.reply_counters import ReplyCounter
from so101_motion.drivers.feetech.servo_judgement import lossy_share, sag


@dataclass(frozen=True, slots=True, kw_only=True)
class Examination:
    """The result of reading the servos."""

    names: Mapping[int, str]  # the joint of each servo that should be there, by id
    heard: tuple[int, ...]  # ids of all servos that answer
    servos: Mapping[int, ServoFacts]  # their registers, by id
    counters: Mapping[int, ReplyCounter]  # counters of replies and losses, by id

    def label(self, servo_id: int) -> str:
        name = self.names.get(servo_id)
        return f"servo {servo_id}" + (f" ({name})" if name else "")


def examine(bus: Bus, names: Mapping[int, str], turned: Collection[int] = ()) -> Examination:
    """Read all servos; those ``turned`` count down, as their calibration says."""
    heard = set(bus.scan())
    servos = {}
    for servo_id in names:
        try:
            facts = read_facts(bus, servo_id)
            servos[servo_id] = replace(facts, counts_down=servo_id in turned)
        except PortUnavailable:
            raise
        except BusError:
            continue
    heard |= servos.keys()
    return Examination(
        names=names, heard=tuple(sorted(heard)), servos=servos, counters=dict(bus.counters)
    )


def explain(seen: Examination) -> tuple[str, ...]:
    if not seen.servos:
        return (_nobody(seen),)
    return (*_missing(seen), *_each(seen), *_together(seen))


def _nobody(seen: Examination) -> str:
    if seen.heard:
        return (
            "none of the arm's servos answers, but there are others:"
            f" {', '.join(map(str, seen.heard))}. They have never been given their ids, or"
            " servo_ids is wrong; run the motor setup"
        )
    return (
        "the adapter is there but no servo answers: check that the arm's power supply is on and"
        " that the first 3-pin cable is plugged into the adapter; a wrong baudrate looks the same"
    )


def _missing(seen: Examination) -> list[str]:
    found = []
    expected = sorted(seen.names)
    missing = [servo_id for servo_id in expected if servo_id not in seen.servos]
    if missing:
        first, where = missing[0], "their plugs, and that each has its own id"
        if missing == [i for i in expected if i >= first] and first > expected[0]:
            before = expected[expected.index(first) - 1]
            where = f"the cable between {seen.label(before)} and {seen.label(first)}"
        names = ", ".join(map(seen.label, missing))
        # Beside a whole arm they are wheels, a head or another arm's.
        if others := ", ".join(str(i) for i in seen.heard if i not in seen.names):
            where += f"; if {others}, which answer, are this arm's, run the motor setup"
        found.append(f"no answer from {names}, the others answer: check {where}")
    return found


def _each(seen: Examination) -> list[str]:
    shares = {
        i: lossy_share(counter.lost, counter.asked)
        for i, counter in seen.counters.items()
        if i in seen.servos
    }
    lost = {i: share for i, share in shares.items() if share}
    is_everyone = len(seen.servos) > 1 and lost.keys() == seen.servos.keys()
    found = []
    for servo_id, facts in seen.servos.items():
        problems = [*map(str, facts.troubles), *_about_settings(facts)]
        counter = seen.counters.get(servo_id, ReplyCounter())
        if garbled := lossy_share(counter.corrupt, counter.asked):
            problems.append(
                f"{100 * garbled:.1f} % of its answers are garbled: a loose cable, a brown-out, or"
                " another servo with the same id"
            )
        if servo_id in lost and not is_everyone:
            problems.append(
                f"{100 * lost[servo_id]:.1f} % of the questions to it got no answer: a loose cable"
            )
        found += [f"{seen.label(servo_id)}: {problem}" for problem in problems]
    asked = sum(counter.asked for counter in seen.counters.values())
    if late := lossy_share(sum(counter.late for counter in seen.counters.values()), asked):
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
        found.append("is driven but its torque limit is 0, so it ignores its goal; reinitialize")
    if abs(facts.holds(reg.HOMING_OFFSET)) > 2047:
        offset = facts.holds(reg.HOMING_OFFSET)
        found.append(f"its homing offset {offset} is beyond 2047; calibrate again")
    if not 0 <= facts.holds(reg.PRESENT_POSITION) <= 4095:
        position = facts.holds(reg.PRESENT_POSITION)
        found.append(f"reports position {position}, outside 0 to 4095; calibrate again")
    return found


def _together(seen: Examination) -> list[str]:
    found = []
    firmware = {seen.label(i): facts.firmware for i, facts in seen.servos.items()}
    if len(set(firmware.values())) > 1:
        table = ", ".join(f"{name} {version}" for name, version in firmware.items())
        found.append(
            f"the servos have different firmware ({table}); works, but update them some day"
        )
    trouble = sag([seen.servos[i].volts for i in sorted(seen.servos)])
    return [*found, str(trouble)] if trouble is not None else found
