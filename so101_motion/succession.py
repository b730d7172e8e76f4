"""One motion at a time: a newer one supersedes the one under way.

The old one is interrupted and the arm brought to rest before the new one begins. What turns the arm
without a stop begins first and interrupts then. Used by any number of threads; the motions
themselves run on threads of their own, because most of them plan and wait.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

from so101_motion.motion import Motion

SUPERSEDED = "a newer motion"
"""What a motion is told that has to make way."""


class Succession:
    """The motions of one arm.

    Args:
        come_to_rest: Slows the arm down, whatever it does; returns what completes at rest.

    Attributes:
        current: The newest motion; over, before the first.
    """

    def __init__(self, come_to_rest: Callable[[], Future[None]]) -> None:
        self.current = Motion()
        self.current.future.set_result(None)
        self._come_to_rest = come_to_rest
        self._lock = threading.Lock()
        self._threads = ThreadPoolExecutor(max_workers=4, thread_name_prefix="so101-arm")

    def start(self, run: Callable[[Motion], None]) -> Motion:
        """Let ``run`` move the arm once it is at rest; it is given its motion, whose end it is.

        Returns at once. What ``run`` raises is what the motion raises.
        """
        motion = Motion()
        with self._lock:
            previous = self.current
            self._threads.submit(self._run, motion, previous, run)
            self.current = motion
            previous.interrupt(SUPERSEDED)
        return motion

    def turn(self, begin: Callable[[Motion], Future[None]]) -> Motion:
        """Begin what leads the arm elsewhere from full speed.

        Args:
            begin: Is given its motion, begins it, and returns what completes at its end.
        """
        motion = Motion()
        with self._lock:
            running = begin(motion)
            previous, self.current = self.current, motion
            previous.interrupt(SUPERSEDED)
        running.add_done_callback(motion.take_outcome)
        return motion

    @contextmanager
    def at_rest(self) -> Iterator[None]:
        """End the motion under way; none is begun while the block runs."""
        while True:
            newest = self._newest()
            newest.interrupt(SUPERSEDED)
            newest.future.exception()
            self._come_to_rest().result()
            with self._lock:
                if self.current is newest:
                    yield
                    return

    def interrupt(self, by: str) -> None:
        """End the newest motion early; returns at once."""
        self._newest().interrupt(by)

    def close(self) -> None:
        """End what is under way, and the threads."""
        self.interrupt("shutdown")
        self._threads.shutdown(wait=True)

    def _newest(self) -> Motion:
        with self._lock:
            return self.current

    def _run(self, motion: Motion, previous: Motion, run: Callable[[Motion], None]) -> None:
        try:
            previous.future.exception()  # it has been told to make way
            self._rest_for(motion)
            run(motion)
        except BaseException as error:  # whoever waits for the motion must hear of it
            motion.future.set_exception(error)
        else:
            motion.future.set_result(None)

    def _rest_for(self, motion: Motion) -> None:
        """Bring the arm to rest for a motion, unless something newer has been asked for since.

        That may be under way already, or have let go of the arm.
        """
        with self._lock:
            if self.current is not motion:
                motion.interrupt(SUPERSEDED)
            resting = motion.begin(self._come_to_rest, lambda _resting, _by: None)
        resting.result()
