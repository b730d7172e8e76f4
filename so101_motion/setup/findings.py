"""Measure an arm's servos and bus, and hold all findings for the check-up.

``examine`` reads the servos and writes nothing; the caller fills in the port and the file.
``checkup.py`` judges all of it.
"""

from __future__ import annotations

import contextlib
import platform
import re
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path

import numpy as np

from so101_motion.calib.access import BusAccess
from so101_motion.calib.motors import chain_check
from so101_motion.calib.motors.arm_identification import ServoFacts
from so101_motion.calib.motors.servo_search import Tuner
from so101_motion.calib.motors.setup_view import Verification
from so101_motion.calib.record.store import Stored
from so101_motion.calib.record.zero_report import ZeroReport
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.defaults import BAUDRATE
from so101_motion.drivers.feetech.health import VITALS_COUNT, VITALS_START
from so101_motion.planning.native.library import native

CYCLES = 200
"""How often all servos are read to judge the bus; takes half a second. Chosen."""


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
    """The findings about an arm; unknown ones are None or empty.

    Attributes:
        software: Versions of this package and others, by name; empty text for missing ones.
        supply_trouble: What is wrong with the supply of the first servo and what to do about it, as
            long as not all servos were looked at.
        agreeing_file: Another program's file that agrees with the servos, if there is no ``file``.
        servo_changes: How servos have changed between the last two identifications.
        acceleration: Joint acceleration cap of plans [rad/s^2]; None when nothing can be moved.
    """

    software: Mapping[str, str] = field(default_factory=dict)
    port: str | None = None  # the serial port; None for the simulated arm
    baudrate: int = BAUDRATE  # the rate at which its servos answer [bit/s]
    adapter: str = ""
    port_trouble: str = ""
    interfering_programs: Mapping[str, str] = field(default_factory=dict)
    lost_adapters: tuple[str, ...] = ()
    supply_trouble: tuple[str, str] | None = None
    latency_timer: float | None = None  # how long the adapter holds bytes back [s]
    servos: Verification | None = None
    bus_quality: BusQuality | None = None
    file: Path | None = None  # the calibration file; None when there is none
    agreeing_file: Path | None = None
    stored: Stored | None = None  # its content; None when it cannot be used
    file_trouble: str = ""
    is_unfinished: bool = False
    zero_reports: tuple[ZeroReport, ...] = ()
    servo_changes: tuple[str, ...] = ()
    speed: float | None = None  # joint speed cap of plans [rad/s]; None when nothing can be moved
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
