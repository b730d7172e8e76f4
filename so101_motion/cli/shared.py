"""What all verbs have in common: exit codes, where the arm comes from, how results are printed.

Exit codes: 0 ok, 1 unexpected, 2 wrong usage, 3 no device or no port, 4 bus or servo fault,
5 unreachable or no plan, 6 not calibrated or a check failed, 7 stopped, 130 Ctrl-C.
"""

from __future__ import annotations

import functools
import json
import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import click

from so101_motion import __version__
from so101_motion.errors import (
    BusError,
    CalibrationError,
    ConfigError,
    Interrupted,
    MotionError,
    MotorSetupError,
    PlanningError,
    PortUnavailable,
    So101Error,
)

if TYPE_CHECKING:
    from so101_motion.geometry import Array
    from so101_motion.rig import Rig

F = TypeVar("F", bound=Callable[..., Any])

NO_DEVICE, CHECK_FAILED, STOPPED, INTERRUPTED = 3, 6, 7, 130
"""Exit codes that no error stands for."""

_EXIT_CODES: tuple[tuple[type[So101Error], int], ...] = (
    (PlanningError, 5),
    (PortUnavailable, 3),
    (BusError, 4),
    (MotorSetupError, 4),
    (CalibrationError, 6),
    (Interrupted, 7),
    (MotionError, 4),
    (ConfigError, 2),
)


def fail(error: So101Error) -> NoReturn:
    """Say what went wrong and leave with its exit code."""
    click.echo(f"error: {error}", err=True)
    code = next((code for kind, code in _EXIT_CODES if isinstance(error, kind)), 1)
    raise SystemExit(code)


def reports_errors(verb: F) -> F:
    """Turn this package's errors into a sentence and an exit code, and Ctrl-C into 130."""

    @functools.wraps(verb)
    def reporting(*args: Any, **kwargs: Any) -> Any:
        try:
            return verb(*args, **kwargs)
        except So101Error as error:
            fail(error)
        except KeyboardInterrupt:
            raise SystemExit(130) from None

    return reporting  # type: ignore[return-value]  # the same signature, by functools.wraps


@contextmanager
def quietly() -> Iterator[None]:
    """Keep log lines out of the picture; what a person must know is said in it."""
    log = logging.getLogger("so101_motion")
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(before)


def print_json(kind: str, content: Mapping[str, object]) -> None:
    """One JSON object on stdout, for programs."""
    whole = {"schema": f"so101/{kind}/1", "version": __version__, **content}
    click.echo(json.dumps(whole, indent=2))


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Where the arm comes from.

    Attributes:
        port: Serial port of a real or emulated arm; None for the simulated one.
        calibration_file: Its calibration; None to look for the one that fits its servos.
        speed: Joint speed cap [rad/s]; None for the default.
        acceleration: Joint acceleration cap [rad/s^2]; None for the default.
    """

    port: str | None
    calibration_file: Path | None = None
    speed: float | None = None
    acceleration: float | None = None

    @property
    def what(self) -> str:
        """In words."""
        return "simulated arm" if self.port is None else f"arm on {self.port}"

    def open(self, *, q_start: Array | None = None) -> Rig:
        """The arm and its gripper, ready to be asked.

        Args:
            q_start: Where the simulated arm stands, shape (5,), [rad]; zeros by default.

        Raises:
            So101Error: It cannot be reached, or a setting cannot be meant.
        """
        from so101_motion.rig import open_hardware, open_simulated

        rig: Rig
        if self.port is None:
            rig = open_simulated(q_start=q_start)
        else:
            from so101_motion.hardware_config import SERVO_IDS
            from so101_motion.servos import ServoSettings

            file = self.calibration_file or _known_calibration(self.port)
            asked = ServoSettings(port=self.port, calibration_file=file)
            rig = open_hardware(asked.with_arm(SERVO_IDS))
        try:
            if self.speed is not None:
                rig.arm.set_speed(self.speed)
            if self.acceleration is not None:
                rig.arm.set_acceleration(self.acceleration)
        except BaseException:
            rig.close()
            raise
        return rig


def _known_calibration(port: str) -> Path | None:
    """The calibration file that fits the arm on a port, and a word about it on stderr.

    Raises:
        PortUnavailable: The port cannot be used, and why.
    """
    from so101_motion.cli.finding import look_at

    file = look_at(port).calibration
    if file is None:
        click.echo(
            "no calibration file of this arm is known, so zero is the middle of each joint's travel"
            " and points are some 40 mm off; so101 calibrate makes one, --calibration names one",
            err=True,
        )
    else:
        click.echo(f"calibration: {file}", err=True)
    return file


def source_options(verb: F) -> F:
    """The options ``--sim``, ``--port``, ``--calibration``; the verb gets ``source``."""

    @click.option("--sim", is_flag=True, help="The simulated arm; needs no hardware.")
    @click.option(
        "--port",
        envvar="SO101_PORT",
        metavar="PORT",
        help="Serial port of the arm, such as /dev/ttyACM0 (or SO101_PORT).",
    )
    @click.option(
        "--calibration",
        type=click.Path(path_type=Path),
        help="The arm's calibration file; by default the one that fits its servos.",
    )
    @functools.wraps(verb)
    def with_source(
        *args: Any, sim: bool, port: str | None, calibration: Path | None, **kwargs: Any
    ) -> Any:
        named_here = click.get_current_context().get_parameter_source("port")
        if sim and port and named_here is click.core.ParameterSource.COMMANDLINE:
            raise click.UsageError("give either --sim or --port, not both")
        if not sim and not port:
            raise click.UsageError("which arm? give --sim, or --port and its serial port")
        source = Source(port=None if sim else port, calibration_file=calibration)
        return verb(*args, source=source, **kwargs)

    return with_source  # type: ignore[return-value]  # its own options and those above


def json_option(verb: F) -> F:
    """The option ``--json``; the verb gets ``as_json``."""
    return click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")(verb)


def import_preview() -> Any:
    """What serves the browser preview: ``so101_viewer.serve``, imported when it is needed.

    Raises:
        click.ClickException: The extra that holds it was not installed.
    """
    try:
        from so101_viewer import serve
    except ModuleNotFoundError as error:
        raise click.ClickException(
            f"the preview needs {error.name}, which is not installed\n"
            "try: pip install 'so101-motion[viewer]', or so101 demo --text"
        ) from error
    return serve
