"""Options that choose the arm of a verb: ``--sim``, ``--port`` or ``--machine``.

A verb that works on servos has the first two (``SOURCE``); one that only needs an arm and its
gripper has all three (``ANY_SOURCE``). A typed option wins over the environment.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from so101_motion.cli.options import flag, option, together
from so101_motion.cli.param_types import IN_FILE, Finite, port_option
from so101_motion.cli.shared import aside, busy_message, have_agreed, note_opened, opened
from so101_motion.common import interrupts
from so101_motion.common.attributes import ACCELERATION_RANGE_DEG, SPEED_RANGE_DEG
from so101_motion.common.errors import NoReply, PortUnavailable
from so101_motion.common.state import ARM_JOINTS

if TYPE_CHECKING:
    from so101_motion.common.geometry import Array
    from so101_motion.files.cell_file import CellFile
    from so101_motion.planning.collision.scene import Tool
    from so101_motion.rig.cell_rigs import CellRigs
    from so101_motion.rig.protocols import RigLike
    from so101_motion.rig.rig import Rig
    from so101_motion.viam.client import Machine, MachineRig

R = TypeVar("R", bound="RigLike")


@dataclass(frozen=True, slots=True, kw_only=True)
class _SourceWithCaps:
    """A source with caps of its own; None for those of the arm or its machine."""

    speed: float | None = None  # joint speed cap [rad/s]
    acceleration: float | None = None  # joint acceleration cap [rad/s^2]
    tool: Tool | None = None  # what is fixed to its gripper
    at_end: str = "hold"  # how it is left, see ``have_agreed``

    @property
    def what(self) -> str:
        raise NotImplementedError

    @property
    def title(self) -> str:
        return self.what[:1].upper() + self.what[1:]

    def _capped(self, rig: R) -> R:
        """``rig`` with these caps; closes it if they are refused."""
        try:
            if self.speed is not None:
                rig.arm.set_speed(self.speed)
            if self.acceleration is not None:
                rig.arm.set_acceleration(self.acceleration)
            if self.tool is not None:
                rig.arm.set_tool(self.tool)
        except BaseException:
            rig.close()
            raise
        return note_opened(self.what, rig)

    def have_agreed(self, rig: RigLike, question: str, yes: bool) -> None:
        """Ask before ``rig`` moves; once a person has agreed, it is left as ``--at-end`` says."""
        have_agreed(question, yes)
        end_as_asked(self.at_end, rig)


@dataclass(frozen=True, slots=True, kw_only=True)
class Source(_SourceWithCaps):
    """An arm of this computer: simulated or on a port."""

    port: str | None  # serial port of a real or emulated arm; None for the simulated one
    calibration_file: Path | None = None  # None to search for the one that fits its servos
    q_start: Array | None = None  # of the simulated arm, shape (5,), [rad]; None for zeros
    say: Callable[[str], None] = aside  # prints a note about the calibration

    @property
    def what(self) -> str:
        return "simulated arm" if self.port is None else f"arm on {self.port}"

    def open(self) -> Rig:
        """Open the arm and its gripper.

        If its servos hold another calibration than the file, the user is asked at a terminal.
        """
        from so101_motion.arm.planning_worker import planner_started

        try:
            with planner_started():
                return self._open()
        except NoReply:
            opened.append(lambda: "nothing moved; servos that held before still hold")
            raise

    def _open(self) -> Rig:
        from so101_motion.common.errors import OtherCalibration
        from so101_motion.drivers.bus.defaults import SERVO_IDS
        from so101_motion.rig.hardware_rig import open_hardware
        from so101_motion.rig.port_settings import ServoSettings
        from so101_motion.rig.simulated_rig import open_simulated

        if self.port is None:
            with interrupts.held():
                return self._capped(open_simulated(q_start=self.q_start))
        asked = ServoSettings(port=self.port, calibration_file=self.known_calibration())
        asked = asked.with_arm(SERVO_IDS)
        try:
            with interrupts.held():
                return self._capped(open_hardware(asked))
        except OtherCalibration as error:
            from so101_motion.cli.calibration import ask_and_write

            if sys.stdin is None or not sys.stdin.isatty():
                raise
            ask_and_write(error, self.port)
        with interrupts.held():
            return self._capped(open_hardware(asked))

    def open_to_look(self) -> Rig:
        """Open the arm without driving it: nothing is written to a servo, a limp arm stays limp.

        Raises:
            PortUnavailable: A servo of the arm does not answer.
        """
        from so101_motion.rig.hardware_rig import open_hardware
        from so101_motion.rig.port_settings import ServoSettings

        if self.port is None:
            return self.open()
        file = self.known_calibration()
        rig = open_hardware(ServoSettings(port=self.port, timeout=None, calibration_file=file))
        silent = [joint for joint in ARM_JOINTS if joint not in rig.servos.setups]
        if silent:
            rig.close()
            rig.servos.require(silent)
            reason = f"{', '.join(silent)} does not answer; check its cable and the arm's power"
            raise PortUnavailable(self.port, reason)
        for note in rig.servos.notes:
            self.say(f"note: {note}")
        return self._capped(rig)

    def known_calibration(self) -> Path | None:
        """The calibration file that ``open`` uses, with a note about it; None without one.

        Raises:
            CalibrationError: The named file cannot be read.
            PortUnavailable: The servos talk at another rate than the arm is driven at.
        """
        from so101_motion.calib.record import store
        from so101_motion.cli.port_choice import look_at
        from so101_motion.drivers.bus.defaults import BAUDRATE

        if self.calibration_file is not None:
            # The rig would ignore a file that it cannot use; a named one must be usable.
            return store.read(store.resolve(str(self.calibration_file))).path
        if self.port is None:
            return None
        report = look_at(self.port)
        if report.baudrate != BAUDRATE:
            reason = (
                f"its servos talk at {report.baudrate} baud; so101 setup --repair sets {BAUDRATE}"
            )
            raise PortUnavailable(self.port, reason)
        if report.calibration is not None:
            self.say(f"calibration: {report.calibration}")
        elif report.joints:  # without any, opening the arm fails and says why
            from so101_motion.rig.port_settings import NO_FILE

            self.say(f"{NO_FILE}, --calibration names one")
        return report.calibration


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineSource(_SourceWithCaps):
    """The arm of a running Viam machine."""

    address: str
    api_key_id: str | None = None  # None for a plain, direct connection
    api_key: str | None = field(default=None, repr=False)
    arm: str | None = None  # which of its arms; None for the only one
    gripper: str | None = None  # which of its grippers; None for the only one

    @property
    def what(self) -> str:
        name = f'"{self.arm}" ' if self.arm else ""
        return f"arm {name}of machine {self.address}"

    @property
    def _key(self) -> dict[str, str | None]:
        return {"api_key_id": self.api_key_id, "api_key": self.api_key}

    def open(self) -> MachineRig:
        from so101_motion.viam.client import MachineRig

        with busy_message(f"connecting to machine {self.address}"):
            rig = MachineRig.connect(self.address, **self._key, arm=self.arm, gripper=self.gripper)
        return self._capped(rig)

    def connect(self) -> Machine:
        """Connect to the machine itself; it needs no arm."""
        from so101_motion.viam.client import Machine

        return Machine.connect(self.address, **self._key)

    open_to_look = open


AnySource = Source | MachineSource  # both open a rig that fits ``RigLike``
S = TypeVar("S", bound=AnySource)


def end_as_asked(at_end: str, rig: RigLike) -> None:
    """Leave ``rig`` so when it is closed."""
    if at_end != "hold":
        rig.at_end, rig.on_left = at_end, aside


def ending(source: Any) -> Any:
    """The options of ``source`` with ``--at-end``."""
    return together(_with_end, source=source, at_end=AT_END)


def _with_end(source: Any, at_end: str) -> Any:
    if at_end == "park" and isinstance(source, MachineSource):
        reason = 'on a machine "at_end" of its arm does that'
        raise click.UsageError(f"--at-end park works only with --sim or --port; {reason}")
    return replace(source, at_end=at_end)


def with_caps(source: S, speed_deg: float | None, acceleration_deg: float | None) -> S:
    """The same source with caps on joint speed [deg/s] and acceleration [deg/s^2]."""
    from so101_motion.common.units import to_rad

    return replace(
        source,
        speed=None if speed_deg is None else to_rad(speed_deg),
        acceleration=None if acceleration_deg is None else to_rad(acceleration_deg),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CellSource:
    """Several arms that share a space."""

    at_end: str = "hold"
    file: CellFile
    title: str
    path: Path | None = None  # of ``file``; None for arms that no file names

    @property
    def what(self) -> str:
        return ", ".join(each.name for each in self.file.arms)

    def open(self) -> CellRigs:
        opened = open_arms(self.file)
        for rig in opened.rigs.values():
            end_as_asked(self.at_end, rig)
        return opened


def open_arms(file: CellFile) -> CellRigs:
    from so101_motion.rig.cell_rigs import open_cell
    from so101_motion.rig.hardware_rig import HardwareRig
    from so101_motion.rig.port_settings import NO_FILE

    with interrupts.held():
        opened = open_cell(file)
        for name, rig in opened.rigs.items():
            note_opened(f'arm "{name}"', rig)
            if isinstance(rig, HardwareRig):
                if not rig.has_file:
                    aside(f"{name}: {NO_FILE}")
                for note in rig.servos.notes:
                    aside(f"{name}: {note}")
        return opened


def _source(
    sim: bool,
    port: str | None,
    calibration: Path | None,
    tool: str | None = None,
    machine: MachineSource | None = None,
    cell: Path | None = None,
) -> AnySource | CellSource:
    """The source that the options of ``SOURCE``, ``ANY_SOURCE`` or ``ARM_OR_CELL`` name."""
    from so101_motion.files.tool_file import find_tool

    context = click.get_current_context()
    asked = {"--sim": sim or None, "--port": port, "--machine": machine, "--cell": cell}
    chosen = chosen_among(asked)
    if chosen is None and context.params.get("atlas") is not None:
        chosen = "--sim"  # an atlas needs no arm
    if chosen is None:
        others = ", or --machine and its address" if "address" in context.params else ""
        raise click.UsageError(f"which arm? give --sim, or --port and its serial port{others}")
    if calibration is not None and chosen != "--port":
        raise click.UsageError("--calibration works only with --port; leave it out")
    if tool is not None and chosen not in ("--sim", "--port"):
        raise click.UsageError("--tool works only with --sim or --port; leave it out")
    if chosen == "--machine" and machine is not None:
        return machine
    if chosen == "--cell" and cell is not None:
        from so101_motion.files.cell_file import read_cell

        return CellSource(file=read_cell(cell), title=f"Arms of {cell.name}", path=cell)
    return Source(
        port=port if chosen == "--port" else None,
        calibration_file=calibration,
        tool=None if tool is None else find_tool(tool),
    )


def _machine(
    address: str | None, arm: str | None, gripper: str | None, **key: Any
) -> MachineSource | None:
    if address:
        return MachineSource(address=address, arm=arm, gripper=gripper, **key)
    if arm or gripper:
        raise click.UsageError("--arm and --gripper work only with --machine; give its address")
    return None


CALIBRATION = option(
    "The arm's calibration file; by default the one that fits its servos.",
    click.Path(path_type=Path),
)

MACHINE = together(  # a running machine; None if none is named
    _machine,
    address=option(
        "A running Viam machine (or SO101_MACHINE).", name="--machine", envvar="SO101_MACHINE",
        metavar="ADDRESS",
    ),
    api_key_id=option(
        "With --machine: its API key's id (or SO101_API_KEY_ID).", envvar="SO101_API_KEY_ID",
        metavar="ID",
    ),
    api_key=option(
        "With --machine: its API key; better in SO101_API_KEY, which no process list shows.",
        envvar="SO101_API_KEY", metavar="KEY",
    ),
    arm=option("With --machine: which arm, if it has several.", metavar="NAME"),
    gripper=option("With --machine: which gripper, if several.", metavar="NAME"),
)  # fmt: skip

_LOCAL = {
    "sim": flag("The simulated arm; needs no hardware."),
    "port": port_option("Serial port of the arm, such as /dev/ttyACM0"),
    "calibration": CALIBRATION,
    "tool": option("What is fixed to the gripper: a tool's name, or its .json file."),
}
_CELL = option("Several arms that share a space: a cell file, as for so101 cell.", IN_FILE)

AT_END = option(
    "How the arm is left: it holds, is let go of, goes home by a plan, or goes to the pose"
    " 'park' (else 'rest'), where it lies and is let go of.",
    click.Choice(("hold", "release", "home", "park")),
    "hold",
)

SOURCE = together(_source, **_LOCAL)  # a ``Source``, for verbs that work on servos
ANY_SOURCE = together(_source, **_LOCAL, machine=MACHINE)
ARM_OR_CELL = together(_source, **_LOCAL, machine=MACHINE, cell=_CELL)


def paced(source: Any) -> Any:
    """The options of ``source`` with ``--speed`` and ``--acceleration``."""
    speeds, accelerations = Finite(*SPEED_RANGE_DEG), Finite(*ACCELERATION_RANGE_DEG)
    return together(
        with_caps,
        source=source,
        speed_deg=option(
            "Joint speed cap.", speeds, name="--speed", metavar="DEG/S",
            show_default="50, with --sim 90, or the machine's",
        ),
        acceleration_deg=option(
            "Joint acceleration cap.", accelerations, name="--acceleration", metavar="DEG/S2",
            show_default="100, or the machine's",
        ),
    )  # fmt: skip


_PARAMETERS = {"--sim": "sim", "--port": "port", "--machine": "address", "--cell": "cell"}


def chosen_among(sources: Mapping[str, object]) -> str | None:
    """Choose the source: a typed option wins over the environment.

    Raises:
        click.UsageError: Several were typed, or the environment has several.
    """
    context = click.get_current_context()
    there = [option for option, value in sources.items() if value]
    typed = [
        option
        for option in there
        if context.get_parameter_source(_PARAMETERS[option])
        is click.core.ParameterSource.COMMANDLINE
    ]
    candidates = typed or there
    if len(candidates) > 1:
        raise click.UsageError(f"give {', '.join(candidates[:-1])} or {candidates[-1]}, not both")
    return candidates[0] if candidates else None
