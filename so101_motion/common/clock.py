"""Clocks: read the time and wait, in real time or in a time that tests advance.

Time is a parameter: everything that waits is given a ``Clock``. ``MonotonicClock`` is real time.
``ManualClock`` stands still until ``advance`` is called, so a ten-second move takes milliseconds in
a test. An arm with ``simulate_time: false`` runs on it, too.

How ``ManualClock`` stays exact with real threads: a thread that keeps time by it says so
(``attend``), and from then on is either *busy* or *waiting* for a moment. ``advance`` moves the
time only while nobody is busy, straight to the nearest moment somebody waits for; it wakes that
one thread and does not go on before the thread waits again. A thread that would be woken next goes
on by itself: it moves the time while ``advance`` waits, which spares two changes of thread. So
between two readings of the clock no thread can fall behind, every deadline is met to the last bit,
and nothing ever sleeps. A wake-up from outside counts as being busy from the instant the event is
set.

``Metronome`` is the arithmetic of a loop that runs against absolute deadlines.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import NamedTuple, Protocol

_EPSILON = 1e-9
"""Times closer together than this count as equal [s]: the rounding of ``t0 + k * dt``."""

_PATIENCE = 60.0
"""How long ``ManualClock`` waits for a busy thread on the wall clock before it complains [s]."""


class Clock(Protocol):
    """Tells the time [s] and lets threads wait."""

    def now(self) -> float:
        """The time [s]; never runs backwards."""

    def attend(self) -> AbstractContextManager[None]:
        """Register the calling thread with this clock, so it may ``wait``, until the block ends."""

    def wait(self, until: float, wake: threading.Event | None) -> None:
        """Return when the time is ``until`` [s], or earlier when ``wake`` is set; clears ``wake``.

        The caller looks at what ``wake`` announces after this returns, so nothing gets lost. Real
        time takes half as long to wait without one.
        """

    def join(self, thread: threading.Thread) -> None:
        """Wait for a registered thread that was told to end; time passes as it needs."""


class MonotonicClock:
    """The real time."""

    now = staticmethod(time.monotonic)

    def attend(self) -> AbstractContextManager[None]:
        return nullcontext()

    def wait(self, until: float, wake: threading.Event | None) -> None:
        left = max(0.0, until - time.monotonic())
        if wake is None:
            time.sleep(left)
        else:
            wake.wait(left)
            wake.clear()

    def join(self, thread: threading.Thread) -> None:
        thread.join()


class _Wait(NamedTuple):
    until: float  # [s]
    wake: threading.Event


class ManualClock:
    """A clock that shows ``start`` [s] and stands still until it is advanced."""

    def __init__(self, start: float = 0.0) -> None:
        self._now = start
        self._advancing = threading.Lock()  # one at a time decides who runs next
        self._changed = threading.Condition()  # guards what follows
        self._threads: dict[threading.Thread, _Wait | None] = {}  # None: busy
        self._end = -math.inf  # until when a thread may go on by itself

    def now(self) -> float:
        """The time that the clock shows [s]."""
        return self._now

    def advance(self, dt: float) -> None:
        """Let ``dt`` [s] pass; everything due until then has been done when this returns.

        Zero lets the attending threads finish what they were woken for without time passing.

        Raises:
            ValueError: ``dt`` is negative or not finite.
            RuntimeError: Called by an attending thread, which would wait for itself, or a thread
                neither waits nor ends.
        """
        if not 0.0 <= dt < math.inf:
            raise ValueError(f"time moves forward by a finite amount, not by {dt}")
        self._refuse_attending("advance")
        with self._advancing:
            self._end = end = self._now + dt
            try:
                while self._step(end):
                    pass
            finally:
                with self._changed:
                    self._end = -math.inf
            with self._changed:
                self._now = max(self._now, end)

    @contextmanager
    def attend(self) -> Iterator[None]:
        me = threading.current_thread()
        with self._changed:
            self._threads[me] = None
        try:
            yield
        finally:
            with self._changed:
                del self._threads[me]
                self._changed.notify_all()

    def wait(self, until: float, wake: threading.Event | None) -> None:
        me, wake = threading.current_thread(), wake or threading.Event()
        with self._changed:
            if me not in self._threads:
                raise RuntimeError(f"thread {me.name} waits on a clock that it does not attend to")
            if until > self._now:
                if self._is_next(me, until) and not wake.is_set():
                    self._now = until
                    return
                self._threads[me] = _Wait(until, wake)
                self._changed.notify_all()
        if self._threads[me] is not None:
            wake.wait()
        with self._changed:
            self._threads[me] = None
            wake.clear()

    def join(self, thread: threading.Thread) -> None:
        """Let time pass, deadline by deadline, until ``thread`` has ended."""
        self._refuse_attending("join")
        with self._advancing:
            while thread in self._threads and self._step(math.inf):
                pass
        thread.join()

    def _step(self, end: float) -> bool:
        """Move to the next moment somebody waits for, if it is not after ``end``, and wake them."""
        with self._changed:
            seen = self._now
            while not self._changed.wait_for(self._nobody_busy, _PATIENCE):
                if self._now > seen:
                    seen = self._now  # a thread goes on by itself
                    continue
                busy = [t.name for t, wait in self._threads.items() if _is_busy(wait)]
                raise RuntimeError(f"busy for {_PATIENCE:g} s, so time cannot move: {busy}")
            waits = [wait for wait in self._threads.values() if wait is not None]
            following = min(waits, key=lambda wait: wait.until, default=None)
            if following is None or following.until > end + _EPSILON:
                return False
            self._now = max(self._now, following.until)
            following.wake.set()
            return True

    def _is_next(self, me: threading.Thread, until: float) -> bool:
        """Whether the thread ``me`` is the only one that would be woken next, at ``until``."""
        return until <= self._end + _EPSILON and all(
            wait is not None and not wait.wake.is_set() and wait.until > until
            for thread, wait in self._threads.items()
            if thread is not me
        )

    def _nobody_busy(self) -> bool:
        return not any(_is_busy(wait) for wait in self._threads.values())

    def _refuse_attending(self, what: str) -> None:
        if threading.current_thread() in self._threads:
            raise RuntimeError(f"{what} was called by a thread that keeps time by this clock")


def _is_busy(wait: _Wait | None) -> bool:
    return wait is None or wait.wake.is_set()


LONGEST_SKIP = 2
"""How many ticks in a row may be left out; chosen: 20 ms at 100 Hz, which a servo hardly feels."""


class Metronome:
    """Says when each tick of a loop is due: tick ``k`` at ``t0 + k * dt``, each at most once.

    A tick that would come more than half a period late is counted and left out: two ticks are then
    never closer together than half a period, and the next one is on time again. After a longer
    pause, leaving out ticks would become a jump; ``t0`` moves instead, so that tick ``k`` comes
    next. Everything then happens later, and nothing happens faster.

    Args:
        dt: The period [s].

    Attributes:
        k: The tick that is due next.
        late: How many periods have passed without their tick so far.
        missed: How many ticks were left out just before tick ``k``.
    """

    def __init__(self, dt: float) -> None:
        self.dt = dt
        self.k = self.late = self.missed = 0
        self._t0 = 0.0

    def restart(self, now: float) -> None:
        """Start over, with tick 0 due ``now`` [s]."""
        self._t0, self.k, self.missed = now, 0, 0

    @property
    def deadline(self) -> float:
        """When tick ``k`` is due [s]."""
        return self._t0 + self.k * self.dt

    def is_due(self, now: float) -> bool:
        """Whether tick ``k`` is due ``now`` [s]; leaves out ticks that are too late first."""
        deadline = self._t0 + self.k * self.dt
        lateness = now - deadline
        if lateness > 0.5 * self.dt:
            passed = math.ceil(lateness / self.dt - 0.5)
            if self.missed + passed <= LONGEST_SKIP:
                self.k += passed
            else:
                self._t0 += passed * self.dt
            self.missed += passed
            self.late += passed
            deadline = self.deadline
        return now >= deadline - _EPSILON

    def advance(self) -> None:
        self.k += 1
        self.missed = 0
