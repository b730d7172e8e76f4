"""An operation of another process, used as if it were a local one.

While somebody looks at it, a thread reads its view several times a second, so ``view`` never waits.
When the other side does not answer, the last view stays, with the reason as its trouble; the
operation itself goes on over there.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import msgspec

from so101_motion.common.errors import So101Error
from so101_motion.common.operation import Operation, View

PERIOD = 0.12  # how often the view is read [s]; chosen: bars that move with the hand

_SEEN = 1.0  # [s]; a view that nobody has looked at for longer is not read again

Json = Mapping[str, Any]


class RemoteOperation(Operation):
    """An operation of another process.

    Args:
        send: Sends a request to it, such as a DoCommand, and returns the answer; raises
            ``So101Error``.
        name: The operation's name over there.
        period: How often its view is read while somebody looks at it [s].

    Raises:
        So101Error: It does not answer, or has no such operation.
    """

    def __init__(self, send: Callable[[Json], Json], name: str, *, period: float = PERIOD) -> None:
        self._send, self._name, self._period = send, name, period
        self._view, self._seen_at = self._read(), time.monotonic()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, name=f"so101-{name}", daemon=True)
        self._thread.start()

    @property
    def view(self) -> View:
        """What was read last; never waits."""
        self._seen_at = time.monotonic()
        return self._view

    def ask(self, command: str, /, **arguments: Any) -> Json:
        try:
            answer = self._send({**self._request, "ask": command, "arguments": arguments})["answer"]
            return msgspec.json.decode(answer, type=dict[str, Any])
        finally:
            self._look()

    def close(self) -> None:
        """Stop reading; the operation goes on over there."""
        self._closing.set()
        self._thread.join()

    @property
    def _request(self) -> dict[str, Any]:
        return {"command": "operation", "name": self._name}

    def _read(self) -> View:
        return msgspec.json.decode(self._send(self._request)["view"], type=View)

    def _watch(self) -> None:
        while not self._closing.wait(self._period):
            if time.monotonic() - self._seen_at < _SEEN:
                self._look()

    def _look(self) -> None:
        try:
            self._view = self._read()
        except So101Error as error:
            self._view = replace(self._view, trouble=str(error), is_connected=False)
