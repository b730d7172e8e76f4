"""What all pages of the setup share: the arm, what is known of it, and one worker thread."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import msgspec

from so101_motion.calib.motors.setup_view import SetupProgress
from so101_motion.calib.procedure.steps import State
from so101_motion.common.modes import Mode
from so101_motion.common.operation import Operation, RemoteOperation
from so101_motion.drivers.bus.bus import REPLY_TIMEOUT
from so101_motion.rig.hardware_rig import HardwareRig, open_hardware
from so101_motion.rig.protocols import RigLike
from so101_motion.setup.assembly import AssemblyOperation
from so101_motion.setup.calibration_operation import CalibrationOperation
from so101_motion.setup.calibrator import Calibrator, Situation
from so101_motion.setup.checkup import Check, Findings
from so101_motion.setup.connect import (
    Candidate,
    PortsSeen,
    calibration_file,
    look,
)
from so101_motion.setup.motor_operation import MotorOperation
from so101_motion.setup.move_test import MoveTest
from so101_motion.setup.setup_steps import CONNECT, SetupState
from so101_motion.viam.client import Machine, MachineRig

from ..page.operation_panel import Worker
from ..page.page_context import PageContext
from ..server.host import ServedPage
from .picture import Picture


@dataclass(frozen=True, kw_only=True, eq=False)
class SetupTarget:
    """The arm that is set up."""

    where: str
    calibration: Operation  # calibrates it
    motors: Operation  # gives its motors their ids
    chain: Operation  # verifies its motors
    # holds the joints where they stand, or lets them sink; without ``rig`` there is nothing to hold
    set_torque: Callable[[bool], object]
    # moves the arm, for the final test; None if it cannot be moved. Closed by its owner
    rig: RigLike | None = None
    # whether it is the arm of a machine, whose cable cannot be looked at from here
    is_remote: bool = False

    @property
    def situation(self) -> Situation:
        view = self.calibration.view
        now = msgspec.convert(view.facts, Situation)
        return now if view.is_connected else replace(now, is_connected=False)

    @cached_property
    def assembly(self) -> AssemblyOperation:
        return AssemblyOperation()

    @cached_property
    def test(self) -> MoveTest | None:
        name = f"arm on {self.where}"
        return (
            None
            if self.rig is None
            else MoveTest(self.rig, name=name, hold=partial(self.set_torque, True))
        )

    @property
    def is_under_way(self) -> bool:
        return self.calibration.view.state != State.IDLE.value

    def close(self) -> None:
        """Give up the port or the machine; a machine's calibration goes on."""
        for operation in (self.test, self.motors, self.chain, self.calibration):
            if operation is not None:
                operation.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmSource:
    """The ports of this computer, or an arm that is known already."""

    where: str | None  # which arm; None if a port is to be chosen
    instruction: str = CONNECT.instruction  # how to connect it
    # returns the ports that are plugged in now, or how the known arm is
    look: Callable[[], PortsSeen]
    # makes the target, in a worker's thread, from the chosen port and the user's name for the arm,
    # which its calibration file gets; raises ``So101Error``
    open: Callable[[Candidate | None, str], SetupTarget]


def ports(named: Collection[str] = (), reply_timeout: float = REPLY_TIMEOUT) -> ArmSource:
    """The serial ports of this computer; opening one drives nothing and needs no motor."""

    def open_port(chosen: Candidate | None, name: str) -> SetupTarget:
        assert chosen is not None  # else one could not have gone on
        file = calibration_file(
            chosen.report, "" if chosen.report.calibration is not None else name
        )
        open_rig = partial(open_hardware, reply_timeout=reply_timeout)
        return _on_port(Calibrator.open(chosen.name, file, open_rig=open_rig))

    look_again = partial(look, named, reply_timeout=reply_timeout)
    return ArmSource(where=None, look=look_again, open=open_port)


def _on_port(calibrator: Calibrator, rig: RigLike | None = None) -> SetupTarget:
    return SetupTarget(
        where=calibrator.port,
        calibration=CalibrationOperation(calibrator),
        motors=calibrator.motors,
        chain=calibrator.chain,
        set_torque=lambda on: calibrator.hold() if on else calibrator.let_go(),
        rig=rig or calibrator.rig,
    )


_AT_THE_MACHINE = (
    "The arm is at the machine's computer: its adapter board is plugged in there with a USB cable."
    " Switch the arm's own power supply on: USB does not feed the motors."
)


def known_arm(source: RigLike | Machine) -> ArmSource | None:
    """The arm of a page or machine; None if it is a simulated one, which needs no setup."""
    if isinstance(source, HardwareRig):
        where, make = source.settings.port, partial(_open_share, source)
        instruction = CONNECT.instruction
    elif isinstance(source, Machine):
        where, make = source.connection.to, partial(_of_machine, source)
        instruction = _AT_THE_MACHINE
    else:
        return None

    def seen() -> PortsSeen:
        now = source.connection
        findings = Findings(port=now.to, adapter="connected", port_trouble=now.problem or "")
        return PortsSeen(nothing=findings)

    return ArmSource(
        where=where, instruction=instruction, look=seen, open=lambda _chosen, _name: make()
    )


def _open_share(rig: HardwareRig) -> SetupTarget:
    settings = rig.settings
    file = settings.fallback_file or settings.calibration_file
    if file is None:
        (candidate,) = look((settings.port,)).candidates
        file = calibration_file(candidate.report)
    return _on_port(Calibrator.open(settings.port, file, baudrate=settings.baudrate), rig)


def _of_machine(machine: Machine) -> SetupTarget:
    send = partial(machine.do_command, machine.calibration_sensor())
    rig = machine if isinstance(machine, MachineRig) else None
    return SetupTarget(
        where=machine.connection.to,
        calibration=RemoteOperation(send, "calibration"),
        motors=RemoteOperation(send, "motors"),
        chain=RemoteOperation(send, "chain"),
        set_torque=(lambda _on: None) if rig is None else rig.arm.set_torque,
        rig=rig,
        is_remote=True,
    )


SETTLED = 0.4
"""How long readings must be missing before the text changes [s]; chosen. A search for motors takes
the port through other baud rates, and a busy computer loses answers; for that moment the torque is
unknown."""


_NOT_KNOWN = "Torque not known"


def torque(target: SetupTarget | None) -> str:
    """Whether any motor drives its joint, in words."""
    if target is None:
        return f"{_NOT_KNOWN}: not asked yet"
    now = target.situation
    if not now.is_connected:
        return f"{_NOT_KNOWN}: no connection"
    if now.holds is None:
        return f"{_NOT_KNOWN} yet"
    if target.rig is not None and target.rig.arm.state.mode is Mode.GUIDING:
        return "Guided by hand"
    return f"Torque {'on: the joints are held' if now.holds else 'off: the joints are limp'}"


class TorqueWatch:
    """Keeps the text while readings are missing for a moment."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self.shown = torque(None)
        self._now, self._known_at = now, now()

    def look(self, target: SetupTarget | None, *, is_blind: bool) -> str:
        """Read the torque again; what it was stands while motors are searched for or written to."""
        seen, before, t = torque(target), self.shown, self._now()
        is_kept = _NOT_KNOWN not in before or (is_blind and before != torque(None))
        is_lost = target is not None and _NOT_KNOWN in seen and is_kept
        if is_blind or not is_lost:
            self._known_at = t
        if not is_lost or t - self._known_at >= SETTLED:
            self.shown = seen
        return self.shown


ServesPreview = Callable[..., ServedPage]  # serves a preview of an arm: ``so101_viewer.serve``


@dataclass(slots=True, kw_only=True)
class SetupContext(Worker):
    """What all pages share. Its fields belong to the page's thread."""

    context: PageContext  # the page; presses go through it
    picture: Picture
    progress: SetupProgress
    # serves a preview of the arm; None where the page shows the arm already
    preview: ServesPreview | None = None
    target: SetupTarget | None = None  # the arm that is set up; None until the connection is made
    saved: str | None = None  # where this setup has saved a calibration; None before
    # what else was opened, to be closed with the setup
    opened: ExitStack = field(default_factory=ExitStack)
    port: str | None = None  # the port of the last target on this computer; None before
    torque: TorqueWatch = field(default_factory=TorqueWatch)

    @property
    def tested(self) -> Check | None:
        report = None
        if self.target is not None and self.target.test is not None:
            report = self.target.test.report
        if report is None:
            return None
        return Check(name="test", verdict=report.verdict, sentence=report.sentence, fix=report.fix)

    @property
    def known(self) -> SetupState:
        if self.target is None:
            return SetupState(saved=self.saved)
        now = self.target.situation
        return SetupState(
            seen=Findings(servos=now.checked),
            setup=now.setup,
            view=now.view,
            is_assembled=self.target.assembly.view.is_over,
            saved=self.saved,
            tested=self.tested,
        )

    def work_on(self, target: SetupTarget) -> None:
        self.target = target
        if not target.is_remote:
            self.port = target.where
        self.progress.work_on(target.where)
        if isinstance(target.motors, MotorOperation):  # a machine remembers by itself
            target.motors.keep_in(self.progress)

    def put_away(self) -> None:
        target, self.target = self.target, None
        self.saved = None
        if target is not None:
            self._workers.submit(target.close)

    def close(self) -> None:
        self.opened.close()
        self.put_away()
        self.end()
