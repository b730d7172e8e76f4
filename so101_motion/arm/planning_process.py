"""Start the planning process, ask it for plans, and detect when it dies or hangs.

The two talk over a socket: when the parent dies, even by ``kill -9``, the child sees its end.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, cast

from so101_motion.arm.plan_messages import Kind, MessageSocket, packed, unpacked
from so101_motion.common.child_process import spawn
from so101_motion.common.errors import So101Error, WorkerError

if TYPE_CHECKING:
    from so101_motion.planning.cell.team_requests import TeamTask
    from so101_motion.planning.request import PlanRequest

CAN_COPY = hasattr(os, "pidfd_open")
"""Whether this system watches a copy of a process. Linux does, since 2019."""

HANG_TIMEOUT = 3.0
"""A child that has work hangs if it sends no sign of life for so long and uses no processor [s].
Chosen: it sends one four times a second."""

_SILENT = 30.0
"""A child that sends no sign of life for so long hangs, even if it uses the processor [s]. Chosen:
the largest scenes that are accepted take a tenth of that in one piece."""

_CHILD = "so101_motion.arm.planning_child"


class ChildDied(Exception):
    """The planning process ended, or was killed because it hung; the message says how."""


class PlanningProcess:
    """A planning process. For one thread, except ``wake``, ``kill`` and ``pid``.

    Args:
        hang_timeout: After how long without a sign of life it hangs [s], see ``HANG_TIMEOUT``.
        original: The process to copy, also while it plans; None to start a new one.

    Raises:
        ChildDied: The original does not make a copy.
        WorkerError: No process can be started.
    """

    def __init__(
        self, hang_timeout: float = HANG_TIMEOUT, original: PlanningProcess | None = None
    ) -> None:
        ours, theirs = socket.socketpair()
        self._line = MessageSocket(ours, self._wait)
        self._sending = threading.Lock()
        self.is_ready = False
        self._child: subprocess.Popen[bytes] | _Copy
        with theirs:
            try:
                line = theirs.fileno()
                if original is None:
                    self._child = spawn(_CHILD, str(line), pass_fds=(line,))
                else:
                    self._child = original._child
                    with original._sending:
                        original._line.send_copy(theirs)
            except OSError as error:
                ours.close()
                if original is not None:
                    raise ChildDied("makes no copy") from error
                raise WorkerError(f"the planning process could not be started: {error}") from error
        self._wake, self._woken = socket.socketpair()
        self._wake.setblocking(False)
        self._woken.setblocking(False)
        self._hang_timeout = hang_timeout
        self._is_unwanted: Callable[[], bool] = bool
        self._gave_up = False
        self._sign = time.monotonic()
        if original is not None:
            try:
                self._child = _Copy(cast("int", self._converse(Kind.READY)))
            except (ChildDied, OSError):
                self._close()
                raise
            self.is_ready = True

    @property
    def pid(self) -> int | None:
        """The child's process id, None when it has ended."""
        return self._child.pid if self._child.poll() is None else None

    def wait_until_ready(self) -> None:
        """Wait until it has loaded everything; ``WorkerError`` says why it cannot."""
        answer = self._converse(Kind.READY)
        if isinstance(answer, So101Error):
            raise answer
        self.is_ready = True

    def ask(
        self, request: PlanRequest | TeamTask[object], is_unwanted: Callable[[], bool]
    ) -> object:
        """Have a plan made: a plan, or a team's plans; None if it was given up.

        ``is_unwanted`` says whether it is not wanted any more; asked again after each ``wake``.

        Raises:
            ChildDied: The child ended or hung; there will be no answer.
            So101Error: What ``Planner.plan`` raises.
        """
        self._is_unwanted, self._gave_up = is_unwanted, False
        self._sign = time.monotonic()
        try:
            with self._sending:
                self._line.send(Kind.REQUEST, packed(request))
        except OSError as error:
            raise ChildDied(self.ending()) from error
        answer = self._converse(Kind.ANSWER)
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def wake(self) -> None:
        with contextlib.suppress(OSError):  # full of calls already, or closed
            self._wake.send(b"\0")

    def kill(self) -> None:
        """End the child at once; those who wait for its answer get ``ChildDied``."""
        self._child.kill()

    def close(self) -> None:
        self._child.kill()
        self._child.wait()
        self._close()

    def _close(self) -> None:
        for each in (self._line, self._wake, self._woken):
            each.close()

    def ending(self) -> str:
        """Text that says how the child ended; only after it has."""
        try:
            code = self._child.wait(self._hang_timeout)
        except subprocess.TimeoutExpired:
            return "closed its end of the socket"
        if isinstance(self._child, _Copy):
            return "ended"
        if code >= 0:  # always on Windows
            return f"ended with exit code {code}"
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        memory = ", as the system does when memory runs out" if -code == signal.SIGKILL else ""
        return f"was ended by {name}{memory}"

    def _converse(self, awaited: Kind) -> object:
        """Wait for the next message of a kind; returns its content."""
        try:
            while True:
                kind, parts = self._line.receive()
                if kind is awaited:
                    return unpacked(parts)
        except (EOFError, OSError) as error:
            raise ChildDied(self.ending()) from error

    def _wait(self, for_writing: bool) -> None:
        """Wait until the child takes or sends something; tell it to give up an unwanted plan."""
        if not for_writing and not self._gave_up and self._is_unwanted():
            self._gave_up = True
            with self._sending:
                self._line.send(Kind.GIVE_UP)
        line, woken = self._line.fileno(), self._woken.fileno()
        reading, writing = ([woken], [line]) if for_writing else ([woken, line], [])
        readable, writable, _ = select.select(reading, writing, [], 0.5 * self._hang_timeout)
        if woken in readable:
            self._woken.recv(4096)
        now = time.monotonic()
        if line in (*readable, *writable):
            self._sign = now
            return
        silent = now - self._sign
        if silent > _SILENT or (silent > self._hang_timeout and _stands_still(self._child.pid)):
            raise ChildDied(f"showed no sign of life for {silent:.1f} s")


class _Copy:
    """A copy of a planning process, like ``Popen``: the system tells only its end."""

    def __init__(self, pid: int) -> None:
        self._watch = os.pidfd_open(pid)
        self.pid = pid

    def poll(self) -> int | None:
        return 0 if select.select([self._watch], [], [], 0.0)[0] else None

    def wait(self, timeout: float | None = None) -> int:
        if not select.select([self._watch], [], [], timeout)[0]:
            raise subprocess.TimeoutExpired(_CHILD, timeout or 0.0)
        return 0

    def kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._watch, signal.SIGKILL)

    def __del__(self) -> None:
        os.close(self._watch)


def _stands_still(pid: int) -> bool:
    """Whether a process sleeps without disk access; False if that is not known."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] not in ("R", "D")
