"""Options and helpers that verbs share: printing results, asking a person, writing reports."""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from functools import partial
from importlib.metadata import requires
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from so101_motion import __version__
from so101_motion.common import interrupts
from so101_motion.common.errors import ConfigError
from so101_motion.common.modes import HELD, Mode
from so101_motion.common.realtime import LOOK_FOR_SIGNALS

if TYPE_CHECKING:
    from so101_motion.arm.arm import Arm
    from so101_motion.rig.protocols import GripperLike, RigLike
    from so101_motion.tasks.program import Arms

R = TypeVar("R", bound="RigLike")
T = TypeVar("T")

NO_DEVICE, CHECK_FAILED, STOPPED, INTERRUPTED = 3, 6, 7, 130
"""Exit codes that verbs use themselves; ``error_exit.py`` has all of them."""

DEBUG = "SO101_DEBUG"
"""Environment variable: when it is set, unexpected errors are shown with their traceback."""

_PRINTED = f"{__name__}.printed"  # in the context: whether the JSON object has been printed


@contextmanager
def busy_message(words: str) -> Iterator[None]:
    """Show a spinner with ``words`` during the block, if stderr is a terminal."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(words):
        yield


@contextmanager
def quietly() -> Iterator[None]:
    """Switch off the package's log lines during the block, so that they do not mix with output."""
    log = logging.getLogger("so101_motion")
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(logging.NOTSET)


@contextmanager
def in_lines() -> Iterator[None]:
    """Print log lines on stderr during the block, with tracebacks only in debug mode."""
    log = logging.getLogger("so101_motion")
    handler = logging.StreamHandler() if os.environ.get(DEBUG) else _Brief()
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)


class _Brief(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        with suppress(Exception):  # whoever logs must go on
            aside(record.getMessage())


def print_json(kind: str, content: Mapping[str, object]) -> None:
    whole = {"schema": f"so101/{kind}/1", "version": __version__, **content}
    click.echo(json.dumps(whole, indent=2))
    context = click.get_current_context(silent=True)
    if context is not None:
        context.meta[_PRINTED] = True


def answer(as_json: bool, kind: str, content: Mapping[str, object], text: str) -> None:
    """Print the result of a verb on stdout: as JSON for programs, or a text for people."""
    if as_json:
        print_json(kind, content)
    else:
        click.echo(text.rstrip("\n"))


def has_printed() -> bool:
    context = click.get_current_context(silent=True)
    return context is not None and _PRINTED in context.meta


def echo(text: str, *, indent: str = "", err: bool = False) -> None:
    """Print text, wrapped between words on a terminal."""
    stream = sys.stderr if err else sys.stdout
    if stream is not None and stream.isatty():
        wrapper = textwrap.TextWrapper(
            shutil.get_terminal_size().columns,
            initial_indent=indent,
            subsequent_indent=indent + "  ",
            break_long_words=False,
            break_on_hyphens=False,
        )
        text = "\n".join(wrapper.fill(line) for line in text.splitlines())
    else:
        text = indent + text
    click.echo(text, err=err)


def aside(sentence: str) -> None:
    """Print a sentence on stderr."""
    echo(sentence, err=True)


class Verbs(click.Group):
    """A group of verbs, each listed with its whole first sentence, and their examples."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        texts = "\n".join(verb.help or "" for verb in self.commands.values())
        shown = re.findall(r"^ *(so101 .*)", texts, re.MULTILINE)
        with formatter.section("Examples"):
            formatter.write("".join(f"  {each}\n" for each in shown))

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        rows = ((name, verb.get_short_help_str(200)) for name, verb in self.commands.items())
        with formatter.section("Commands"):
            formatter.write_dl(sorted(rows))


def have_agreed(
    question: str, yes: bool = False, otherwise: str = "; give --yes to start without asking"
) -> None:
    """Ask a person before something moves, unless ``yes``; ends the verb if the answer is no.

    ``otherwise`` says what to do where nobody can be asked.
    """
    if not (yes or agrees(question, otherwise)):
        aside("nothing moved")
        raise SystemExit(STOPPED)


def agrees(question: str, otherwise: str) -> bool:
    """Ask a person; the arguments are those of ``have_agreed``."""
    nobody = click.UsageError(f"there is no terminal to ask on{otherwise}")
    if sys.stdin is None:  # it was closed
        raise nobody
    try:
        return click.confirm(question, err=True)
    except click.Abort as abort:
        if isinstance(abort.__context__, EOFError):
            raise nobody from None
        raise KeyboardInterrupt from None


def run_beside(work: Callable[[], T], cancel: Callable[[], None]) -> T:
    """Run ``work`` on another thread; Ctrl-C calls ``cancel``, and its end is awaited."""
    with ThreadPoolExecutor(1, thread_name_prefix="so101-work") as beside:
        running = beside.submit(work)
        while not running.done():
            try:
                wait((running,), LOOK_FOR_SIGNALS)
            except KeyboardInterrupt:
                interrupts.taken()
                cancel()
        return running.result()


@contextmanager
def stops_on_ctrl_c(moving: Arm | Arms | GripperLike) -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        moving.stop()
        raise


_DOES = {
    Mode.HOLDING: "holds",
    Mode.MOVING: "may still move",
    Mode.STOPPING: "may still move",
    Mode.LIMP: "is limp",
    Mode.GUIDING: "yields to a hand",
    Mode.CALIBRATING: "is being calibrated",
}

opened: list[Callable[[], str]] = []  # each tells what an arm does that this verb has opened


def note_opened(what: str, rig: R) -> R:
    """Note that a verb has opened ``rig``, so that its end can tell what the arm does."""
    opened.append(partial(_state_of, what, rig))
    return rig


def tell_torque(port: str, limp: str = "") -> None:
    """Let the end of this verb, which has closed ``port``, tell whether its joints are held.

    ``limp`` is what it says if they are not.
    """
    from so101_motion.setup.calibrator import Calibrator, about_torque

    def tell() -> str:
        with quietly():
            holds = Calibrator.open(port, Path("no file")).leave()
            return limp if limp and holds is False else about_torque(holds)

    opened.append(tell)


def state_of_opened_arms() -> str:
    """What the arms that this verb has opened do, now that it ends; empty if it opened none."""
    return "; ".join(tell() for tell in opened)


def _state_of(what: str, rig: RigLike) -> str:
    from so101_motion.rig.hardware_rig import HardwareRig

    try:
        rig.close()  # where it was not closed yet, this waits until the arm rests
        state = rig.arm.state
    except Exception as error:
        return f"what the {what} does is not known: {error}"
    if state.mode is Mode.FAULT:
        why = f": {state.fault}" if interrupts.first() else ""  # otherwise an error has said it
        return f"servos of the {what} that have power hold where they are, others sink{why}"
    if state.mode is Mode.LIMP and isinstance(rig, HardwareRig) and rig.held is None:
        return f"the {what} is as it was found"
    gone = next(iter(sorted(state.reading.let_go)), None)
    if gone is not None and state.mode in HELD:
        why = f": {state.reading.alarms[gone]}" if interrupts.first() else ""
        return f"{gone} of the {what} has let go and may sink, the others hold{why}"
    return f"the {what} {state.torque or _DOES[state.mode]}"


def write_report(path: Path, content: bytes) -> None:
    """Write a report file; ``ConfigError`` if it cannot be written."""
    from so101_motion.files import atomic

    atomic.save("report", path, content)
    aside(f"written to {path}")


def import_preview() -> Any:
    """Import ``so101_viewer``, which serves the page; ``ConfigError`` if it is not installed."""
    try:
        import so101_viewer
    except ModuleNotFoundError as error:
        wanted = [
            found[1]
            for line in requires("so101-motion") or ()
            if (found := re.match(r"([^;\s]+)\s*;.*extra == .viewer.", line))
        ]
        reason = (
            f"needs {error.name}, which is not installed; install it:"
            f" {sys.executable} -m pip install {' '.join(wanted)} (so101 demo --text does without)"
        )
        raise ConfigError("preview", None, reason) from error
    return so101_viewer
