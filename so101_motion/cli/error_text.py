"""Split an error message into what went wrong, why, and what to try.

Most errors of this package have one sentence that ends with advice. Where an error has fields for
its parts, they are used; otherwise the advice is the text behind the last semicolon or full stop,
if it begins with one of ``_VERBS``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from so101_motion.common.errors import (
    LONGEST_QUOTE,
    CalibrationError,
    ConfigError,
    MachineRefused,
    MachineUnavailable,
    MotorSetupError,
    PortUnavailable,
    So101Error,
    clipped,
    quoted,
)

_VERBS = (
    "add|ask|attach|calibrate|check|choose|clear|close|configure|connect|do|end|finish|free|give|"
    "hold|install|keep|leave|let|list|look|loosen|lower|make|mend|move|name|open|plan|plug|press|"
    "put|raise|read|remove|replace|run|save|see|send|set|start|stop|support|switch|take|try|turn|use|"
    "wait|widen"
)
_ADVICE = re.compile(rf"(?:; |\. |, so )(?=(?:{_VERBS}) )", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorText:
    """The parts of an error message.

    Attributes:
        what: What went wrong.
        why: The reason; empty if ``what`` includes it.
        advice: What to try; empty without any.
    """

    what: str
    why: str = ""
    advice: str = ""


def parted(error: So101Error) -> ErrorText:
    """Split ``error`` into its parts."""
    if isinstance(error, (CalibrationError, MotorSetupError)):
        what = f"{error.joint}: {error.reason}" if error.joint else error.reason
        return ErrorText(what=what, advice=error.next_step)
    if isinstance(error, ConfigError):
        why, advice = _split(error.reason)
        given = "" if error.value is None else f" = {quoted(error.value)}"
        return ErrorText(
            what=f'"{clipped(error.key, LONGEST_QUOTE)}"{given}', why=why, advice=advice
        )
    if isinstance(error, (PortUnavailable, MachineUnavailable)):
        name = error.port if isinstance(error, PortUnavailable) else f"machine {error.address}"
        why, advice = _split(error.reason)
        return ErrorText(what=name, why=why, advice=advice)
    if isinstance(error, MachineRefused):
        why, advice = _split(error.reason)
        return ErrorText(what=error.what, why=f"the machine says: {why}", advice=advice)
    what, advice = _split(str(error))
    return ErrorText(what=what, advice=advice)


def _split(sentence: str) -> tuple[str, str]:
    """Split the advice from the end of a sentence."""
    found = [*_ADVICE.finditer(sentence)]
    if not found:
        return sentence, ""
    last = found[-1]
    return sentence[: last.start()], sentence[last.end() :]
