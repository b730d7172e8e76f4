"""Ctrl-C, SIGTERM and SIGHUP in a program: none is lost, and none cuts short what ends the program.

``listen`` is called first. The first signal raises ``KeyboardInterrupt`` in the main thread. Code
that swallows it, such as a callback, gets another one 0.2 s later. Nothing is raised in an import:
libraries take any exception in it for a part that is missing, or crash. As imports take seconds on
a busy computer, a program that has nothing open yet ends there at once. While a
``KeyboardInterrupt`` is handled, in an ``except`` or ``finally`` or at the end of a ``with``, more
signals raise nothing, and neither do they in a block of ``held`` or after ``taken``. So motions
come to rest and ports are closed however often Ctrl-C is pressed. A program that has not ended
10 s after the first signal is ended by the next one, where it is.

A thread raises again, because Python itself hears a signal late that comes just before the main
thread begins to wait, or in another thread: when that wait is over, whatever it waits for.

In a program that does not call ``listen`` all of this does nothing.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_REPEAT = 0.2  # [s] between two attempts to raise
_PATIENCE = 10.0  # [s] for the end of the program after the first signal

_THREAD = "so101-signals"
_HARMLESS = ("MainThread", "so101-planning", _THREAD)  # threads that drive no arm and serve no page

_IMPORT = "<frozen importlib._bootstrap>"

_NAMES = {"SIGINT": "Ctrl-C", "SIGTERM": "SIGTERM", "SIGHUP": "the end of the terminal (SIGHUP)"}


class ToldInterrupt(KeyboardInterrupt):
    """A signal has ended what went on; the message tells how it is left.

    The message of a plain ``KeyboardInterrupt`` may be Python's own: a codec adds one.
    """


class _Interrupts:
    """The signals of this process."""

    def __init__(self) -> None:
        self.first = ""
        self.heard = 0
        self.since = 0.0
        self.holds = 0
        self.is_taken = False
        self.on_hung: Callable[[str], None] = lambda name: None
        self.on_import: Callable[[str], None] = lambda name: None

    def on_signal(self, number: int, frame: FrameType | None) -> None:
        self.heard += 1
        if not self.first:
            self.first = _NAMES[signal.Signals(number).name]
            self.since = time.monotonic()
        elif time.monotonic() - self.since > _PATIENCE:
            self.on_hung(self.first)
            os._exit(130)
        self.raise_once()

    def raise_once(self) -> None:
        if not self.first or self.holds or self.is_taken or _is_handled():
            return
        if not _imports():
            raise KeyboardInterrupt
        if all(thread.name in _HARMLESS for thread in threading.enumerate()):
            self.on_import(self.first)


_this = _Interrupts()


def listen(on_hung: Callable[[str], None], on_import: Callable[[str], None]) -> None:
    """Take the signals of this process from now on; one that is ignored (``nohup``) stays ignored.

    Args:
        on_hung: Called with the name of the first signal before the program is ended by force.
        on_import: Called with it in an import of the main thread while no thread drives an arm or
            serves a page; it may end the program where it is.
    """
    _this.on_hung, _this.on_import = on_hung, on_import
    for number in _numbers():
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _this.on_signal)
    if sys.platform != "win32":
        signal.signal(signal.SIGALRM, lambda *_: _this.raise_once())
        heard, tell = os.pipe()
        os.set_blocking(tell, False)
        signal.set_wakeup_fd(tell, warn_on_full_buffer=False)
        threading.Thread(target=_keep_raising, args=(heard,), name=_THREAD, daemon=True).start()
    sys.unraisablehook = _unraisable


def _keep_raising(heard: int) -> None:
    """Call ``raise_once`` in the main thread again and again after the first signal.

    Not on Windows, where only the next Ctrl-C does.
    """
    while os.read(heard, 1)[0] not in _numbers():
        pass  # another signal that the program handles
    while not _this.is_taken:
        time.sleep(_REPEAT)
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGALRM)


def _unraisable(lost: sys.UnraisableHookArgs) -> None:
    """Print what was raised where nothing can catch it, but no interrupt: that is raised again."""
    if not (_this.first and isinstance(lost.exc_value, KeyboardInterrupt)):
        sys.__unraisablehook__(lost)


def first() -> str:
    """The name of the first signal, for people; empty if none has come."""
    return _this.first


def heard() -> int:
    """How many signals have come."""
    return _this.heard


def prolong() -> None:
    """Count the time to the end of the program from now on: an arm is on its way to rest."""
    _this.since = time.monotonic()


def taken() -> None:
    """Say that the signal was heard and is being obeyed: no more are raised."""
    _this.is_taken = True


def end() -> None:
    """Ignore signals from now on: the program has ended and leaves with its exit code."""
    taken()
    for number in _numbers():
        signal.signal(number, signal.SIG_IGN)  # the interpreter's end leaves this


def _numbers() -> list[signal.Signals]:
    return [number for number in signal.Signals if number.name in _NAMES]


@contextmanager
def held() -> Iterator[None]:
    """Let this block end first: a signal that comes in it raises ``KeyboardInterrupt`` after it.

    In other threads than the main one it does nothing; no signal is raised there.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _this.holds += 1
    try:
        yield
    finally:
        _this.holds -= 1
    _this.raise_once()


@contextmanager
def raised() -> Iterator[None]:
    """Let signals interrupt this block, which is within one of ``held``."""
    before, _this.holds = _this.holds, 0
    try:
        _this.raise_once()
        yield
    finally:
        _this.holds = before


def _is_handled() -> bool:
    """Whether this thread is handling a ``KeyboardInterrupt``, or what one has led to."""
    error = sys.exc_info()[1]
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def _imports() -> bool:
    """Whether the main thread, which calls this, is importing a module."""
    frame: FrameType | None = sys._getframe()
    while frame is not None and frame.f_code.co_filename != _IMPORT:
        frame = frame.f_back
    return frame is not None
