"""The arm that is set up: on a port of this computer, or of a running machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import msgspec

from so101_motion.calib.procedure.steps import State
from so101_motion.common.errors import CalibrationError
from so101_motion.common.operation import Operation
from so101_motion.common.remote_operation import RemoteOperation
from so101_motion.rig.hardware_rig import HardwareRig, open_hardware
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.servo_driver import ServoSettings
from so101_motion.setup.assembly import AssemblyOperation
from so101_motion.setup.calibration_operation import CalibrationOperation
from so101_motion.setup.calibrator import Calibrator, Situation
from so101_motion.setup.findings import Findings
from so101_motion.setup.move_test import MoveTest
from so101_motion.setup.port_selection import REPLY_TIMEOUT, Candidate, PortsSeen, look
from so101_motion.viam.client import Machine, MachineRig


@dataclass(frozen=True, kw_only=True, eq=False)
class SetupTarget:
    """The arm that is set up.

    Attributes:
        calibration: Calibrates it.
        motors: Gives its motors their ids.
        chain: Verifies its motors.
        set_torque: Holds the joints where they stand, or lets them sink.
        rig: Moves the arm, for the final test; None if it cannot be moved. Closed by its owner.
        is_remote: Whether it is the arm of a machine, whose cable cannot be looked at from here.
    """

    where: str
    calibration: Operation
    motors: Operation
    chain: Operation
    set_torque: Callable[[bool], object]
    rig: RigLike | None = None
    is_remote: bool = False

    @property
    def situation(self) -> Situation:
        """The state of calibration, motor setup and arm; never waits."""
        view = self.calibration.view
        now = msgspec.convert(view.facts, Situation)
        return now if view.is_connected else replace(now, is_connected=False)

    @cached_property
    def assembly(self) -> AssemblyOperation:
        """The check of its assembly."""
        return AssemblyOperation()

    @cached_property
    def test(self) -> MoveTest | None:
        """The test of its motions; None if it cannot be moved."""
        name = f"arm on {self.where}"
        return None if self.rig is None else MoveTest(self.rig, name=name, hold=self.hold)

    @property
    def is_under_way(self) -> bool:
        """Whether a calibration is under way."""
        return self.calibration.view.state != State.IDLE.value

    def hold(self) -> object:
        """Hold the joints where they stand."""
        return self.set_torque(True)

    def let_go(self) -> None:
        """Switch the torque of all joints off; they sink at once."""
        self.set_torque(False)

    def close(self) -> None:
        """Give up the port or the machine; a machine's calibration goes on."""
        for operation in (self.test, self.motors, self.chain, self.calibration):
            if operation is not None:
                operation.close()


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
        calibrator = Calibrator(share)
        return SetupTarget(
            where=share.settings.port,
            calibration=CalibrationOperation(calibrator),
            motors=calibrator.motors,
            chain=calibrator.chain,
            set_torque=lambda on: calibrator.hold() if on else calibrator.let_go(),
            rig=rig or share,
        )
    except BaseException:
        share.close()
        raise


def fixed_arm(source: RigLike | Machine) -> FixedArm | None:
    """The arm of a page or machine; None if it is a simulated one, which needs no setup."""
    if isinstance(source, HardwareRig):
        where, make = source.settings.port, partial(_open_share, source)
    elif isinstance(source, Machine):
        where, make = source.connection.to, partial(_of_machine, source)
    else:
        return None

    def findings() -> Findings:
        now = source.connection
        return Findings(port=now.to, adapter="connected", port_trouble=now.problem or "")

    return FixedArm(where=where, open=make, findings=findings)


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


def _of_machine(machine: Machine) -> SetupTarget:
    """The operations of the machine's own calibration sensor."""
    send = partial(machine.do_command, machine.calibration_sensor())
    rig = machine if isinstance(machine, MachineRig) else None
    return SetupTarget(
        where=machine.connection.to,
        calibration=RemoteOperation(send, "calibration"),
        motors=RemoteOperation(send, "motors"),
        chain=RemoteOperation(send, "chain"),
        set_torque=_without_arm if rig is None else rig.arm.set_torque,
        rig=rig,
        is_remote=True,
    )


def _without_arm(_: bool) -> None:
    raise CalibrationError(
        None,
        "the machine has no arm yet, so its joints can neither be held nor let go of",
        "add the arm to the machine's configuration",
    )
