"""Start this program's own Python in a child process, to compute there or to serve from there.

A thread that computes keeps the interpreter lock from the control loop; a process of its own has a
lock of its own.

Why not ``multiprocessing``: its ``spawn`` runs the user's own script a second time in the child,
which surprises everyone whose script opens an arm at top level, and it keeps a tracker process
beside ours.

A child imports nothing from the current folder, whatever lies there: it is started with ``-P``,
and the folder is taken out of the search path that is handed on.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import ParamSpec, TypeVar

from so101_motion.common.errors import WorkerError
from so101_motion.common.realtime import restore_normal_priority

P = ParamSpec("P")
T = TypeVar("T")

_START = """\
import importlib, sys
sys.path.append(sys.argv.pop(1))
importlib.import_module(sys.argv.pop(1)).main()
"""
"""Code that a child runs. The package's folder is searched last: it may be the current one."""

_CANCELLED = "the computation was cancelled"


def spawn(
    module: str,
    *arguments: str,
    pass_fds: Collection[int] = (),
    stdin: int = subprocess.DEVNULL,
    stdout: int | None = None,
) -> subprocess.Popen[bytes]:
    """Start ``main`` of a module in a child that ignores Ctrl-C; the rest is as for ``Popen``."""
    environment = dict(os.environ)
    environment["PYTHONPATH"] = os.pathsep.join(_search_path())
    environment["OPENBLAS_NUM_THREADS"] = "1"  # the matrices are 6x5: threads only cost memory
    ours = str(Path(__file__).resolve().parents[2])
    command = [sys.executable, "-P", "-c", _START, ours, module, *arguments]
    if sys.platform == "win32":
        for handle in pass_fds:
            os.set_handle_inheritable(handle, True)
        return subprocess.Popen(
            command, stdin=stdin, stdout=stdout, env=environment, close_fds=not pass_fds,
            creationflags=subprocess.CREATE_NEW_PROCESS_GROUP,  # which does not get Ctrl-C
        )  # fmt: skip
    with _signals_blocked():
        return subprocess.Popen(
            command, stdin=stdin, stdout=stdout, env=environment, pass_fds=tuple(pass_fds)
        )


class OwnProcess:
    """Runs one call in a child process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        self._is_cancelled = False

    def call(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run ``function`` in the child and return its result; it and its arguments are pickled.

        Raises:
            WorkerError: The process could not be started, or ended without an answer.
            Exception: What ``function`` raised.
        """
        try:
            with self._lock:
                if self._is_cancelled:
                    raise WorkerError(_CANCELLED)
                self._child = child = spawn(__name__, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        except OSError as error:
            raise WorkerError(f"no process could be started to compute in: {error}") from error
        with child:
            try:
                output, _ = child.communicate(pickle.dumps((function, args, kwargs)))
            except BaseException:  # Ctrl-C, too
                child.kill()
                raise
        if self._is_cancelled:
            raise WorkerError(_CANCELLED)
        if child.returncode:
            raise WorkerError(f"the process that computed ended with code {child.returncode}")
        found: T
        found, raised = pickle.loads(output)
        if raised is not None:
            raise raised
        return found

    def kill(self) -> None:
        """Kill the child, or keep it from starting; ``call`` raises ``WorkerError``. Any thread."""
        with self._lock:
            self._is_cancelled = True
            if self._child is not None:
                self._child.kill()


def main() -> None:
    """In the child: read one call, run it, and send back what it returned or raised."""
    restore_normal_priority()
    answers = os.dup(1)
    os.dup2(2, 1)  # what a library prints is for the log
    function, args, kwargs = pickle.load(sys.stdin.buffer)
    found, raised = None, None
    try:
        found = function(*args, **kwargs)
    except Exception as error:
        raised = error
    with os.fdopen(answers, "wb") as stream:
        pickle.dump((found, raised), stream)


def _search_path() -> list[str]:
    """The folders in which this process finds modules, without the current one."""
    try:
        here = os.path.realpath(os.curdir)
    except OSError:  # it has been deleted
        here = ""
    return [path for path in sys.path if path and os.path.realpath(path) != here]


@contextlib.contextmanager
def _signals_blocked() -> Iterator[None]:
    """Block signals such as Ctrl-C, so that a child started in this block ignores them.

    A terminal sends them to parent and child alike, and a service manager may do so too. A child
    inherits the signals its parent's thread blocks, so only the parent decides when it ends.
    """
    signals = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
