"""Report what was found on a port, and suggest components to configure for it.

Suggestions have the published module's names and form, with these differences. A gripper gets a
port of its own, as in that module's documentation, so that it works whatever the arm's name. The
calibration sensor always gets a file of its own, so that two arms on one machine do not write to
the same one; the file need not exist before the first calibration. An arm and a gripper get a
frame, because a motion service needs their positions. Parts that are configured already are not
suggested again.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from so101_motion.calib.motors.arm_identification import Role
from so101_motion.calib.record import store
from so101_motion.common.errors import CalibrationError
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.drivers.bus.defaults import BAUDRATE
from so101_motion.drivers.port.port_list import FoundPort

PART_BY_MODEL = {
    "devrel:so101:arm": "arm",
    "devrel:so101:gripper": "gripper",
    "devrel:so101:calibration": "calibration",
}
"""The part of an arm that each model is for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """The frame of a suggested component."""

    parent: str  # name of the frame that it is in
    y: float = 0.0  # how far to the left of that frame [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class Suggestion:
    """A component or service that could be configured."""

    name: str
    api: str  # its API, such as ``"rdk:component:arm"``
    model: str  # its model, such as ``"devrel:so101:arm"``
    attributes: Mapping[str, object]
    frame: Frame | None = None  # its frame; None if it has none


@dataclass(frozen=True, slots=True, kw_only=True)
class PortReport:
    """What was found on a port.

    Attributes:
        configured: The parts that components of this process have on the port: ``"arm"``,
            ``"gripper"``, ``"calibration"``.
        supply_trouble: What is wrong with the supply and what to do; None if nothing is.
        agreeing: Another program's file that agrees with its servos in every number, if there is no
            such file.
    """

    port: FoundPort
    sentence: str
    joints: tuple[str, ...] = ()
    servo_ids: tuple[int, ...] = ()
    baudrate: int = BAUDRATE  # the bus's rate [bit/s]
    configured: frozenset[str] = frozenset()
    arm_name: str = ""  # name of the arm on the port; empty to suggest one
    stands_at: float = 0.0  # suggested position of the arm, to the left of the first one [m]
    volts: float | None = None  # supply of the first servo [V]; None if none answers
    nominal_volts: float | None = None  # its rated supply [V]: 7.4 or 12; None if none answers
    supply_trouble: tuple[str, str] | None = None
    role: Role = "unknown"
    because: str = ""
    calibration: Path | None = None  # the calibration file to configure; None if there is none
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
        return tuple(one for one in found if PART_BY_MODEL[one.model] not in self.configured)


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
        yield Suggestion(
            name=arm_name,
            api="rdk:component:arm",
            model="devrel:so101:arm",
            attributes=shared,
            frame=Frame(parent="world", y=report.stands_at),
        )
    if report.has_arm and GRIPPER_JOINT in report.joints:
        kind = {"gripper_type": "leader"} if report.role == "leader" else {}
        yield Suggestion(
            name=f"so101-gripper-{key}",
            api="rdk:component:gripper",
            model="devrel:so101:gripper",
            attributes={**shared, **kind},
            frame=Frame(parent=arm_name),
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
