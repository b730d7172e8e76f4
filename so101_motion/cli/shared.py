"""What all verbs have in common: exit codes, errors as sentences, how results are printed.

Exit codes: 0 ok, 1 unexpected, 2 wrong usage, 3 no device, no port or no machine, 4 bus or servo
fault, 5 unreachable or no plan, 6 not calibrated or a check failed, 7 stopped, 130 Ctrl-C.

An error is told on stderr in two or three lines: what, why, and what to try. How the first are
parted is in ``telling.py``.
"""

from __future__ import annotations

import functools
import json
import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import click

from so101_motion import __version__
from so101_motion.cli.telling import parted
from so101_motion.errors import (
    BusError,
    CalibrationError,
    ConfigError,
    Interrupted,
    MachineUnavailable,
    MotionError,
    MotorSetupError,
    PlanningError,
    PortUnavailable,
    So101Error,
)

F = TypeVar("F", bound=Callable[..., Any])

NO_DEVICE, CHECK_FAILED, STOPPED, INTERRUPTED = 3, 6, 7, 130
"""Exit codes that no error stands for."""

_EXIT_CODES: tuple[tuple[type[So101Error], int], ...] = (
    (PlanningError, 5),
    (PortUnavailable, 3),
    (MachineUnavailable, 3),
    (BusError, 4),
    (MotorSetupError, 4),
    (CalibrationError, 6),
    (Interrupted, 7),
    (MotionError, 4),
    (ConfigError, 2),
)


DEBUG = "SO101_DEBUG"
"""Environment variable: when it is set, an unexpected error comes with its traceback."""


def fail(error: So101Error) -> NoReturn:
    """Say what went wrong, why, and what to try, and leave with its exit code."""
    told = parted(error)
    click.echo(f"error: {told.what}", err=True)
    if told.why:
        click.echo(f"  why: {told.why}", err=True)
    if told.advice:
        click.echo(f"  try: {told.advice}", err=True)
    code = next((code for kind, code in _EXIT_CODES if isinstance(error, kind)), 1)
    raise SystemExit(code)


def reports_errors(verb: F) -> F:
    """Turn errors into sentences and an exit code, and Ctrl-C into 130."""

    @functools.wraps(verb)
    def reporting(*args: Any, **kwargs: Any) -> Any:
        try:
            return verb(*args, **kwargs)
        except So101Error as error:
            fail(error)
        except KeyboardInterrupt:
            raise SystemExit(INTERRUPTED) from None
        except (click.ClickException, click.Abort, click.exceptions.Exit, BrokenPipeError):
            raise  # click's to tell; a reader of our output who has enough, it ends in silence
        except Exception as error:
            if os.environ.get(DEBUG):
                raise
            click.echo(f"error: unexpected: {type(error).__name__}: {error}", err=True)
            click.echo("  why: a defect of this program", err=True)
            click.echo(f"  try: the same with {DEBUG}=1 shows where; please report it", err=True)
            raise SystemExit(1) from error

    return reporting  # type: ignore[return-value]  # the same signature, by functools.wraps


@contextmanager
def patience(words: str) -> Iterator[None]:
    """Show that something takes a moment: a spinner on a terminal, nothing anywhere else."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(words):
        yield


@contextmanager
def quietly() -> Iterator[None]:
    """Keep log lines out of the picture; what a person must know is said in it."""
    log = logging.getLogger("so101_motion")
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(logging.NOTSET)


def print_json(kind: str, content: Mapping[str, object]) -> None:
    """One JSON object on stdout, for programs."""
    whole = {"schema": f"so101/{kind}/1", "version": __version__, **content}
    click.echo(json.dumps(whole, indent=2))


def aside(sentence: str) -> None:
    """Tell a person something beside what was asked for."""
    click.echo(sentence, err=True)


class Verbs(click.Group):
    """Verbs of one kind, each listed with its whole first sentence."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the verbs."""
        rows = [
            (name, verb.get_short_help_str(200)) for name, verb in sorted(self.commands.items())
        ]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def have_agreed(question: str) -> None:
    """Ask a person before something moves; return if the answer is yes.

    Raises:
        click.UsageError: Nobody is there to answer.
        SystemExit: The answer is no, or Ctrl-C.
    """
    try:
        agreed = click.confirm(question, err=True)
    except click.Abort as abort:
        if isinstance(abort.__context__, EOFError):
            raise click.UsageError("nobody is there to agree; --yes goes without asking") from None
        raise SystemExit(INTERRUPTED) from None
    if not agreed:
        aside("nothing moved")
        raise SystemExit(STOPPED)


def write_report(path: Path, content: bytes) -> None:
    """Write what ``--report`` asks for.

    Raises:
        ConfigError: It cannot be written there.
    """
    try:
        path.write_bytes(content)
    except OSError as error:
        reason = f"cannot be written: {error.strerror or error}"
        raise ConfigError("report", str(path), reason) from error
    aside(f"written to {path}")


def json_option(verb: F) -> F:
    """The option ``--json``; the verb gets ``as_json``."""
    return click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")(verb)


def dry_run_option(verb: F) -> F:
    """The option ``--dry-run``; the verb gets ``dry_run``."""
    says = "Say what would be done, and write nothing."
    return click.option("--dry-run", is_flag=True, help=says)(verb)


def import_preview() -> Any:
    """What serves the browser preview: ``so101_viewer``, imported when it is needed.

    Raises:
        click.ClickException: The extra that holds it was not installed.
    """
    try:
        import so101_viewer
    except ModuleNotFoundError as error:
        raise click.ClickException(
            f"the preview needs {error.name}, which is not installed\n"
            "try: pip install 'so101-motion[viewer]', or so101 demo --text"
        ) from error
    return so101_viewer
