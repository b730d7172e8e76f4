"""The settings that components ask of a serial port, and how they are combined."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from so101_motion.calib.procedure import journal
from so101_motion.common.errors import ConfigError
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_deg
from so101_motion.drivers.bus.defaults import BAUDRATE, GRIPPER_ID, SERVO_IDS, TIMEOUT


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
        rate: Setpoints a second [1/s]; None from components that do not care.
        fallback_file: Where a calibration of this arm is saved unless a component names a file.
        releases_at_end: Whether the joints are released, instead of held, when the process ends in
            order; None from components that do not care.
        compensates: Whether weight, friction and lag are compensated; None from components that do
            not care: they are compensated then.
    """

    port: str
    baudrate: int = BAUDRATE
    timeout: float | None = TIMEOUT
    servo_ids: tuple[int, ...] | None = None
    gripper_id: int | None = None
    calibration_file: Path | None = None
    zero_offsets: Mapping[str, float] | None = None
    rate: float | None = None
    fallback_file: Path | None = None
    releases_at_end: bool | None = None
    compensates: bool | None = None

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
        """These settings with an arm of these servos and zeros."""
        return replace(self, servo_ids=servo_ids, zero_offsets=zero_offsets)

    def with_gripper(self, gripper_id: int) -> ServoSettings:
        """These settings with a gripper of this servo."""
        return replace(self, gripper_id=gripper_id)

    def joined_with(self, other: ServoSettings) -> ServoSettings:
        """Combine the settings of two components.

        Raises:
            ConfigError: They contradict each other; the message names every such setting.
        """
        differing = []
        merged: dict[str, object] = {}
        for name in _JOINED:
            mine, theirs = getattr(self, name), getattr(other, name)
            if None not in (mine, theirs) and mine != theirs:
                differing.append(f"{name} {_plain(mine)} and {_plain(theirs)}")
            merged[name] = theirs if mine is None else mine
        if differing:
            raise ConfigError(
                "port",
                other.port,
                "another component uses this port with other settings: "
                + "; ".join(differing)
                + ". Give both the same",
            )
        joined = replace(self, **merged)  # type: ignore[arg-type]  # names and types are our own
        joined.ids()
        return joined

    def ids(self) -> dict[str, int]:
        """The servo of each joint that may be there.

        Raises:
            ConfigError: One servo is to move two joints.
        """
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


_JOINED = (
    "baudrate", "timeout", "servo_ids", "gripper_id", "calibration_file", "zero_offsets",
    "rate", "fallback_file", "releases_at_end", "compensates",
)  # fmt: skip


def _plain(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{joint} {to_deg(angle):g} deg" for joint, angle in value.items())
    return str(list(value)) if isinstance(value, tuple) else str(value)
