"""Queue the commands of browsers for the page's thread; Stop empties the queue."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

Command = Callable[[], None]


class Commands:
    """A queue of commands for one thread, which any thread can empty.

    ``on_error`` is called with what a command raised; the next one runs all the same.
    """

    def __init__(self, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._waiting: deque[Command] = deque()
        self._running = threading.Lock()
        self._posted = threading.Event()

    def post(self, command: Command) -> None:
        self._waiting.append(command)
        self._posted.set()

    def wait(self, timeout: float) -> None:
        """Return when a command was posted since the last call, or after ``timeout`` [s]."""
        self._posted.wait(timeout)
        self._posted.clear()

    def run(self) -> bool:
        acted = False
        with self._running:
            while self._waiting:
                command = self._waiting.popleft()
                acted = True
                try:
                    command()
                except Exception as error:
                    self._on_error(error)
        return acted

    def drop(self) -> None:
        """Drop all waiting commands, and wait for the running one.

        After this no command given before it can have an effect any more: what it set in motion
        can be stopped, and nothing more will be.
        """
        self._waiting.clear()
        with self._running:
            self._waiting.clear()
