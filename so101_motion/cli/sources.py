"""Options that choose the arm of a verb: ``--sim``, ``--port`` or ``--machine``.

A verb that works on servos has the first two (``source_options``); one that only needs an arm and
its gripper has all three (``any_source_options``). A typed option wins over the environment.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from so101_motion.cli.param_types import IN_FILE, Finite, port_option
from so101_motion.cli.shared import F, aside, busy_message, note_opened
from so101_motion.common import interrupts
from so101_motion.common.attributes import ACCELERATION_RANGE_DEG, SPEED_RANGE_DEG
from so101_motion.common.errors import PortUnavailable
from so101_motion.common.state import ARM_JOINTS

if TYPE_CHECKING:
    from so101_motion.common.geometry import Array
    from so101_motion.files.cell_file import CellFile
    from so101_motion.rig.cell_rigs import CellRigs
    from so101_motion.rig.hardware_rig import HardwareRig
    from so101_motion.rig.protocols import RigLike
    from so101_motion.rig.rig import Rig
    from so101_motion.viam.client import MachineRig

R = TypeVar("R", bound="RigLike")


@dataclass(frozen=True, slots=True, kw_only=True)
class _SourceWithCaps:
    """A source with caps of its own.

    Attributes:
        speed: Joint speed cap [rad/s]; None for the arm's or its machine's.
        acceleration: Joint acceleration cap [rad/s^2]; None for the arm's or its machine's.
    """

    speed: float | None = None
    acceleration: float | None = None

    @property
    def what(self) -> str:
        """The source in words."""
        raise NotImplementedError

    @property
    def title(self) -> str:
        """The source as a heading."""
        return self.what[:1].upper() + self.what[1:]

    def _capped(self, rig: R) -> R:
        """``rig`` with these caps; closes it if they are refused."""
        try:
            if self.speed is not None:
                rig.arm.set_speed(self.speed)
            if self.acceleration is not None:
                rig.arm.set_acceleration(self.acceleration)
        except BaseException:
            rig.close()
            raise
        return note_opened(self.what, rig)


@dataclass(frozen=True, slots=True, kw_only=True)
class Source(_SourceWithCaps):
    """An arm of this computer: simulated or on a port.

    Attributes:
        port: Serial port of a real or emulated arm; None for the simulated one.
        calibration_file: Its calibration; None to search for the one that fits its servos.
        q_start: First joint angles of the simulated arm, shape (5,), [rad]; None for zeros.
        say: Prints a note about the calibration.
    """

    port: str | None
    calibration_file: Path | None = None
    q_start: Array | None = None
    say: Callable[[str], None] = aside

    @property
    def what(self) -> str:
        """The source in words."""
        return "simulated arm" if self.port is None else f"arm on {self.port}"

    def open(self) -> Rig:
        """Open the arm and its gripper.

        If its servos hold another calibration than the file, the user is asked at a terminal.

        Raises:
            So101Error: It cannot be reached, or a setting is not valid.
        """
        from so101_motion.arm.shared_worker import planner_started

        with planner_started():
            return self._open()

    def _open(self) -> Rig:
        from so101_motion.common.errors import OtherCalibration
        from so101_motion.drivers.bus.defaults import SERVO_IDS
        from so101_motion.rig.hardware_rig import open_hardware
        from so101_motion.rig.servo_driver import ServoSettings
        from so101_motion.rig.simulated_rig import open_simulated

        if self.port is None:
            with interrupts.held():
                return self._capped(open_simulated(q_start=self.q_start))
        file = self.known_calibration()
        asked = ServoSettings(port=self.port, calibration_file=file)
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
            So101Error: A servo of the arm does not answer, or as ``open``.
        """
        if self.port is None:
            return self.open()
        rig = self._open_looking(self.port, self.known_calibration())
        silent = [joint for joint in ARM_JOINTS if joint not in rig.servos.setups]
        if silent:
            rig.close()
            rig.servos.require(silent)
            reason = f"{', '.join(silent)} does not answer; check its cable and the arm's power"
            raise PortUnavailable(self.port, reason)
        for note in rig.servos.notes:
            self.say(f"note: {note}")
        return self._capped(rig)

    @staticmethod
    def _open_looking(port: str, file: Path | None) -> HardwareRig:
        from so101_motion.rig.hardware_rig import open_hardware
        from so101_motion.rig.servo_driver import ServoSettings

        return open_hardware(ServoSettings(port=port, timeout=None, calibration_file=file))

    def known_calibration(self) -> Path | None:
        """The calibration file that ``open`` uses; None without one.

        Raises:
            So101Error: The named file cannot be read.
        """
        from so101_motion.calib.record import store

        if self.calibration_file is not None:
            # The rig would ignore a file that it cannot use; a named one must be usable.
            return store.read(store.resolve(str(self.calibration_file))).path
        return None if self.port is None else _known_calibration(self.port, self.say)


def _known_calibration(port: str, say: Callable[[str], None]) -> Path | None:
    """The calibration file that fits the arm on a port, with a note about it.

    Raises:
        PortUnavailable: Its servos talk at another rate than the arm is driven at.
    """
    from so101_motion.cli.port_choice import look_at
    from so101_motion.drivers.bus.defaults import BAUDRATE

    report = look_at(port)
    if report.baudrate != BAUDRATE:
        reason = f"its servos talk at {report.baudrate} baud; so101 setup --repair sets {BAUDRATE}"
        raise PortUnavailable(port, reason)
    if report.calibration is not None:
        say(f"calibration: {report.calibration}")
    elif report.joints:  # without any, opening the arm fails and says why
        say(
            "no calibration file of this arm was found, so zero is the middle of each joint's"
            " travel and points are some 40 mm off; so101 calibrate makes one, --calibration names"
            " one"
        )
    return report.calibration


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineSource(_SourceWithCaps):
    """The arm of a running Viam machine.

    Attributes:
        address: The machine's address.
        api_key_id: The id of an API key; None for a plain, direct connection.
        api_key: The key.
        arm: Which of its arms; None for the only one.
        gripper: Which of its grippers; None for the only one.
    """

    address: str
    api_key_id: str | None = None
    api_key: str | None = field(default=None, repr=False)
    arm: str | None = None
    gripper: str | None = None

    @property
    def what(self) -> str:
        """The source in words."""
        return f"arm of machine {self.address}"

    def open(self) -> MachineRig:
        """Open the arm and its gripper; nothing moves.

        Raises:
            So101Error: It cannot be reached, or a setting is not valid.
        """
        from so101_motion.viam.client import MachineRig

        with busy_message(f"connecting to machine {self.address}"):
            rig = MachineRig.connect(
                self.address,
                api_key_id=self.api_key_id,
                api_key=self.api_key,
                arm=self.arm,
                gripper=self.gripper,
            )
        return self._capped(rig)

    open_to_look = open


AnySource = Source | MachineSource
"""An arm of this computer or of a machine. Both open a rig that fits ``RigLike``."""

S = TypeVar("S", bound=AnySource)


def pace_options(verb: F) -> F:
    """Add ``--speed`` and ``--acceleration``; the decorator goes below that of the source."""

    @click.option(
        "--speed", type=Finite(*SPEED_RANGE_DEG), metavar="DEG/S", help="Joint speed cap."
    )
    @click.option(
        "--acceleration",
        type=Finite(*ACCELERATION_RANGE_DEG),
        metavar="DEG/S2",
        help="Joint acceleration cap.",
    )
    @functools.wraps(verb)
    def with_pace(
        *args: Any,
        source: AnySource,
        speed: float | None,
        acceleration: float | None,
        **kwargs: Any,
    ) -> Any:
        return verb(*args, source=with_caps(source, speed, acceleration), **kwargs)

    return with_pace  # type: ignore[return-value]  # its own options and those above


def with_caps(source: S, speed_deg: float | None, acceleration_deg: float | None) -> S:
    """The same source with caps on joint speed [deg/s] and acceleration [deg/s^2]."""
    from so101_motion.common.units import to_rad

    return replace(
        source,
        speed=None if speed_deg is None else to_rad(speed_deg),
        acceleration=None if acceleration_deg is None else to_rad(acceleration_deg),
    )


def source_options(verb: F) -> F:
    """Add ``--sim``, ``--port`` and ``--calibration``; the verb gets ``source``."""
    return _local_options(
        _with_source(verb, "which arm? give --sim, or --port and its serial port")
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CellSource:
    """Several arms that share a space.

    Attributes:
        file: The content of a cell file.
        title: A heading.
        path: Where it was read; None for arms that no file names.
    """

    file: CellFile
    title: str
    path: Path | None = None

    @property
    def what(self) -> str:
        """The names of the arms."""
        return ", ".join(each.name for each in self.file.arms)

    def open(self) -> CellRigs:
        """Open all arms; raises as ``open_cell``."""
        return open_arms(self.file)


def open_arms(file: CellFile) -> CellRigs:
    """Open all arms of a cell; raises as ``open_cell``."""
    from so101_motion.rig.cell_rigs import open_cell

    with interrupts.held():
        opened = open_cell(file)
        for name, rig in opened.rigs.items():
            note_opened(f"arm {name}", rig)
        return opened


def read_cell_source(path: Path) -> CellSource:
    """The arms of a cell file; raises as ``read_cell``."""
    from so101_motion.files.cell_file import read_cell

    return CellSource(file=read_cell(path), title=f"Arms of {path.name}", path=path)


def cell_option(verb: F) -> F:
    """Add ``--cell`` to the options of ``any_source_options``; the verb gets a ``CellSource``."""
    says = "Several arms that share a space: a cell file, as for so101 cell."
    return click.option("--cell", type=IN_FILE, help=says)(verb)


def any_source_options(verb: F) -> F:
    """Add the same options and ``--machine`` with its keys; the verb gets ``source``."""
    asks = "which arm? give --sim, or --port and its serial port, or --machine and its address"
    return _local_options(machine_options(_with_source(verb, asks)))


def _with_source(verb: F, asks: str) -> F:
    """Wrap ``verb`` so that it gets the source of these options."""

    @functools.wraps(verb)
    def with_source(
        *args: Any,
        sim: bool,
        port: str | None,
        calibration: Path | None,
        machine: MachineSource | None = None,
        cell: Path | None = None,
        **kwargs: Any,
    ) -> Any:
        asked = {"--sim": sim or None, "--port": port, "--machine": machine, "--cell": cell}
        chosen = chosen_among(asked)
        if chosen is None and kwargs.get("atlas") is not None:
            chosen = "--sim"  # an atlas needs no arm
        if chosen is None:
            raise click.UsageError(asks)
        _refuse_stray(calibration, chosen)
        source: AnySource = Source(port=port, calibration_file=calibration)
        if chosen == "--sim":
            source = Source(port=None)
        elif chosen == "--machine":
            assert machine is not None  # it was chosen
            source = machine
        elif chosen == "--cell":
            assert cell is not None  # it was chosen
            return verb(*args, source=read_cell_source(cell), **kwargs)
        return verb(*args, source=source, **kwargs)

    return with_source  # type: ignore[return-value]  # its own options and those above


def _refuse_stray(calibration: Path | None, chosen: str) -> None:
    if calibration is not None and chosen != "--port":
        raise click.UsageError("--calibration works only with --port; leave it out")


def machine_options(verb: F) -> F:
    """Add the options of a running machine; the verb gets ``machine``, None if none was named."""

    @click.option(
        "--machine",
        "address",
        envvar="SO101_MACHINE",
        metavar="ADDRESS",
        help="A running Viam machine (or SO101_MACHINE).",
    )
    @click.option(
        "--api-key-id",
        envvar="SO101_API_KEY_ID",
        metavar="ID",
        help="With --machine: its API key's id (or SO101_API_KEY_ID).",
    )
    @click.option(
        "--api-key",
        envvar="SO101_API_KEY",
        metavar="KEY",
        help="With --machine: its API key; better in SO101_API_KEY, which no process list shows.",
    )
    @click.option("--arm", metavar="NAME", help="With --machine: which arm, if it has several.")
    @click.option("--gripper", metavar="NAME", help="With --machine: which gripper, if several.")
    @functools.wraps(verb)
    def with_machine(
        *args: Any,
        address: str | None,
        api_key_id: str | None,
        api_key: str | None,
        arm: str | None,
        gripper: str | None,
        **kwargs: Any,
    ) -> Any:
        machine = None
        if address:
            machine = MachineSource(
                address=address, api_key_id=api_key_id, api_key=api_key, arm=arm, gripper=gripper
            )
        elif arm or gripper:
            raise click.UsageError("--arm and --gripper work only with --machine; give its address")
        return verb(*args, machine=machine, **kwargs)

    return with_machine  # type: ignore[return-value]  # its own options and those above


def calibration_option(verb: F) -> F:
    """Add ``--calibration``; the verb gets ``calibration``."""
    says = "The arm's calibration file; by default the one that fits its servos."
    return click.option("--calibration", type=click.Path(path_type=Path), help=says)(verb)


def _local_options(verb: F) -> F:
    sim = click.option("--sim", is_flag=True, help="The simulated arm; needs no hardware.")
    port = port_option("Serial port of the arm, such as /dev/ttyACM0")
    return sim(port(calibration_option(verb)))


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
