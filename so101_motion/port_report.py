"""What was found on a port, and what could be configured for it.

Suggestions have the published module's names and shape, with two differences. A gripper gets a port
of its own, as in that module's documentation, so that it works whatever the arm ends up being
called. And the calibration sensor always gets a file of its own, so that two arms on one machine
do not write to the same one.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from so101_motion.calib import store
from so101_motion.calib.recognise import Role
from so101_motion.drivers.ports import FoundPort
from so101_motion.errors import CalibrationError
from so101_motion.hardware_config import BAUDRATE
from so101_motion.state import ARM_JOINTS, GRIPPER_JOINT


@dataclass(frozen=True, slots=True, kw_only=True)
class Suggestion:
    """A resource that could be configured.

    Attributes:
        name: What to call it.
        api: Its API, such as ``"rdk:component:arm"``.
        model: Its model, such as ``"devrel:so101:arm"``.
        attributes: Its settings.
    """

    name: str
    api: str
    model: str
    attributes: Mapping[str, object]


@dataclass(frozen=True, slots=True, kw_only=True)
class PortReport:
    """What is on a port.

    Attributes:
        port: Which.
        sentence: What was found, or why nothing could be.
        joints: The joints whose servos answer, base to jaw.
        servo_ids: All servos that answer.
        baudrate: At which rate [bit/s].
        in_use: Whether a component of this process uses the port.
        volts: What the first servo is fed with [V]; None if none answers.
        nominal_volts: What it is made for [V]: 7.4 or 12; likewise.
        supply_trouble: What is wrong with that and what to do about it; None if nothing is.
        role: Whether the arm leads or follows.
        because: What shows it.
        calibration: The calibration file to configure; None if there is none.
    """

    port: FoundPort
    sentence: str
    joints: tuple[str, ...] = ()
    servo_ids: tuple[int, ...] = ()
    baudrate: int = BAUDRATE
    in_use: bool = False
    volts: float | None = None
    nominal_volts: float | None = None
    supply_trouble: tuple[str, str] | None = None
    role: Role = "unknown"
    because: str = ""
    calibration: Path | None = None

    @property
    def has_arm(self) -> bool:
        """Whether an arm can be configured."""
        return all(joint in self.joints for joint in ARM_JOINTS)

    @property
    def suggestions(self) -> tuple[Suggestion, ...]:
        """What could be configured, in the order to do it."""
        return tuple(_suggest(self))


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
    if report.has_arm:
        yield Suggestion(
            name=f"so101-arm-{key}",
            api="rdk:component:arm",
            model="devrel:so101:arm",
            attributes=shared,
        )
    if report.has_arm and GRIPPER_JOINT in report.joints:
        kind = {"gripper_type": "leader"} if report.role == "leader" else {}
        yield Suggestion(
            name=f"so101-gripper-{key}",
            api="rdk:component:gripper",
            model="devrel:so101:gripper",
            attributes={**shared, **kind},
        )
    yield Suggestion(
        name=f"so101-calibration-{key}",
        api="rdk:component:sensor",
        model="devrel:so101:calibration",
        attributes={**base, "calibration_file": name or file_name(report.port)},
    )


def file_name(port: FoundPort) -> str:
    """The calibration file of what is on a port; the published module's name for it."""
    return f"{port.key}_calibration.json"


def name_in_data(file: Path) -> str | None:
    """What a file in the module's data directory is called in a configuration.

    None for any other file, which has to be called by its path, and where there is no such
    directory: on the command line a name means what lies in the current one.
    """
    if not os.environ.get("VIAM_MODULE_DATA"):
        return None
    try:
        return file.name if store.resolve(file.name) == file else None
    except CalibrationError:
        return None
