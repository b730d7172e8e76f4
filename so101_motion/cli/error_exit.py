"""End a verb that failed: a message for people, an object for programs, an exit code.

Exit codes: 0 ok, 1 unexpected, 2 wrong usage, 3 no device, no port or no machine, 4 bus or servo
fault, 5 unreachable or no plan, 6 not calibrated or a check failed, 7 stopped, 130 Ctrl-C.

An error is printed on stderr in up to four lines: what, why, what an arm does now that the verb had
opened, and what to try. With ``--json`` the
same is printed as one object on stdout, unless the verb has printed its own object already.

``parted`` splits an error message into what went wrong, why, and what to try.

Most errors of this package have one sentence that ends with advice. Where an error has fields for
its parts, they are used; otherwise the advice is the text behind the last semicolon or full stop,
if it begins with one of ``_VERBS``.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import NamedTuple, NoReturn

import click

from so101_motion.cli.shared import (
    DEBUG,
    INTERRUPTED,
    echo,
    has_printed,
    print_json,
    state_of_opened_arms,
)
from so101_motion.common import errors, interrupts
from so101_motion.common.errors import LONGEST_QUOTE, So101Error, clipped, quoted
from so101_motion.common.import_check import explain

_VERBS = (
    "add|ask|attach|back|build|calibrate|check|choose|clear|close|configure|connect|do|end|"
    "finish|free|give|guide|hold|install|keep|leave|let|list|look|loosen|lower|make|"
    "mend|move|name|open|plan|plug|press|put|raise|read|remove|replace|run|save|"
    "see|send|set|start|stop|support|switch|take|try|turn|use|wait|widen"
)
_ADVICE = re.compile(rf"(?:; |\. |, so )(?=(?:{_VERBS}) )", re.IGNORECASE)


class ErrorText(NamedTuple):
    """The parts of an error message."""

    what: str  # what went wrong
    why: str = ""  # the reason; empty if ``what`` includes it
    advice: str = ""  # what to try; empty without any
    now: str = ""  # what the arms do now that the verb had opened


def parted(error: So101Error) -> ErrorText:
    text = _parted(error)
    if text.what.startswith(error.context):
        return text
    return text._replace(what=f"{error.context}{text.what}")


def _parted(error: So101Error) -> ErrorText:
    if isinstance(error, errors.CalibrationError | errors.MotorSetupError):
        what = f"{error.joint}: {error.reason}" if error.joint else error.reason
        return ErrorText(what, advice=error.next_step)
    if isinstance(error, errors.ConfigError):
        given = "" if error.value is None else f" = {quoted(error.value)}"
        return ErrorText(f'"{clipped(error.key, LONGEST_QUOTE)}"{given}', *_split(error.reason))
    if isinstance(error, errors.PortUnavailable):
        return ErrorText(f"the port {error.port} cannot be used", *_split(error.reason))
    if isinstance(error, errors.MachineUnavailable):
        return ErrorText(f"machine {error.address}", *_split(error.reason))
    if isinstance(error, errors.MachineRefused):
        why, advice = _split(error.reason)
        return ErrorText(error.what, f"the machine says: {why}", advice)
    what, advice = _split(str(error))
    what = ". ".join((what, *getattr(error, "__notes__", ())))
    if isinstance(error, errors.InCollision) and error.can_back_out:
        advice += "; so101 move --leave-contact backs it out"
    return ErrorText(what, advice=advice)


def _split(sentence: str) -> tuple[str, str]:
    found = [*_ADVICE.finditer(sentence)]
    if not found:
        return sentence, ""
    last = found[-1]
    advice = sentence[last.end() :]
    return sentence[: last.start()], advice[:1].lower() + advice[1:]


_EXIT_CODES: tuple[tuple[type[So101Error], int], ...] = (
    (errors.PlanningError, 5),
    (errors.PortUnavailable, 3),
    (errors.MachineUnavailable, 3),
    (errors.BusError, 4),
    (errors.MotorSetupError, 4),
    (errors.NotPossibleNow, 6),
    (errors.CalibrationError, 6),
    (errors.Interrupted, 7),
    (errors.MotionError, 4),
    (errors.ConfigError, 2),
)

KINDS: dict[int, tuple[str, str]] = {  # name and default message of each exit code
    1: ("unexpected", "something unexpected happened"),
    2: ("usage", "the command line is wrong"),
    3: ("unavailable", "there is no such device"),
    4: ("fault", "a servo or the bus has a fault"),
    5: ("no_plan", "there is no plan"),
    6: ("check_failed", "a check failed"),
    7: ("stopped", "stopped before the end"),
    130: ("interrupted", "ended by Ctrl-C"),
}


@contextmanager
def reports_errors(*, as_json: bool = False) -> Iterator[None]:
    """Print the errors raised in this block and exit with their code; Ctrl-C is 130.

    A wrong usage is raised again, for click to print.
    """
    try:
        yield
        if interrupts.first():  # such as teleoperation, which Ctrl-C ends in order
            raise KeyboardInterrupt
    except BaseException as error:
        if interrupts.first() or isinstance(error, KeyboardInterrupt):
            # Whatever else it is came of the signal: libraries catch it while they are imported.
            told = str(error) if isinstance(error, So101Error | interrupts.ToldInterrupt) else ""
            _print_interrupted(told, as_json=as_json)
        _tell(error, as_json=as_json)
        raise


def _tell(error: BaseException, *, as_json: bool) -> None:
    """Print an error, unless click or the verb does; ``SystemExit`` with the code of ours."""
    if isinstance(error, So101Error):
        code = next((code for kind, code in _EXIT_CODES if isinstance(error, kind)), 1)
        text = parted(error)
        if code in (3, 4):
            text = text._replace(now=state_of_opened_arms())
        _print_error(text, code, as_json=as_json, name=type(error).__name__)
        raise SystemExit(code) from error
    if isinstance(error, SystemExit):  # the verb has printed why
        if isinstance(error.code, int) and error.code:
            text = ErrorText(what=KINDS.get(error.code, KINDS[1])[1])
            _print_for_programs(text, error.code, as_json=as_json)
    elif isinstance(error, click.ClickException):
        context = getattr(error, "ctx", None)
        advice = "" if context is None else f"{context.command_path} --help"
        text = ErrorText(what=error.format_message(), advice=advice)
        _print_for_programs(text, error.exit_code, as_json=as_json)
    elif isinstance(error, click.Abort | click.exceptions.Exit | BrokenPipeError):
        pass  # click handles these; a closed pipe ends the verb without a message
    elif isinstance(error, Exception) and not os.environ.get(DEBUG):
        _print_error(_unexpected(error), 1, as_json=as_json, name=type(error).__name__)
        raise SystemExit(1) from error


def _print_interrupted(why: str, *, as_json: bool) -> NoReturn:
    """Print by what the verb was ended and what the arm does now, and exit with 130."""
    interrupts.taken()
    by = f"ended by {interrupts.first() or 'Ctrl-C'}"
    state = "; ".join(part for part in (why, state_of_opened_arms()) if part) or "nothing moved"
    echo(f"{by}; {state}", err=True)
    _print_for_programs(ErrorText(what=by, why=state), INTERRUPTED, as_json=as_json)
    raise SystemExit(INTERRUPTED) from None


def _print_error(text: ErrorText, code: int, *, as_json: bool, name: str) -> None:
    echo(f"error: {text.what}", err=True)
    if text.why:
        echo(f"why: {text.why}", indent="  ", err=True)
    if text.now:
        echo(f"now: {text.now}", indent="  ", err=True)
    if text.advice:
        echo(f"try: {text.advice}", indent="  ", err=True)
    _print_for_programs(text, code, as_json=as_json, name=name)


def _print_for_programs(text: ErrorText, code: int, *, as_json: bool, name: str = "") -> None:
    if not as_json or has_printed():
        return
    kind, _ = KINDS.get(code, KINDS[1])
    words = {"what": text.what, "why": text.why, "try": text.advice}
    words |= {"now": text.now} if text.now else {}
    with suppress(OSError):  # stdout itself may fail; the error is on stderr already
        print_json("error", {"kind": kind, "exit_code": code, "error": name, **words})


def _unexpected(error: Exception) -> ErrorText:
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
        return ErrorText(
            what=f"a file cannot be written: {error.strerror}",
            advice="make room on the disk, or choose another folder",
        )
    missing = explain(error) if isinstance(error, ImportError) else None
    if missing is not None:
        return ErrorText(what=missing[0], advice=missing[1])
    why = "a defect of this program"
    if isinstance(error, OSError):
        why = "the system refused an operation, or this is a defect of this program"
    return ErrorText(
        what=f"unexpected: {type(error).__name__}: {error}",
        why=why,
        advice=f"run it again with {DEBUG}=1 to see where, and please report it",
    )
