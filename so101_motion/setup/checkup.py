"""Check whether an arm is fit to move: a list of checks, each with a verdict and what to do.

``examine`` reads the servos and writes nothing; the caller fills in the port and the file. A check
only judges ``Findings``, so that terminal, page and requests over the network show the same list.
"""

from __future__ import annotations

import contextlib
import os
import platform
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Literal

import numpy as np

from so101_motion.calib.access import BusAccess
from so101_motion.calib.motors import chain_check
from so101_motion.calib.motors.arm_identification import ServoFacts, ServosOnBus
from so101_motion.calib.motors.setup_view import Verification
from so101_motion.calib.motors.single_servo import Tuner
from so101_motion.calib.record import compare
from so101_motion.calib.record.record import LARGEST_OFFSET, NEW_IDS, SERVO_IDS
from so101_motion.calib.record.store import Stored
from so101_motion.calib.record.zero_report import ZeroReport
from so101_motion.common.attributes import SPEED_RANGE_DEG
from so101_motion.common.errors import in_series
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_deg, to_rad
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.defaults import BAUDRATE
from so101_motion.drivers.bus.reply_counters import ReplyCounter
from so101_motion.drivers.feetech.health import VITALS_COUNT, VITALS_START
from so101_motion.drivers.feetech.servo_judgement import BROKEN, LOSSY, lossy_share, sag
from so101_motion.drivers.feetech.servo_settings import REPAIR
from so101_motion.native.library import native

CYCLES = 200  # how often all servos are read to judge the bus; takes half a second. Chosen


@dataclass(frozen=True, slots=True, kw_only=True)
class BusQuality:
    """How reliably and how fast the servos answer."""

    asked: int
    late: int  # how many answers came after their timeout; they are not among the lost
    lost: int
    corrupt: int
    lateness: float  # how late answers typically come, beyond the time on the wire [s]
    median: float  # how long it takes to read all servos [s]
    p99: float  # the same, exceeded by one reading in a hundred [s]
    longest: float  # the longest [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """The findings about an arm; unknown ones are None or empty."""

    # versions of this package and others, by name; empty text for missing ones
    software: Mapping[str, str] = field(default_factory=dict)
    port: str | None = None  # the serial port; None for the simulated arm
    baudrate: int = BAUDRATE  # the rate at which its servos answer [bit/s]
    adapter: str = ""
    port_trouble: str = ""
    interfering_programs: Mapping[str, str] = field(default_factory=dict)
    lost_adapters: tuple[str, ...] = ()
    # what is wrong with the supply of the first servo and what to do about it, as long as not all
    # servos were looked at
    supply_trouble: tuple[str, str] | None = None
    latency_timer: float | None = None  # how long the adapter holds bytes back [s]
    servos: Verification | None = None
    bus_quality: BusQuality | None = None
    file: Path | None = None  # the calibration file; None when there is none
    # another program's file that agrees with the servos, if there is no ``file``
    agreeing_file: Path | None = None
    stored: Stored | None = None  # its content; None when it cannot be used
    file_trouble: str = ""
    is_unfinished: bool = False
    zero_reports: tuple[ZeroReport, ...] = ()
    # how servos have changed between the last two identifications
    servo_changes: tuple[str, ...] = ()
    speed: float | None = None  # joint speed cap of plans [rad/s]; None when nothing can be moved
    # joint acceleration cap of plans [rad/s^2]; None when nothing can be moved
    acceleration: float | None = None
    planning_time: float | None = None  # how long a motion took to plan [s]
    planning_trouble: str = ""

    @property
    def facts(self) -> dict[str, ServoFacts]:
        if self.servos is None:
            return {}
        found = {joint: check.facts for joint, check in self.servos.motors.items()}
        return {joint: facts for joint, facts in found.items() if facts is not None}


def software() -> dict[str, str]:
    """The versions of this package and its dependencies, by name; empty text if missing.

    Dependencies of some systems only are listed if they are installed.
    """
    names, sometimes = ["so101-motion"], set()
    with contextlib.suppress(metadata.PackageNotFoundError):
        needed = metadata.requires("so101-motion") or ()
        needed = [line for line in needed if "extra ==" not in line]
        names += map(_name, needed)
        sometimes = {_name(line) for line in needed if ";" in line}
    found = {}
    for name in names:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            if name not in sometimes:
                found[name] = ""
    return {
        **found,
        "Python": platform.python_version(),
        "platform": platform.platform(),
        "compiled planning": f"{native().lanes} configurations at once",
    }


def _name(requirement: str) -> str:
    return re.split(r"[^\w.-]", requirement, maxsplit=1)[0]


def examine(access: BusAccess) -> tuple[Verification, BusQuality | None]:
    """Measure the servos and, if any answers, their bus; takes a second and writes nothing."""
    with Tuner(access) as tuner:
        servos = chain_check.verify(tuner)
    ids = [check.servo_id for check in servos.motors.values() if check.facts is not None]
    return servos, access.call(lambda bus: listen(bus, ids)) if ids else None


def listen(bus: Bus, ids: Iterable[int], cycles: int = CYCLES) -> BusQuality:
    ids = tuple(ids)
    before = _counted(bus, ids)
    times = []
    for _ in range(cycles):
        begin = time.perf_counter()
        bus.sync_read(ids, VITALS_START, VITALS_COUNT)
        times.append(time.perf_counter() - begin)
    late, lost, corrupt = (now - then for now, then in zip(_counted(bus, ids), before, strict=True))
    return BusQuality(
        asked=cycles * len(ids),
        late=late,
        lost=max(lost, 0),  # a late answer takes back one that was lost before
        corrupt=corrupt,
        lateness=bus.counters.lateness.typical,
        median=float(np.median(times)),
        p99=float(np.quantile(times, 0.99)),
        longest=max(times),
    )


def _counted(bus: Bus, ids: Iterable[int]) -> tuple[int, ...]:
    counters = [bus.counters[servo_id] for servo_id in ids if servo_id in bus.counters]
    return tuple(sum(getattr(c, kind) for c in counters) for kind in ("late", "lost", "corrupt"))


Verdict = Literal["ok", "warn", "fail"]

_PERIOD = 0.01  # [s], the control loop's
_LATE = 0.003  # [s]; chosen: USB adapters need 1 to 2 ms
_SLOWEST = 0.1  # [s] to read all servos; chosen: tried up to 0.05 s, motions take longer then
_FREE_SPEED = {7.4: to_rad(312.0), 12.0: to_rad(270.0)}
"""Speed of a servo without load at its rated voltage [rad/s]: data sheets of the C001 and the C018.
It is proportional to the voltage."""
_USABLE = 0.7  # share of it that is left under the arm's loads; chosen


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One check and its result."""

    name: str
    verdict: Verdict  # ``"ok"``, ``"warn"`` or ``"fail"``
    sentence: str
    fix: str = ""  # what to do about it; empty when all is well


TORQUE = "torque"
"""The name of the check that finds some joints limp while the others hold."""


def ok(name: str, sentence: str) -> Check:
    return Check(name=name, verdict="ok", sentence=sentence)


def warn(name: str, sentence: str, fix: str) -> Check:
    return Check(name=name, verdict="warn", sentence=sentence, fix=fix)


def fail(name: str, sentence: str, fix: str) -> Check:
    return Check(name=name, verdict="fail", sentence=sentence, fix=fix)


def check_up(seen: Findings) -> tuple[Check, ...]:
    return tuple(_joined(check for checks in _CHECKS for check in checks(seen)))


def check_servos(servos: Verification) -> tuple[Check, ...]:
    """Check servos alone, without their calibration."""
    seen = Findings(servos=servos)
    return tuple(_joined(check for checks in _OF_SERVOS for check in checks(seen)))


_OF_A_SERVO = re.compile(r"servo (\d+) \(\w+\)(: .*| does not answer.*)", re.DOTALL)


def _joined(checks: Iterable[Check]) -> Iterator[Check]:
    """Make one check of servos' that differ in nothing but figures."""
    alike: dict[object, list[tuple[Check, str, str]]] = {}
    for number, check in enumerate(checks):
        form = _OF_A_SERVO.fullmatch(check.sentence)
        servo, text = form.groups() if form else ("", "")
        key = (check.verdict, check.fix, re.sub(r"[\d.]+", "", text)) if form else number
        alike.setdefault(key, []).append((check, servo, text))
    for (check, servo, text), *more in alike.values():
        if more:
            others = [each[1] for each in more]
            who = "all servos" if len(more) == 5 else "servos "
            who += "" if len(more) == 5 else f"{', '.join([servo, *others[:-1]])} and {others[-1]}"
            text = re.sub("^: it ", ": each ", re.sub("^ does ", " do ", text))
            check = replace(check, name="servos", sentence=f"{who}{text}")
        yield check


def explain(
    seen: ServosOnBus, ids: Mapping[str, int], counters: Mapping[int, ReplyCounter]
) -> tuple[str, ...]:
    """What is wrong with the servos of an arm in use, whose ``ids`` are by joint."""
    # Beside a whole arm other servos are wheels, a head or another arm's.
    servos = replace(chain_check.judged(seen, ids), unexpected_ids=())
    wrong = [
        f"{each.sentence}; {each.fix}" for each in check_servos(servos) if each.verdict != "ok"
    ]
    names = {i: joint for joint, i in ids.items()}
    answering = {i: each for i, each in counters.items() if i in names and i in seen.servos}
    return (*wrong, *_losses(answering, names))


def label(servo_id: int, names: Mapping[int, str]) -> str:
    """The name of a servo in a message; ``names`` has the joint of each, by id."""
    name = names.get(servo_id)
    return f"servo {servo_id}" + (f" ({name})" if name else "")


def _losses(counters: Mapping[int, ReplyCounter], names: Mapping[int, str]) -> Iterator[str]:
    """What is wrong with the answers since the port was opened."""
    lost = {
        i: share for i, each in counters.items() if (share := lossy_share(each.lost, each.asked))
    }
    is_everyone = len(counters) > 1 and lost.keys() == counters.keys()
    for servo_id, counter in counters.items():
        if garbled := lossy_share(counter.corrupt, counter.asked):
            yield (
                f"{label(servo_id, names)}: {100 * garbled:.1f} % of its answers are garbled: a"
                " loose cable, a brown-out, or another servo with the same id"
            )
        if servo_id in lost and not is_everyone:
            yield (
                f"{label(servo_id, names)}: {100 * lost[servo_id]:.1f} % of the questions to it got"
                " no answer: a loose cable"
            )
    asked = sum(counter.asked for counter in counters.values())
    if late := lossy_share(sum(counter.late for counter in counters.values()), asked):
        yield (
            f"{100 * late:.1f} % of the answers came late, none of them is lost: set the adapter's"
            " latency timer to 1 ms, and use neither a hub nor a virtual machine"
        )
    if is_everyone:
        yield (
            f"{100 * min(lost.values()):.1f} % of the questions got no answer, with every servo:"
            " this computer is too busy, or the first cable is loose"
        )


def is_healthy(checks: Iterable[Check]) -> bool:
    return all(check.verdict != "fail" for check in checks)


def _software(seen: Findings) -> Iterator[Check]:
    missing = [name for name, version in seen.software.items() if not version]
    if missing:
        yield fail("software", f"{', '.join(missing)} missing", "install so101-motion again")
    elif seen.software:
        shown = ("so101-motion", "Python", "platform")  # the report has all
        yield ok("software", ", ".join(f"{name} {seen.software.get(name, '')}" for name in shown))


def check_port(seen: Findings) -> Iterator[Check]:
    for adapter in seen.lost_adapters:
        sentence, _, fix = adapter.partition(": ")
        yield fail("adapter", sentence, fix)
    if seen.port is None:
        if seen.port_trouble:
            yield fail("port", seen.port_trouble, _PLUG_IN)
        return
    if seen.port_trouble:
        reason, _, fix = seen.port_trouble.partition("; ")
        yield fail("port", f"{seen.port} cannot be used: {reason}", fix or "so101 ports lists them")
        return
    yield ok("port", f"{seen.port} ({seen.adapter or 'no USB'})")
    for name, harm in seen.interfering_programs.items():
        yield warn(name, harm, "so101 install-udev")
    if seen.supply_trouble and seen.servos is None:
        sentence, fix = seen.supply_trouble
        yield warn("supply", f"the first servo: {sentence}", fix)


def _planner(seen: Findings) -> Iterator[Check]:
    if seen.planning_trouble:
        fix = "install so101-motion again; if that does not help, report it"
        yield fail("planner", seen.planning_trouble, fix)
    elif seen.planning_time is not None:
        text = f"a motion takes {1e3 * seen.planning_time:.0f} ms to plan"
        yield ok("planner", text)


WEAK_12_V = 10.5  # chosen; 12 V servos are slow below it
_PLUG_IN = "plug the adapter in, switch the arm's power supply on, or name the port with --port"


def _servos(seen: Findings) -> Iterator[Check]:
    if seen.servos is None:
        return
    if seen.baudrate != BAUDRATE:
        yield fail(
            "baud rate",
            f"the servos talk at {seen.baudrate} baud, not at {BAUDRATE}; their supply is on",
            f'{REPAIR} sets {BAUDRATE}; or give their components "baudrate": {seen.baudrate}',
        )
    if seen.servos.misplaced:
        yield fail("servos", seen.servos.misplaced, NEW_IDS)
        if seen.servos.unexpected_ids:
            return  # then none can be told by its id
    wrong = [check for check in seen.servos.motors.values() if check.error]
    is_silent = wrong and all(check.status == "not_responding" for check in wrong)
    if is_silent and not seen.facts:
        yield fail("servos", seen.servos.sentence, wrong[0].fix)
        return
    for check in wrong:
        name = f"servo {check.servo_id}"
        if check.status == "not_responding" and check.joint == GRIPPER_JOINT and _has_no_jaw(seen):
            yield warn(name, f"{check.error}: the arm moves without its jaw", check.fix)
        elif check.status == "wrong_voltage" and check.facts and not check.facts.has_harmful_supply:
            yield warn(name, check.error, check.fix)
        elif check.status != "wrong_settings":
            hint = f" (so101 setup --joint {check.joint})" if check.status == "duplicate" else ""
            yield fail(name, check.error, check.fix + hint)
    for joint, facts in seen.facts.items():
        yield from _settings(joint, facts, seen.stored)
    if seen.servos.unexpected_ids:
        ids = ", ".join(map(str, seen.servos.unexpected_ids))
        yield warn(
            "servos",
            f"servos with ids that are not an arm's answer: {ids}; they are left alone",
            "nothing, if they are wheels, a head or of another arm; else so101 setup",
        )
    elif not (wrong or seen.servos.misplaced):
        models = ", ".join({facts.model for facts in seen.facts.values()})
        text = f"all six answer ({models})" if models else "all six answer"  # a machine tells less
        yield ok("servos", text)


def _settings(joint: str, facts: ServoFacts, stored: Stored | None) -> Iterator[Check]:
    """Check the settings of a servo, which may turn the other way if its calibration says so."""
    name, who = f"servo {facts.servo_id}", f"servo {facts.servo_id} ({joint})"
    filed = stored.calibration.get(joint) if stored is not None else None
    counts_down = facts.counts_down or (filed is not None and filed.drive_mode != 0)
    for odd in replace(facts, counts_down=counts_down).odd_settings:
        verdict: Verdict = "fail" if odd.forbids else "warn"
        yield Check(name=name, verdict=verdict, sentence=f"{who}: {odd.sentence}", fix=odd.fix)
    if facts.model_note:
        yield warn(name, f"{who} {facts.model_note}", "nothing needs to be done")
    if facts.holds(reg.TORQUE_ENABLE) == 1 and facts.holds(reg.TORQUE_LIMIT) == 0:
        text = f"{who}: is driven but its torque limit is 0, so it ignores its goal"
        yield fail(name, text, "reinitialize it")
    if abs(offset := facts.holds(reg.HOMING_OFFSET)) > LARGEST_OFFSET:
        text = f"{who}: its homing offset {offset} is beyond {LARGEST_OFFSET}"
        yield fail(name, text, "calibrate again")
    if not 0 <= (position := facts.holds(reg.PRESENT_POSITION)) < reg.TICKS_PER_TURN:
        text = f"{who}: reports position {position}, outside 0 to {reg.TICKS_PER_TURN - 1}"
        yield fail(name, text, "calibrate again")


def _has_no_jaw(seen: Findings) -> bool:
    known = seen.stored is not None and GRIPPER_JOINT in seen.stored.calibration
    return not known and all(joint in seen.facts for joint in ARM_JOINTS)


def _firmware(seen: Findings) -> Iterator[Check]:
    versions = {joint: facts.firmware for joint, facts in seen.facts.items()}
    if len(set(versions.values())) > 1:
        text = ", ".join(f"{joint} {version}" for joint, version in versions.items())
        yield warn(
            "firmware",
            f"different versions: {text}",
            "harmless; the manufacturer's program FD (Windows) updates them",
        )
    elif versions:
        yield ok("firmware", next(iter(versions.values())))


def _supply(seen: Findings) -> Iterator[Check]:
    volts = [facts.volts for facts in seen.facts.values()]
    if not volts:
        return
    trouble = sag(volts)
    if trouble is not None:
        yield warn("supply", trouble.sentence, trouble.fix)
        return
    if any(facts.supply_trouble for facts in seen.facts.values()):
        return  # the servos' own check tells
    kind = next(iter(seen.facts.values())).nominal_volts
    text = f"{volts[0]:.1f} V at the first servo, {volts[-1]:.1f} V at the last, {kind:g} V type"
    is_weak = kind == 12.0 and min(volts) < WEAK_12_V
    yield warn("supply", text, "use a supply of 12 V") if is_weak else ok("supply", text)


def _temperature(seen: Findings) -> Iterator[Check]:
    celsius = {joint: facts.holds(reg.PRESENT_TEMPERATURE) for joint, facts in seen.facts.items()}
    if not celsius:
        return
    joint, hottest = max(celsius.items(), key=lambda item: item[1])
    text = f"{min(celsius.values())} to {hottest} °C, {joint} is the warmest"
    for trouble in seen.facts[joint].troubles:
        if trouble.kind == "temperature":
            verdict: Verdict = "fail" if trouble.level == "stop" else "warn"
            yield Check(name="temperature", verdict=verdict, sentence=text, fix=trouble.fix)
            return
    yield ok("temperature", text)


def _faults(seen: Findings) -> Iterator[Check]:
    found = [
        fail("fault", f"{joint}: {one.sentence}", one.fix)
        for joint, facts in seen.facts.items()
        for one in facts.troubles
        if one.kind in ("load", "fault")
    ]
    yield from found
    if seen.facts and not found:
        held = [joint for joint, facts in seen.facts.items() if facts.holds(reg.TORQUE_ENABLE)]
        limp = [joint for joint in seen.facts if joint not in held]
        text = f"held: {', '.join(held)}" if held and limp else "held" if held else "limp"
        if 0 < len(limp) < len(held):
            yield warn(
                TORQUE,
                f"{in_series(limp)} {'is' if len(limp) == 1 else 'are'} limp, the others hold",
                f"support the arm and check the cable of {in_series(limp)}: a servo that lost its"
                " power is limp afterwards; then let the arm hold again (so101 jog does)",
            )
        else:
            yield ok("faults", f"none reported; the joints are {text}")


def _bus_quality(seen: Findings) -> Iterator[Check]:
    heard = seen.bus_quality
    if heard is None:
        return
    spoiled = (heard.lost + heard.corrupt) / heard.asked
    text = (
        f"of {heard.asked} answers {heard.late} were late, {heard.lost} lost, {heard.corrupt}"
        f" garbled; all servos in {1e3 * heard.median:.1f} ms, 99 % within"
        f" {1e3 * heard.p99:.1f} ms"
    )
    is_late = heard.lateness > _LATE or heard.late > LOSSY * heard.asked
    if heard.lateness > _LATE:
        text = f"answers come {1e3 * heard.lateness:.0f} ms late; {text}"
    if spoiled <= BROKEN and (heard.median > 0.8 * _PERIOD or is_late):
        if heard.median > _SLOWEST:
            yield fail("bus", f"{text}: too slow to move", _sooner(seen))
            return
        if heard.median > 0.8 * _PERIOD:
            text += "; setpoints go out less often, and a stop begins that much later"
        yield Check(name="bus", verdict="warn", sentence=text, fix=_sooner(seen))
    elif spoiled > LOSSY:
        yield Check(
            name="bus",
            verdict="fail" if spoiled > BROKEN else "warn",
            sentence=text,
            fix="look for a loose cable, a weak supply, or a servo whose id another has too",
        )
    else:
        yield ok("bus", text)


def _sooner(seen: Findings) -> str:
    if seen.latency_timer is not None and seen.latency_timer > 0.002:
        device = os.path.basename(os.path.realpath(seen.port or ""))
        return (
            f"its adapter holds bytes back for {1e3 * seen.latency_timer:.0f} ms: set the latency"
            f" timer to 1 ms: echo 1 | sudo tee /sys/bus/usb-serial/devices/{device}/latency_timer"
        )
    return (
        "plug the adapter into this computer directly, without a hub, virtual machine or network"
        " between, and end what keeps the computer busy; on Linux, set the latency timer of an FTDI"
        " adapter to 1 ms"
    )


def _calibration(seen: Findings) -> Iterator[Check]:
    if seen.is_unfinished:
        yield warn(
            "calibration",
            f"a calibration to {seen.file} was interrupted",
            "so101 calibrate ends it properly; so does opening the arm with that file",
        )
    if seen.file_trouble:
        fix = f"so101 calibration restore {seen.file}, or so101 calibrate"
        yield fail("calibration", seen.file_trouble, fix)
    elif seen.stored is not None:
        yield from _against_servos(seen, seen.stored)
    elif seen.agreeing_file is not None:
        yield warn(
            "calibration",
            f"{seen.agreeing_file} agrees with the servos in every number, but is not in use here",
            f"so101 calibration import {seen.agreeing_file} takes it over",
        )
    elif seen.facts and not any(facts.is_calibrated for facts in seen.facts.values()):
        yield fail("calibration", "there is none", "so101 calibrate")
    elif seen.facts:
        yield warn(
            "calibration",
            "there is no file, so the values in the servos are used",
            "so101 calibrate, or so101 calibration import if there is a file of this arm",
        )


def _against_servos(seen: Findings, stored: Stored) -> Iterator[Check]:
    missing = [joint for joint in SERVO_IDS if joint not in stored.calibration]
    if missing:
        lacks = "has impossible numbers of, or lacks," if stored.refused else "lacks"
        yield fail(
            "calibration",
            f"{stored.path} {lacks} {', '.join(missing)}",
            f"so101 calibrate --joint {missing[0]}",
        )
    there = {joint: facts.calibration for joint, facts in seen.facts.items()}
    differing = [row for row in compare.diff(stored.calibration, there) if row.differs]
    if differing:
        first, *more = differing
        count = "1 more number differs" if len(more) == 1 else f"{len(more)} more numbers differ"
        others = f"; {count}" if more else ""
        yield warn(
            "calibration",
            f"{first.sentence}{others}",
            "if this is the file of another arm, name this arm's; else so101 calibration write"
            f" {stored.path} stores it in the servos",
        )
    if not differing and not missing:
        text = f"{stored.path}" + (", as the servos have it" if there else "")
        yield ok("calibration", text)


def _servo_changes(seen: Findings) -> Iterator[Check]:
    for change in seen.servo_changes:
        fix = "look at the joint's screws and cable, then so101 identify again"
        yield warn("servos", change, fix)


def _zeros(seen: Findings) -> Iterator[Check]:
    *each, together = seen.zero_reports or (None,)
    if together is None:
        return
    knows_nothing = together.by == "middle"
    guessed = [m.joint for m in each if m.by == "middle" and m.joint != "wrist_roll"]
    for meaning in each if guessed and not knows_nothing else ():  # else all joints are alike
        is_guess = meaning.joint in guessed
        yield Check(
            name=f"zero of {meaning.joint}",
            verdict="warn" if is_guess else "ok",
            sentence=meaning.sentence,
            fix=f"so101 calibrate --joint {meaning.joint}, from stop to stop" if is_guess else "",
        )
    yield Check(
        name="zeros",
        verdict="warn" if knows_nothing else "ok",
        sentence=together.sentence,
        fix="so101 calibrate, every joint from stop to stop" if knows_nothing else "",
    )


def _speed(seen: Findings) -> Iterator[Check]:
    if seen.speed is None or seen.acceleration is None:
        return
    planned_deg = to_deg(seen.speed)
    text = f"plans use {planned_deg:.0f} deg/s, {to_deg(seen.acceleration):.0f} deg/s^2"
    weakest = min(seen.facts.values(), key=_free_speed, default=None)
    if weakest is None:
        yield ok("speed", text)
        return
    usable_deg = to_deg(_USABLE * _free_speed(weakest))
    text += f"; these servos manage about {usable_deg:.0f} deg/s at {weakest.volts:.1f} V"
    fix = "use a stronger supply, or a lower speed_degs_per_sec"
    if usable_deg < planned_deg:
        yield fail("speed", text, fix)
    elif usable_deg < SPEED_RANGE_DEG[1]:
        most = f"; more than {usable_deg:.0f} deg/s must not be asked of them"
        yield warn("speed", text + most, fix)
    else:
        yield ok("speed", text)


def _free_speed(facts: ServoFacts) -> float:
    return _FREE_SPEED[facts.nominal_volts] * facts.volts / facts.nominal_volts


_OF_SERVOS: tuple[Callable[[Findings], Iterator[Check]], ...] = (
    _servos,
    _firmware,
    _supply,
    _temperature,
    _faults,
)

_CHECKS = (
    _software,
    _planner,
    check_port,
    *_OF_SERVOS,
    _bus_quality,
    _calibration,
    _zeros,
    _servo_changes,
    _speed,
)
