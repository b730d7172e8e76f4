"""The arm that is set up: on a port of this computer, or of a running machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from so101_motion.common.errors import ConfigError, MachineRefused
from so101_motion.rig.hardware_rig import HardwareRig, open_hardware
from so101_motion.rig.protocols import ArmConnection, RigLike
from so101_motion.rig.servo_driver import ServoSettings
from so101_motion.setup.calibrator import BaseCalibrator, Calibrator
from so101_motion.setup.findings import Findings
from so101_motion.setup.port_selection import REPLY_TIMEOUT, Candidate, PortsSeen, look
from so101_motion.viam.client import MachineRig, MachineSensor

from .machine import MachineCalibrator


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SetupTarget:
    """The arm that is set up.

    Attributes:
        calibrator: Does the work; closed with the target.
        rig: Moves the arm, for the final test; None if it cannot be moved. Closed by its owner.
        is_remote: Whether it is the arm of a machine, whose cable cannot be looked at from here.
    """

    where: str
    calibrator: BaseCalibrator
    rig: RigLike | None = None
    is_remote: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedArm:
    """An arm that is known already, so no port is chosen.

    Attributes:
        open: Makes its target, in a worker's thread; raises ``So101Error``.
    """

    where: str
    open: Callable[[], SetupTarget]
    findings: Callable[[], Findings]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ports:
    """The serial ports of this computer.

    Attributes:
        named: The ports to look at; if there are none, all.
        reply_timeout: How long a motor may take to answer beyond the time on the wire [s].
    """

    named: tuple[str, ...] = ()
    reply_timeout: float = REPLY_TIMEOUT

    def look(self) -> PortsSeen:
        """The ports that are plugged in now."""
        return look(self.named, reply_timeout=self.reply_timeout)

    def open(self, candidate: Candidate, name: str = "") -> SetupTarget:
        """Open a target on a port; drives nothing and needs no motor.

        Args:
            candidate: The port.
            name: What the user calls the arm; gives its calibration file the name.

        Raises:
            BusError: The port cannot be opened.
            CalibrationError: This user has no place for files.
            ConfigError: The port is used with other settings already, or the name cannot be used.
        """
        file = candidate.calibration_file(name)
        asked = ServoSettings(port=candidate.name, timeout=None, fallback_file=file)
        return _opened(open_hardware(asked, reply_timeout=self.reply_timeout))


def _opened(share: HardwareRig, rig: RigLike | None = None) -> SetupTarget:
    try:
        return SetupTarget(
            where=share.settings.port, calibrator=Calibrator(share), rig=rig or share
        )
    except BaseException:
        share.close()
        raise


def fixed_arm(rig: RigLike) -> FixedArm | None:
    """The arm that a page shows; None if it is a simulated one, which needs no setup."""
    if isinstance(rig, HardwareRig):
        port = rig.settings.port
        return FixedArm(
            where=port, open=lambda: _open_share(rig), findings=lambda: _about(rig.connection)
        )
    if isinstance(rig, MachineRig):
        where = rig.connection.to
        return FixedArm(
            where=where, open=lambda: _open_machine(rig), findings=lambda: _about(rig.connection)
        )
    return None


def fixed_machine(sensor: MachineSensor) -> FixedArm:
    """The motors of a machine that has no arm yet."""

    def make() -> SetupTarget:
        calibrator = MachineCalibrator(
            partial(sensor.do_command, sensor.name), partial(sensor.readings, sensor.name)
        )
        return SetupTarget(where=sensor.connection.to, calibrator=calibrator, is_remote=True)

    return FixedArm(
        where=sensor.connection.to, open=make, findings=lambda: _about(sensor.connection)
    )


def _about(now: ArmConnection) -> Findings:
    return Findings(port=now.to, adapter="connected", port_trouble=now.problem or "")


def _open_share(rig: HardwareRig) -> SetupTarget:
    """Open the port that the page's own arm is on, with equal settings."""
    settings = rig.settings
    file = settings.fallback_file or settings.calibration_file
    if file is None:
        (candidate,) = look((settings.port,)).candidates
        file = candidate.calibration_file()
    asked = ServoSettings(
        port=settings.port, baudrate=settings.baudrate, timeout=None, fallback_file=file
    )
    return _opened(open_hardware(asked), rig)


def _open_machine(rig: MachineRig) -> SetupTarget:
    """Open the machine's own calibration sensor, whatever its name."""
    for resource in rig.resources:
        if resource.api == "component:sensor" and _is_ours(rig, resource.name):
            return SetupTarget(
                where=rig.connection.to,
                calibrator=MachineCalibrator(
                    partial(rig.do_command, resource.name),
                    partial(rig.readings, resource.name),
                    set_torque=rig.arm.set_torque,
                ),
                rig=rig,
                is_remote=True,
            )
    raise ConfigError(
        "sensor",
        None,
        "the machine has no calibration sensor; add one of the model devrel:so101:calibration with"
        " the arm's port, then press Next again",
    )


def _is_ours(rig: MachineRig, sensor: str) -> bool:
    try:
        return "calibration_state" in rig.readings(sensor)
    except MachineRefused:
        return False
