"""Plans are made in a process of their own.

Planning holds the interpreter lock for milliseconds at a time, and a control loop in the same
process then misses its ticks. So the planner lives in a child: it is started once, loads the model
and the libraries while the parent is already answering, and from then on takes a ``PlanRequest``
and gives back a ``Plan`` or the error it raised. Both are plain values, pickled over the child's
standard streams. A scene may be large and seldom changes, so it is sent once: both ends remember
the last few, and from then on its digest stands for it.

Why not ``multiprocessing``: its ``spawn`` runs the user's own script a second time in the child,
which surprises everyone whose script opens an arm at top level, and it keeps a tracker process
beside ours. A pipe to ``python -m so101_motion.worker`` does neither, and when the parent dies,
even by ``kill -9``, the child reads end-of-file and leaves.
"""

from __future__ import annotations

import contextlib
import io
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections import OrderedDict
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import IO, TYPE_CHECKING, Any, cast

from so101_motion.errors import So101Error, WorkerError
from so101_motion.planning.scene import Scene
from so101_motion.realtime import be_ordinary

if TYPE_CHECKING:
    from so101_motion.planning.plan import Plan, PlanRequest

_GRACE = 2.0  # [s] for the child to leave by itself before it is killed; chosen

_REMEMBERED = 8
"""So many scenes both ends remember. Chosen."""


class Scenes:
    """The scenes that went over a pipe of late. Both ends keep one, and both forget alike."""

    def __init__(self) -> None:
        self._known: OrderedDict[bytes, Scene] = OrderedDict()

    def note(self, scene: Scene) -> bool:
        """Remember a scene that is being sent; whether the other end has it already."""
        known = scene.digest in self._known
        self._known[scene.digest] = scene
        self._known.move_to_end(scene.digest)
        if len(self._known) > _REMEMBERED:
            self._known.popitem(last=False)
        return known

    def __getitem__(self, digest: bytes) -> Scene:
        return self._known[digest]


class Sender(pickle.Pickler):
    """Pickles values into a stream, scenes by their digest once they have been sent."""

    def __init__(self, stream: IO[bytes], scenes: Scenes) -> None:
        super().__init__(stream, pickle.HIGHEST_PROTOCOL)
        self._scenes = scenes

    def persistent_id(self, value: Any) -> tuple[bytes, bytes] | None:
        """What stands for a scene: its digest and, the first time, its content."""
        if not isinstance(value, Scene):
            return None
        known = self._scenes.note(value)
        return value.digest, b"" if known else pickle.dumps(value, pickle.HIGHEST_PROTOCOL)


class Receiver(pickle.Unpickler):
    """The other end of ``Sender``."""

    def __init__(self, stream: IO[bytes], scenes: Scenes) -> None:
        super().__init__(stream)
        self._scenes = scenes

    def persistent_load(self, sent: tuple[bytes, bytes]) -> Scene:
        """The scene that was sent, now or earlier."""
        digest, content = sent
        scene = pickle.loads(content) if content else self._scenes[digest]
        self._scenes.note(scene)
        return cast("Scene", scene)


class PlanningWorker:
    """The parent's end of the planning process.

    The child starts with the first call of ``start`` or ``plan`` and is started again when it has
    died. Every method may be called from any thread; requests are served in order.
    """

    def __init__(self) -> None:
        self._requests = ThreadPoolExecutor(max_workers=1, thread_name_prefix="so101-planning")
        self._lock = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        self._scenes = Scenes()
        self._closed = False

    def start(self) -> Future[None]:
        """Start the child in the background; done when it is ready to plan without delay."""
        return self._requests.submit(self._warm_up)

    def plan(self, request: PlanRequest) -> Future[Plan]:
        """Plan in the child.

        The future raises what ``Planner.plan`` raises, or ``WorkerError`` when the child could not
        be started or died.
        """
        return self._requests.submit(self._plan, request)

    @property
    def pid(self) -> int | None:
        """The child's process id, or None while there is none."""
        child = self._child
        return child.pid if child is not None and child.poll() is None else None

    def close(self) -> None:
        """End the child; what is being planned fails with ``WorkerError``. May be called twice."""
        with self._lock:
            self._closed = True
            child, self._child = self._child, None
        if child is not None:
            _end(child)
        self._requests.shutdown(wait=True, cancel_futures=True)

    def _warm_up(self) -> None:
        self._ask(None)

    def _plan(self, request: PlanRequest) -> Plan:
        return cast("Plan", self._ask(request))

    def _ask(self, request: PlanRequest | None) -> Plan | None:
        child = self._living_child()
        try:
            message = io.BytesIO()
            Sender(message, self._scenes).dump(request)
            cast("IO[bytes]", child.stdin).write(message.getvalue())
            cast("IO[bytes]", child.stdin).flush()
            answer = pickle.load(cast("IO[bytes]", child.stdout))
        except (OSError, EOFError, ValueError, pickle.UnpicklingError) as error:
            with self._lock:
                if self._child is child:
                    self._child = None
            _end(child)
            raise WorkerError(
                "the planning process died while it worked (exit code "
                f"{child.returncode}); it is started again with the next request, try once more"
            ) from error
        if isinstance(answer, BaseException):
            raise answer
        return cast("Plan | None", answer)

    def _living_child(self) -> subprocess.Popen[bytes]:
        with self._lock:
            if self._closed:
                raise WorkerError("the planning process has been closed; open the arm again")
            if self._child is not None and self._child.poll() is not None:
                _end(self._child)
                self._child = None
            if self._child is None:
                self._child, self._scenes = _spawn(), Scenes()
            return self._child


def _spawn() -> subprocess.Popen[bytes]:
    environment = dict(os.environ)
    environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
    environment["OPENBLAS_NUM_THREADS"] = "1"  # the matrices are 6x5: threads only cost memory
    try:
        with _deaf_to_ctrl_c():
            return subprocess.Popen(
                [sys.executable, "-m", "so101_motion.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=environment,
            )
    except OSError as error:
        raise WorkerError(f"the planning process could not be started: {error}") from error


@contextlib.contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """A child begun meanwhile never hears Ctrl-C, not even while it still imports.

    A terminal sends it to parent and child alike; what this thread blocks, the child inherits.
    """
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end(child: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(OSError, ValueError):
        cast("IO[bytes]", child.stdin).close()
    try:
        child.wait(_GRACE)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()
    with contextlib.suppress(OSError, ValueError):
        cast("IO[bytes]", child.stdout).close()


def main() -> None:
    """The child: answer requests from standard input until it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    be_ordinary()  # whoever streams goes before whoever plans
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # a library's print must not garble answers

    from so101_motion.planning.model import RobotModel
    from so101_motion.planning.planner import Planner

    planner, scenes = Planner(RobotModel.load()), Scenes()
    while True:
        try:
            request = Receiver(sys.stdin.buffer, scenes).load()
        except EOFError:
            return
        answer: Plan | BaseException | None
        try:
            if request is None:
                planner.warm_up()
                answer = None
            else:
                answer = planner.plan(request)
        except So101Error as error:
            answer = error
        except Exception as error:  # a defect of ours: the caller must hear of it, not hang
            answer = WorkerError(f"planning failed unexpectedly: {type(error).__name__}: {error}")
        try:
            pickle.dump(answer, answers, pickle.HIGHEST_PROTOCOL)
            answers.flush()
        except BrokenPipeError:
            return


if __name__ == "__main__":
    main()
