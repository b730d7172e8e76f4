"""The terminal of a guided verb: a live picture, permanent lines, and single keys.

If stderr is a file or a pipe, there is no picture and everything is printed in lines. If stdin is
not a terminal, or with ``--yes``, nothing is asked.

A step that talks to servos runs in a thread of its own and is always finished, also after Ctrl-C or
a key, so that no servo is left with half of its settings.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from datetime import UTC, datetime
from typing import Any, Self, TextIO, TypeVar

import click
from rich.columns import Columns
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from so101_motion.common.keys import Keys

T = TypeVar("T")

ENTER = "\n"

_FRAME = 0.1  # [s] between two pictures


class Quit(Exception):
    """The person at the keyboard wants to quit."""


class Terminal:
    """Shows a live picture and reads keys. Use it in a ``with`` block.

    Args:
        ask: Whether to wait for keys, if there is a terminal.
        events: Each line is also written there as a JSON object; None for nowhere.

    Attributes:
        is_manned: Whether a person is asked and can answer.
        pressed: The last key pressed during the last ``run``; empty without one.
    """

    def __init__(self, *, ask: bool = True, events: TextIO | None = None) -> None:
        self._console = Console(stderr=True, highlight=False)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._is_drawn = self._console.is_terminal
        self.is_manned = ask and self._is_drawn and sys.stdin.isatty()
        self.pressed = ""
        self._events = events
        self._last = ""
        self._keys: Keys | None = None

    def __enter__(self) -> Self:
        if self.is_manned:
            self._keys = Keys()
        if self._is_drawn:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_drawn:
            self._live.update(Text(""))
            self._live.stop()
        if self._keys is not None:
            self._keys.close()

    # Output

    def say(self, sentence: str, *, style: str = "", **facts: Any) -> None:
        """Print a permanent line; a line that repeats the last one is left out."""
        if sentence == self._last:
            return
        self._last = sentence
        if self._is_drawn:
            self._console.print(Text(sentence, style=style))
        else:
            click.echo(sentence, err=True)
        if self._events is not None:
            stamp = datetime.now(UTC).isoformat(timespec="milliseconds")
            self._events.write(json.dumps({"at": stamp, "says": sentence, **facts}) + "\n")
            self._events.flush()

    def mention(self, sentence: str, **facts: Any) -> None:
        """Print a line only if there is no live picture, which shows the same."""
        if not self._is_drawn:
            self.say(sentence, **facts)

    def show(self, *parts: RenderableType) -> None:
        if self._is_drawn:
            self._live.update(Group(*parts), refresh=True)

    # Keys

    def key(self, seconds: float) -> str:
        """Wait for a key for so many seconds; returns it in lower case, or empty.

        Raises:
            Quit: It is ``q``.
        """
        if self._keys is None:
            time.sleep(seconds)
            return ""
        pressed = self._keys.read(seconds).lower()
        if pressed.startswith("q"):
            raise Quit
        return ENTER if pressed[:1] in ("\r", "\n") else pressed[:1]

    # Steps

    def run(self, work: Callable[[], T], picture: Callable[[], RenderableType]) -> T:
        """Run ``work`` with a live picture, and return its result.

        Raises:
            Quit: ``q`` was pressed; ``work`` has ended.
            KeyboardInterrupt: Ctrl-C was pressed; ``work`` has ended.
            Exception: As ``work`` raised it.
        """
        self.pressed = ""
        with ThreadPoolExecutor(1, thread_name_prefix="so101-guided") as beside:
            future = beside.submit(work)
            try:
                while not future.done():
                    self.show(picture())
                    if self.is_manned:
                        self.pressed = self.key(_FRAME) or self.pressed
                    else:
                        wait((future,), _FRAME)
            except (Quit, KeyboardInterrupt):
                if not future.done():
                    self.say("finishing the step that has begun ...")
                raise
            finally:
                wait((future,))  # a join that Ctrl-C has interrupted believes the thread has ended
            return future.result()


def sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(("?", ".")) else ".")


def keys_line(**keys: str) -> Columns:
    """A line with the keys: ``keys_line(Enter="save", q="quit")``."""
    return Columns(Text(f" {key} ", "reverse") + Text(f" {what}") for key, what in keys.items())
