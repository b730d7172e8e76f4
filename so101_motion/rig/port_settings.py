"""The settings that components ask of a serial port, and how they are combined."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from so101_motion.calib.procedure import journal
from so101_motion.common.errors import ConfigError
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_deg
from so101_motion.drivers.bus.defaults import BAUDRATE, GRIPPER_ID, SERVO_IDS, TIMEOUT

NO_FILE = (
    "no calibration file of this arm was found, so zero is the middle of each joint's travel and"
    " points are some 40 mm off; so101 calibrate makes one"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoSettings:
    """The settings that one or more components ask of a port.

    Attributes:
        port: The serial port as given.
        baudrate: Bits per second.
        timeout: How long silent servos are waited for at the start [s]; None from components that
            ask for no servo and do not care.
        servo_ids: The arm's servos, base to wrist; None when no arm is asked for.
        gripper_id: The jaw's servo; None when no gripper is asked for.
        calibration_file: None to ask the servos.
        zero_offsets: The model's angles in the middle of the joints' travels, of the arm joints for
            which they are configured [rad]; None when nothing is configured.
        joint_zero: The zero of joints of which the calibration and ``zero_offsets`` say nothing:
            ``"middle"`` of the travel or the pose of ``"homing"``; None for the first, and to be
            told where they differ.
        rate: Setpoints a second [1/s]; None from components that do not care.
        fallback_file: Where a calibration of this arm is saved unless a component names a file.
        at_end: How the arm is left when the process ends in order, one of ``session_end.ENDS``;
            None from components that do not care.
        compensates: Whether weight, friction and lag are compensated; None from components that do
            not care: they are compensated then.
        finds_file: Whether the saved calibration that agrees with the servos is used if none is
            named.
        goes_with_arm: Whether it is a gripper that names its arm; the arm's baudrate counts, and
            its own only when the arm has left.
    """

    port: str
    baudrate: int = BAUDRATE
    timeout: float | None = TIMEOUT
    servo_ids: tuple[int, ...] | None = None
    gripper_id: int | None = None
    calibration_file: Path | None = None
    zero_offsets: Mapping[str, float] | None = None
    joint_zero: str | None = None
    rate: float | None = None
    fallback_file: Path | None = None
    at_end: str | None = None
    compensates: bool | None = None
    finds_file: bool = False
    goes_with_arm: bool = False

    @property
    def file(self) -> Path | None:
        """The calibration file to use; None to use the servos' registers."""
        own = self.fallback_file
        if self.calibration_file is None and own is not None and journal.is_known(own):
            return own
        return self.calibration_file

    @property
    def may_file_be_missing(self) -> bool:
        """Whether the calibration file is one that the calibration sensor saves to."""
        return self.file is not None and self.file == self.fallback_file

    def with_arm(
        self, servo_ids: tuple[int, ...], zero_offsets: Mapping[str, float] | None = None
    ) -> ServoSettings:
        """These settings with an arm of these servos and zeros [rad]."""
        return replace(self, servo_ids=servo_ids, zero_offsets=zero_offsets)

    def with_gripper(self, gripper_id: int) -> ServoSettings:
        """The same with another id of the gripper's servo."""
        return replace(self, gripper_id=gripper_id)

    def ids(self) -> dict[str, int]:
        """The servo of each joint that may be there; ``ConfigError`` if one has two joints."""
        arm = self.servo_ids or SERVO_IDS
        ids = dict(zip(ARM_JOINTS, arm, strict=True))
        if self.gripper_id in arm:
            if self.servo_ids is not None:
                raise ConfigError(
                    "servo_id", self.gripper_id, f"belongs to the arm already: {list(arm)}"
                )
            ids = {joint: i for joint, i in ids.items() if i != self.gripper_id}
        return {**ids, GRIPPER_JOINT: self.gripper_id or GRIPPER_ID}

    def required(self) -> tuple[str, ...]:
        """The joints whose servos must answer."""
        return (ARM_JOINTS if self.servo_ids is not None else ()) + (
            (GRIPPER_JOINT,) if self.gripper_id is not None else ()
        )


def combined(shares: Sequence[ServoSettings]) -> ServoSettings:
    """Combine the settings of the components on a port, in the order in which they came.

    What only one of them gives holds for all. They must agree (``ConfigError`` names every setting
    that differs), except on these: the arm's calibration file counts, without one the first that is
    named, and the longest timeout. Any part of components that agree agrees as well, so components
    can always leave.
    """
    tied = [share for share in shares if not share.goes_with_arm] or shares[:1]
    given = {"baudrate": _different(share.baudrate for share in tied)}
    for name in _AGREED:
        given[name] = _different(getattr(share, name) for share in shares)
    differing = [
        f"{_ATTRIBUTES[name]} " + " and ".join(_plain(name, value) for value in values)
        for name, values in given.items()
        if len(values) > 1
    ]
    if differing:
        raise ConfigError(
            "port",
            shares[-1].port,
            "another component uses this port with other settings: "
            + "; ".join(differing)
            + ". Give both the same",
        )
    file = _first(share.calibration_file for share in _arms_first(shares))
    saved_to = [share.fallback_file for share in shares]
    joined = replace(
        shares[0],
        timeout=max((share.timeout for share in shares if share.timeout is not None), default=None),
        calibration_file=file,
        fallback_file=_first(sorted(saved_to, key=lambda each: each != file)),  # that file, if any
        goes_with_arm=False,
        **{name: _first(values) for name, values in given.items()},
    )
    joined.ids()
    return joined


def about_unused_file(shares: Sequence[ServoSettings]) -> str | None:
    """What to tell if the last component and others name different calibration files."""
    counts = next((s for s in _arms_first(shares) if s.calibration_file is not None), None)
    newest = shares[-1].calibration_file
    others = [s.calibration_file for s in shares if s.calibration_file not in (None, newest)]
    if counts is None or newest is None or not others:
        return None
    used = counts.calibration_file
    why = "the arm names it" if counts.servo_ids is not None else "it was named first"
    return (
        f"components on {counts.port} name different calibration files: {used} is used, because"
        f" {why}, and {others[0] if newest == used else newest} is not; give all of them the same"
        " calibration_file, or set it on one only"
    )


def _arms_first(shares: Sequence[ServoSettings]) -> list[ServoSettings]:
    return sorted(shares, key=lambda share: share.servo_ids is None)


def _different(values: Iterable[object]) -> list[object]:
    found: list[object] = []
    for value in values:
        if value is not None and value not in found:
            found.append(value)
    return found


def _first(values: Iterable[Any]) -> Any:
    return next((value for value in values if value is not None), None)


_ATTRIBUTES = {
    "baudrate": "baudrate",
    "servo_ids": "servo_ids",
    "gripper_id": "servo_id",
    "zero_offsets": "joint_zero_offsets_deg",
    "joint_zero": "joint_zero",
    "rate": "control_rate_hz",
    "at_end": "at_end",
    "compensates": "compensates",
}
"""The settings that components must agree on, by name, as a configuration calls them."""

_AGREED = tuple(name for name in _ATTRIBUTES if name != "baudrate")


def _plain(name: str, value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{joint} {to_deg(angle):g} deg" for joint, angle in value.items())
    if isinstance(value, float):
        return f"{value:g}"
    return str(list(value)) if isinstance(value, tuple) else str(value)
