"""What is wrong with an arm and what to do about it, as somebody would say who has seen many.

First look (``examine``, on the I/O thread), then think (``explain``, which touches nothing). The
symptoms are those that people report of this arm; each finding names the servo, the figure and the
next thing to try. Nothing here writes to a servo.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from so101_motion.drivers import registers as reg
from so101_motion.drivers.bus import Bus
from so101_motion.drivers.registers import Fault
from so101_motion.drivers.tally import Tally
from so101_motion.errors import BusError, PortUnavailable

_WARM_C = 55
_ROUGH = 0.02  # share of garbled or lost answers that is worth a word; a good bus has none
_ENOUGH = 100  # questions, to speak of a share
_SAG = 0.7  # [V] between first and last servo
_WEAK = 6.0  # [V] below this even the 7.4 V servos have little strength

_LOOK_AT = (
    reg.FIRMWARE_MAJOR,
    reg.FIRMWARE_MINOR,
    reg.MODEL_NUMBER,
    reg.MIN_POSITION,
    reg.MAX_POSITION,
    reg.MAX_TEMPERATURE,
    reg.MAX_VOLTAGE,
    reg.MIN_VOLTAGE,
    reg.PHASE,
    reg.HOMING_OFFSET,
    reg.OPERATING_MODE,
    reg.TORQUE_ENABLE,
    reg.TORQUE_LIMIT,
    reg.PRESENT_POSITION,
    reg.PRESENT_LOAD,
    reg.PRESENT_VOLTAGE,
    reg.PRESENT_TEMPERATURE,
    reg.STATUS,
    reg.PRESENT_CURRENT,
)
_END = reg.PRESENT_CURRENT.address + reg.PRESENT_CURRENT.size


@dataclass(frozen=True, slots=True, kw_only=True)
class Examination:
    """What was seen.

    Attributes:
        names: The joint of each servo that should be there, by id.
        heard: Ids of all servos that answered a broadcast.
        registers: What each expected servo holds, by id and register name.
        tallies: How well each has been heard so far, by id.
    """

    names: Mapping[int, str]
    heard: tuple[int, ...]
    registers: Mapping[int, Mapping[str, int]]
    tallies: Mapping[int, Tally]

    def label(self, servo_id: int) -> str:
        """What to call a servo."""
        name = self.names.get(servo_id)
        return f"servo {servo_id}" + (f" ({name})" if name else "")


def examine(bus: Bus, names: Mapping[int, str]) -> Examination:
    """Look at the servos and read what they hold.

    Args:
        bus: Where they are.
        names: The joint of each servo that should be there, by id.

    Raises:
        PortUnavailable: There is no port.
    """
    heard = set(bus.scan())
    held = {}
    for servo_id in names:
        try:
            block = bus.read_block(servo_id, 0, _END, what="its registers")
        except PortUnavailable:
            raise
        except BusError:
            continue
        heard.add(servo_id)
        held[servo_id] = {register.name: register.cut(block, 0) for register in _LOOK_AT}
    return Examination(
        names=names,
        heard=tuple(sorted(heard)),
        registers=held,
        tallies=dict(bus.tallies),
    )


def explain(seen: Examination) -> tuple[str, ...]:
    """Everything that is wrong, worst first; empty when all is well."""
    if not seen.registers:
        return (_nobody(seen),)
    return (*_who_is_missing(seen), *_each(seen), *_together(seen))


def _nobody(seen: Examination) -> str:
    strangers = ", ".join(map(str, seen.heard))
    if strangers:
        return (
            f"none of the arm's servos answers, but there are others: {strangers}. They have never"
            " been given their ids, or servo_ids is wrong; run the motor setup"
        )
    return (
        "the adapter is there but no servo answers: check that the arm's power supply is on and"
        " that the first 3-pin cable is plugged into the adapter; a wrong baudrate looks the same"
    )


def _who_is_missing(seen: Examination) -> list[str]:
    found = []
    expected = sorted(seen.names)
    missing = [servo_id for servo_id in expected if servo_id not in seen.registers]
    if missing:
        names = ", ".join(map(seen.label, missing))
        first = missing[0]
        if missing == [i for i in expected if i >= first] and first > expected[0]:
            before = seen.label(expected[expected.index(first) - 1])
            where = f"the cable between {before} and {seen.label(first)}"
        else:
            where = "their plugs, and that each has its own id"
        found.append(f"no answer from {names}, the others answer: check {where}")
    strangers = [i for i in seen.heard if i not in seen.names]
    if strangers:
        found.append(
            f"unexpected servos answer: {', '.join(map(str, strangers))}; a servo as new has id 1,"
            " so one was perhaps never set up: run the motor setup"
        )
    return found


def _each(seen: Examination) -> list[str]:
    unheard = _unheard(seen)
    each_alike = len(seen.registers) > 1 and unheard.keys() == seen.registers.keys()
    found = []
    for servo_id, held in seen.registers.items():
        problems = _about(held) + _about_hearing(seen.tallies.get(servo_id, Tally()))
        if servo_id in unheard and not each_alike:
            problems.append(
                f"{100 * unheard[servo_id]:.1f} % of the questions to it got no answer: a loose"
                " cable"
            )
        found += [f"{seen.label(servo_id)}: {problem}" for problem in problems]
    if each_alike:
        found.append(
            f"{100 * min(unheard.values()):.1f} % of the questions got no answer, from whichever"
            " servo: this computer is too busy to listen, or the first cable is loose"
        )
    return found


def _about(held: Mapping[str, int]) -> list[str]:
    found = []
    volts, ceiling = held["present_voltage"] / 10.0, held["max_voltage"] / 10.0
    floor, hot = held["min_voltage"] / 10.0, held["max_temperature"]
    faults = Fault(held["status"])
    if volts > ceiling:
        kind = " These look like 7.4 V servos on a 12 V supply: switch it off" if volts > 9 else ""
        found.append(f"{volts:.1f} V, but it is made for at most {ceiling:.1f} V.{kind}")
    elif volts < floor or volts < _WEAK:
        found.append(
            f"only {volts:.1f} V: the supply is too weak, or its plug is loose; joints will be slow"
            " and may restart when several move"
        )
    elif faults & Fault.VOLTAGE:
        found.append(
            f"reports a voltage outside {floor:.1f} to {ceiling:.1f} V: it sags under load"
        )
    if faults & (Fault.OVERLOAD | Fault.OVERCURRENT):
        load = abs(held["present_load"]) / 10.0
        found.append(
            f"overloaded ({load:.0f} % drive): something blocks the joint or its load is too heavy;"
            " free it, then let the arm hold again"
        )
    celsius = held["present_temperature"]
    if faults & Fault.OVERHEATED or celsius >= _WARM_C:
        found.append(
            f"{celsius} degC, it gives up at {hot}: let it cool, and do not let it press or hold"
            " up a load for long"
        )
    if faults & Fault.ENCODER:
        found.append("its encoder is broken; replace the servo")
    return found + _about_settings(held)


def _about_settings(held: Mapping[str, int]) -> list[str]:
    found = []
    if held["model_number"] != reg.STS3215_MODEL:
        found.append(f"is of model {held['model_number']}, not an STS3215 ({reg.STS3215_MODEL})")
    if held["operating_mode"] != 0:
        found.append(f"is in mode {held['operating_mode']}, not in position mode; reinitialize")
    if held["torque_enable"] == 1 and held["torque_limit"] == 0:
        found.append("is driven but its torque limit is 0, so it ignores its goal; reinitialize")
    if held["phase"] & reg.MULTI_TURN:
        found.append("counts more than one turn, so its angles are ambiguous; reinitialize")
    if held["phase"] & reg.REVERSED:
        found.append(
            f"drives or counts backwards (its phase register is {held['phase']}, as new 12), so its"
            " joint may run the wrong way: set it back with the manufacturer's FD program"
        )
    if abs(held["homing_offset"]) > 2047:
        found.append(f"its homing offset {held['homing_offset']} is beyond 2047; calibrate again")
    if not 0 <= held["present_position"] <= 4095:
        found.append(f"reports position {held['present_position']}, outside 0 to 4095; calibrate")
    return found


def _about_hearing(tally: Tally) -> list[str]:
    share = _share(tally.corrupt, tally)
    if share <= _ROUGH:
        return []
    return [
        f"{100 * share:.1f} % of its answers are garbled: a loose cable, a brown-out, or another"
        " servo with the same id"
    ]


def _unheard(seen: Examination) -> dict[int, float]:
    """What share of the questions got no answer, for servos where that is too many."""
    tallies = {i: seen.tallies.get(i, Tally()) for i in seen.registers}
    shares = {i: _share(tally.lost, tally) for i, tally in tallies.items()}
    return {i: share for i, share in shares.items() if share > _ROUGH}


def _share(count: int, tally: Tally) -> float:
    """Of the questions to a servo; 0 as long as there were too few to tell."""
    return count / tally.asked if tally.asked >= _ENOUGH else 0.0


def _together(seen: Examination) -> list[str]:
    found = []
    firmware = {
        seen.label(servo_id): f"{held['firmware_major']}.{held['firmware_minor']}"
        for servo_id, held in seen.registers.items()
    }
    if len(set(firmware.values())) > 1:
        table = ", ".join(f"{name} {version}" for name, version in firmware.items())
        found.append(
            f"the servos have different firmware ({table}); works, but update them some day"
        )
    volts = [held["present_voltage"] / 10.0 for _, held in sorted(seen.registers.items())]
    if volts[0] - volts[-1] > _SAG:
        found.append(
            f"{volts[0]:.1f} V at the base but {volts[-1]:.1f} V at the end: the thin cables carry"
            " too much; check their plugs, or feed the far end as well"
        )
    return found
