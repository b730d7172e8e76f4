"""Makes benches: from a port that was chosen, or from an arm that the page shows already."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from so101_motion.adapters import PATIENCE, Candidate, Look, look
from so101_motion.calibrator import Calibrator
from so101_motion.errors import ConfigError, MachineRefused
from so101_motion.findings import Findings
from so101_motion.machine import MachineRig, MachineSensor
from so101_motion.rig import HardwareRig, open_hardware
from so101_motion.rig_like import Connection, RigLike
from so101_motion.servos import ServoSettings

from .bench import Bench
from .machine import MachineCalibrator


@dataclass(frozen=True, slots=True, kw_only=True)
class Given:
    """An arm that is there already, so that no port is to be chosen.

    Attributes:
        where: On which port, or at which machine.
        open: Makes its bench, in a worker's thread; raises ``So101Error``.
        findings: What there is to judge of the connection now.
    """

    where: str
    open: Callable[[], Bench]
    findings: Callable[[], Findings]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ports:
    """The serial ports of this computer.

    Attributes:
        named: Those to look at, whatever they are; if there are any, no other is looked at.
        patience: How long a motor may take to answer beyond the time on the wire [s].
    """

    named: tuple[str, ...] = ()
    patience: float = PATIENCE

    def look(self) -> Look:
        """What is plugged in now."""
        return look(self.named, patience=self.patience)

    def open(self, candidate: Candidate) -> Bench:
        """A bench on a port; nothing is driven and no motor need be there.

        Raises:
            BusError: The port cannot be opened.
            CalibrationError: This user has no place for files.
            ConfigError: Somebody uses the port with other settings.
        """
        file = candidate.calibration_file()
        asked = ServoSettings(port=candidate.name, timeout=None, fallback_file=file)
        return _bench(open_hardware(asked, patience=self.patience))


def _bench(share: HardwareRig, rig: RigLike | None = None) -> Bench:
    try:
        return Bench(where=share.settings.port, calibrator=Calibrator(share), rig=rig or share)
    except BaseException:
        share.close()
        raise


def given(rig: RigLike) -> Given | None:
    """The arm that a page shows; None if it is a simulated one, which needs no setup."""
    if isinstance(rig, HardwareRig):
        port = rig.settings.port
        return Given(
            where=port, open=lambda: _open_share(rig), findings=lambda: _about(rig.connection)
        )
    if isinstance(rig, MachineRig):
        where = rig.connection.to
        return Given(
            where=where, open=lambda: _open_machine(rig), findings=lambda: _about(rig.connection)
        )
    return None


def given_by(sensor: MachineSensor) -> Given:
    """The motors of a machine that has no arm yet."""

    def make() -> Bench:
        calibrator = MachineCalibrator(sensor.do_command, sensor.readings)
        return Bench(where=sensor.connection.to, calibrator=calibrator, is_remote=True)

    return Given(where=sensor.connection.to, open=make, findings=lambda: _about(sensor.connection))


def _about(now: Connection) -> Findings:
    return Findings(port=now.to, adapter="connected", port_trouble=now.problem or "")


def _open_share(rig: HardwareRig) -> Bench:
    """The port that the page's own arm is on; both agree about everything."""
    settings = rig.settings
    file = settings.fallback_file or settings.calibration_file
    if file is None:
        (candidate,) = look((settings.port,)).candidates
        file = candidate.calibration_file()
    asked = ServoSettings(
        port=settings.port, baudrate=settings.baudrate, timeout=None, fallback_file=file
    )
    return _bench(open_hardware(asked), rig)


def _open_machine(rig: MachineRig) -> Bench:
    """The machine's own calibration sensor, whatever it is called."""
    for resource in rig.resources:
        if resource.api == "component:sensor" and _is_ours(rig, resource.name):
            return Bench(
                where=rig.connection.to,
                calibrator=MachineCalibrator(
                    partial(rig.do_command, resource.name),
                    partial(rig.readings, resource.name),
                    hold=lambda: rig.arm.set_torque(True),
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
