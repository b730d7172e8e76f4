"""Find the arms that are plugged in, and suggest a configuration for each.

Every port is checked in a thread of its own, so that one that hangs or fails hides no other. A port
that is in use, here or by another program, is not opened. Servos are only read.

An arm is suggested if all five of its servos answer, a gripper if its servo does as well, in the
published module's names and form. Names are made from the adapter's serial number and ports have
their lasting names, so that a configuration still fits when adapters are plugged in differently. A
gripper gets a port of its own, so that it works whatever the arm's name; the calibration sensor
gets a file of its own, so that two arms do not write to the same one.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from so101_motion.calib.motors import arm_identification
from so101_motion.calib.motors.arm_identification import Role, ServosOnBus
from so101_motion.calib.motors.setup_view import AS_NEW
from so101_motion.calib.motors.single_servo import LIKELIEST_FIRST
from so101_motion.calib.record import file_search, store
from so101_motion.calib.record.file_search import FoundFile
from so101_motion.calib.record.record import SERVO_IDS
from so101_motion.common.errors import BusError, CalibrationError
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_mm
from so101_motion.drivers.bus.bus import REPLY_TIMEOUT, Bus
from so101_motion.drivers.bus.defaults import BAUDRATE
from so101_motion.drivers.port.port_list import (
    FoundPort,
    adapters_without_port,
    find_ports,
    port_problem,
)
from so101_motion.drivers.port.serial_port import SerialPort
from so101_motion.rig import hardware_rig
from so101_motion.rig.port_settings import ServoSettings
from so101_motion.rig.shared_port import SharedPort


@dataclass(frozen=True, slots=True, kw_only=True)
class Suggestion:
    """A component or service that could be configured."""

    name: str
    api: str  # its API, such as ``"rdk:component:arm"``
    model: str  # its model, such as ``"devrel:so101:arm"``
    attributes: Mapping[str, object]
    frame: Mapping[str, object] | None = None  # as in a configuration [mm]; None if it has none

    def to_json(self) -> dict[str, Any]:
        """Its entry in a machine's configuration."""
        return {key: value for key, value in asdict(self).items() if value is not None}


@dataclass(frozen=True, slots=True, kw_only=True)
class PortReport:
    """What was found on a port."""

    port: FoundPort
    sentence: str
    joints: tuple[str, ...] = ()
    servo_ids: tuple[int, ...] = ()
    baudrate: int = BAUDRATE  # the bus's rate [bit/s]
    # the parts that components of this process have on the port: ``"arm"``, ``"gripper"``,
    # ``"calibration"``
    configured: frozenset[str] = frozenset()
    arm_name: str = ""  # name of the arm on the port; empty to suggest one
    stands_at: float = 0.0  # suggested position of the arm, to the left of the first one [m]
    volts: float | None = None  # supply of the first servo [V]; None if none answers
    nominal_volts: float | None = None  # its rated supply [V]: 7.4 or 12; None if none answers
    # what is wrong with the supply and what to do; None if nothing is
    supply_trouble: tuple[str, str] | None = None
    role: Role = "unknown"
    because: str = ""
    calibration: Path | None = None  # the calibration file to configure; None if there is none
    # another program's file that agrees with its servos in every number, if there is no such file
    agreeing: Path | None = None

    @property
    def in_use(self) -> bool:
        return bool(self.configured)

    @property
    def has_arm(self) -> bool:
        return all(joint in self.joints for joint in ARM_JOINTS)

    def to_json(self) -> dict[str, Any]:
        port = self.port
        return {
            "port": port.name,
            "device": port.device,
            "aliases": list(port.aliases),
            "adapter": port.description,
            "serial_number": port.serial_number,
            "is_servo_adapter": port.is_servo_adapter,
            "found": self.sentence,
            "in_use": self.in_use,
            "has_arm": self.has_arm,
            "joints": list(self.joints),
            "servo_ids": list(self.servo_ids),
            "baudrate": self.baudrate,
            "role": self.role,
            "role_because": self.because,
            "calibration_file": None if self.calibration is None else str(self.calibration),
        }

    @property
    def suggestions(self) -> tuple[Suggestion, ...]:
        found = _suggest(self)
        return tuple(one for one in found if one.model.split(":")[-1] not in self.configured)


def _suggest(report: PortReport) -> Iterator[Suggestion]:
    if not report.servo_ids and not report.joints:
        return
    key = report.port.key
    base: dict[str, object] = {"port": report.port.name}
    if report.baudrate != BAUDRATE:
        base["baudrate"] = report.baudrate
    name = None
    if report.calibration is not None:
        name = name_in_data(report.calibration) or str(report.calibration)
    shared = base if name is None else {**base, "calibration_file": name}
    arm_name = report.arm_name or f"so101-arm-{key}"
    if report.has_arm:
        frame: dict[str, object] = {"parent": "world"}
        if report.stands_at:
            frame["translation"] = {"x": 0.0, "y": to_mm(report.stands_at), "z": 0.0}
        yield Suggestion(
            name=arm_name,
            api="rdk:component:arm",
            model="devrel:so101:arm",
            attributes=shared,
            frame=frame,
        )
    if report.has_arm and GRIPPER_JOINT in report.joints:
        kind = {"gripper_type": "leader"} if report.role == "leader" else {}
        yield Suggestion(
            name=f"so101-gripper-{key}",
            api="rdk:component:gripper",
            model="devrel:so101:gripper",
            attributes={**shared, **kind},
            frame={"parent": arm_name},
        )
    yield Suggestion(
        name=f"so101-calibration-{key}",
        api="rdk:component:sensor",
        model="devrel:so101:calibration",
        attributes={**base, "calibration_file": name or file_name(report.port)},
    )


def file_name(port: FoundPort) -> str:
    """The calibration file's name for a port; the published module uses the same."""
    return f"{port.key}_calibration.json"


def name_in_data(file: Path) -> str | None:
    """The name in a configuration of a file in the module's data directory.

    None for any other file, which needs its full path, and if there is no such directory: on the
    command line a plain name means a file in the working directory.
    """
    if not os.environ.get("VIAM_MODULE_DATA"):
        return None
    try:
        return file.name if store.resolve(file.name) == file else None
    except CalibrationError:
        return None


_log = logging.getLogger(__name__)

OpenBus = Callable[[str, int], Bus]

APART = 0.5
"""Distance between arms in the suggested frames [m]; chosen, so that two arms are not in the same
place. Their real positions have to be measured."""

LONGEST = 8.0
"""Time limit for all ports together [s]. An arm takes 0.3 s, an adapter without servos 0.6 s, a
port that hangs all of it. Chosen: a computer with ten programs for each processor took 2.4 s for an
arm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Discovery:
    """The reports of all ports."""

    reports: tuple[PortReport, ...]
    notes: tuple[str, ...]


def discover(
    extra: Collection[str] = (),
    *,
    find: Callable[[Collection[str]], Sequence[FoundPort]] = find_ports,
    reply_timeout: float = REPLY_TIMEOUT,
) -> Discovery:
    """Look at all ports; takes less than a second, unless one hangs or the computer is busy."""

    def open_bus(name: str, baud: int) -> Bus:
        return Bus(SerialPort(name, baud), reply_timeout=reply_timeout)

    ports, files = find(extra), file_search.find()

    def look(port: FoundPort) -> PortReport:
        is_meant = port.is_servo_adapter or port.name in extra
        return _look_at(port, files, open_bus, at_all_rates=is_meant)

    reports = in_parallel(ports, look)
    arms = [report for report in reports if report.has_arm]
    for place, report in enumerate(arms):
        reports[reports.index(report)] = replace(report, stands_at=APART * place)
    notes = list(adapters_without_port())
    if len(arms) > 1:
        notes.append(
            f"where the arms stand is not known: their frames are {to_mm(APART):.0f} mm apart; set"
            " the frame of each arm to where it stands"
        )
    if not ports and not notes:
        notes.append(
            "no USB serial adapter is plugged in; check the cable, some only carry power. To use a"
            " port that is no USB adapter, name it (--port)"
        )
    return Discovery(reports=tuple(reports), notes=tuple(notes))


def in_parallel(
    ports: Sequence[FoundPort],
    look: Callable[[FoundPort], PortReport],
    longest: float = LONGEST,
) -> list[PortReport]:
    """Run ``look`` for each port in parallel; one that takes over ``longest`` [s] is reported."""
    found: dict[FoundPort, PortReport] = {}

    def run(port: FoundPort) -> None:
        found[port] = look(port)

    threads = [
        threading.Thread(target=run, args=(port,), name=f"so101-look-{port.key}", daemon=True)
        for port in ports
    ]
    for thread in threads:
        thread.start()
    until = time.monotonic() + longest
    for thread in threads:
        thread.join(max(0.0, until - time.monotonic()))
    late = (
        f"its driver takes longer than {longest:g} s to answer; if this computer is not very busy,"
        " unplug it and plug it in again"
    )
    return [found.get(port, PortReport(port=port, sentence=late)) for port in ports]


# One port


def _look_at(
    port: FoundPort, files: Sequence[FoundFile], open_bus: OpenBus, *, at_all_rates: bool
) -> PortReport:
    use = hardware_rig.use_of(port.name)
    if use is not None:
        return _report_use(port, use)
    reason = port_problem(port.name)
    if reason is not None:
        return PortReport(port=port, sentence=reason)
    try:
        return _judge(port, _ask(port, open_bus, at_all_rates=at_all_rates), files)
    except BusError as error:
        _log.debug("%s: %s", port.name, error)
        return PortReport(port=port, sentence=getattr(error, "reason", str(error)))


def _report_use(port: FoundPort, use: SharedPort) -> PortReport:
    joints, settings = tuple(use.servos.setups), use.servos.settings
    return PortReport(
        port=port,
        sentence=f"used by a component of this machine, with {_counted(joints)}",
        joints=joints,
        servo_ids=tuple(settings.ids()[joint] for joint in joints),
        baudrate=settings.baudrate,
        configured=_configured(tuple(use.shares)),
        calibration=settings.file,
    )


def _configured(shares: Iterable[ServoSettings]) -> frozenset[str]:
    parts = set()
    for asked in shares:
        if asked.servo_ids is not None:
            parts.add("arm")
        if asked.gripper_id is not None:
            parts.add("gripper")
        if not asked.required():
            parts.add("calibration")
    return frozenset(parts)


def _ask(port: FoundPort, open_bus: OpenBus, *, at_all_rates: bool) -> ServosOnBus:
    with closing(open_bus(port.name, BAUDRATE)) as bus:
        seen = arm_identification.look(bus)
    if not seen.is_empty or not at_all_rates:
        return seen
    for baud in LIKELIEST_FIRST:
        if baud == BAUDRATE:
            continue
        with closing(open_bus(port.name, baud)) as bus:
            if bus.answering(SERVO_IDS.values(), tries=2):
                return arm_identification.look(bus)
    return seen


def _judge(port: FoundPort, seen: ServosOnBus, files: Sequence[FoundFile]) -> PortReport:
    report = PortReport(
        port=port,
        sentence="",
        joints=tuple(joint for joint, i in SERVO_IDS.items() if seen.has(i)),
        servo_ids=tuple(sorted((*seen.servos, *seen.shared))),
        baudrate=seen.baud,
    )
    if seen.servos:
        first = seen.servos[min(seen.servos)]
        report = replace(
            report,
            volts=first.volts,
            nominal_volts=first.nominal_volts,
            supply_trouble=first.supply_trouble,
        )
    fitting = [found for found in files if arm_identification.fits(seen, found)]
    file, about_file = _calibration(port, seen, files, fitting)
    if not seen.has_arm:  # perhaps only a loose plug
        return replace(report, calibration=file, sentence=_about_no_arm(seen))
    role, because = arm_identification.role(seen, fitting)
    # of other programs; LeRobot's own folders first
    ranked = sorted(fitting, key=lambda found: found.origin != "LeRobot")
    agreeing = ranked[0].path if ranked else None
    return replace(
        report,
        role=role,
        because=because,
        calibration=file,
        agreeing=agreeing if file is None else None,
        sentence=f"{_about_arm(seen, role, report.joints)}; {about_file}",
    )


def _calibration(
    port: FoundPort, seen: ServosOnBus, files: Sequence[FoundFile], fitting: Sequence[FoundFile]
) -> tuple[Path | None, str]:
    """Choose the calibration file to configure, with a sentence about it.

    It is one that agrees with the servos; else one with this adapter's name. Only files of this
    module are configured: the calibration sensor will write to them, and LeRobot does not read
    files of other programs.
    """
    own = [found for found in fitting if _is_own(found)]
    if own:
        return _place(own[0]), f"its servos agree with {_place(own[0])}"
    for found in files:
        place = _place(found)
        if found.stored is not None and _is_own(found) and place.name == file_name(port):
            return place, f"{place} is its calibration file, though its servos hold something else"
    if fitting:
        return None, f"its servos agree with {fitting[0].path}"
    if any(seen.servos[i].is_calibrated for i in SERVO_IDS.values() if i in seen.servos):
        return None, "its servos are calibrated, but no calibration file was found"
    return None, "it is not calibrated"


def _is_own(found: FoundFile) -> bool:
    return found.origin == "saved" or name_in_data(_place(found)) is not None


def _place(found: FoundFile) -> Path:
    """The path of the file; of a kept copy, that of the file that is gone."""
    return Path(found.name) if found.origin == "kept copy" else found.path


# Sentences


def _about_no_arm(seen: ServosOnBus) -> str:
    if seen.is_empty:
        return (
            "the adapter is connected, but no servo answers; check that the arm's power supply is"
            " on and that the first cable is plugged in"
        )
    others = [facts for facts in seen.servos.values() if not facts.fits_arm]
    if others:
        return f"servo {others[0].servo_id} is a {others[0].model}, no servo of an SO-101"
    if set(seen.servos) == {AS_NEW} and not seen.shared and not seen.garbled:
        return "one new motor answers: the setup gives it its id"
    if seen.shared and set(seen.shared) | set(seen.servos) == {AS_NEW}:
        return "several new motors answer, all with the id 1: connect only one of them"
    ids = ", ".join(map(str, sorted((*seen.servos, *seen.shared)))) or "none"
    shared = ", and several share an id" if seen.shared or seen.garbled else ""
    return (
        f"no complete arm: the servos that answer have the ids {ids}{shared}. Check the cables, or"
        " set up the motors"
    )


def _about_arm(seen: ServosOnBus, role: Role, joints: Sequence[str]) -> str:
    kind = {"follower": "a follower arm", "leader": "a leader arm"}.get(role, "an arm")
    first = seen.servos[SERVO_IDS[ARM_JOINTS[0]]]
    rate = "" if seen.baud == BAUDRATE else f", at {seen.baud} baud"
    return f"{kind} with {_counted(joints)}, {first.nominal_volts:g} V type{rate}"


def _counted(joints: Sequence[str]) -> str:
    arm = sum(joint in ARM_JOINTS for joint in joints)
    return f"{arm} joints and {'a' if GRIPPER_JOINT in joints else 'no'} gripper"


def configuration(reports: Iterable[PortReport]) -> dict[str, list[Any]]:
    """The configuration of a machine with the suggested parts, ready to paste."""
    components = [one.to_json() for report in reports for one in report.suggestions]
    return {"components": components, "modules": own_module()}


def own_module() -> list[dict[str, str]]:
    """The "modules" entry of this installation; empty if viam-server cannot start it."""
    start = Path(__file__).resolve().parents[2] / "run.sh"
    if not start.is_file():
        return []
    return [{"type": "local", "name": "so101-motion", "executable_path": str(start)}]
