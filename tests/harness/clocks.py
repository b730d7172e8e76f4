"""Clocks for tests: a run that repeats exactly, and real time that waits for a busy machine.

With ``ManualClock`` a thread goes on as soon as it is woken, at the same time as the one that woke
it, so what a test sees may differ from run to run. On a ``TurnClock`` a woken thread waits until
the clock is advanced: the same seed gives the same run, however busy the machine is.
"""

import threading
import time
from contextlib import contextmanager
from pathlib import Path

from so101_motion.common.clock import ManualClock, MonotonicClock

_EPSILON = 1e-9
_PATIENCE = 60.0  # [s] on the wall clock, for a thread that neither waits nor ends


class TurnClock:
    """Fits ``Clock``. What a clock on the wall shows beyond it, ``wall``, may be set."""

    def __init__(self):
        self.wall = 1_750_000_000.0
        self._now = 0.0
        self._changed = threading.Condition()
        self._waits = {}  # thread: until, wake, its turn; None while it runs

    def now(self):
        return self._now

    def jump(self, seconds):
        """Let time pass unseen by running threads, as when the process was stopped meanwhile."""
        self._now += seconds

    @contextmanager
    def attend(self):
        me = threading.current_thread()
        with self._changed:
            self._waits[me] = None
        try:
            yield
        finally:
            with self._changed:
                del self._waits[me]
                self._changed.notify_all()

    def wait(self, until, wake):
        turn, wake = threading.Event(), wake or threading.Event()
        with self._changed:
            self._waits[threading.current_thread()] = (until, wake, turn)
            self._changed.notify_all()
        turn.wait()
        wake.clear()

    def advance(self, seconds):
        """Let time pass; everything due until then has been done when this returns."""
        end = self._now + seconds
        while self._step(end):
            pass
        self._now = max(self._now, end)

    def join(self, thread):
        while thread in self._waits and self._step(float("inf")):
            pass
        thread.join()

    def _step(self, end):
        """Let the thread run that is woken or due next; whether there was one."""
        with self._changed:
            if not self._changed.wait_for(self._nobody_runs, _PATIENCE):
                raise RuntimeError("a thread neither waits nor ends")
            waits = list(self._waits.items())
            woken = [each for each in waits if each[1][1].is_set()]
            due = woken[:1] or sorted(waits, key=lambda each: each[1][0])[:1]
            if not due or (not woken and due[0][1][0] > end + _EPSILON):
                return False
            thread, (until, _, turn) = due[0]
            if not woken:
                self._now = max(self._now, until)
            self._waits[thread] = None
            turn.set()
            self._changed.wait_for(self._nobody_runs, _PATIENCE)
            return True

    def _nobody_runs(self):
        return None not in self._waits.values()

    @contextmanager
    def everywhere(self):
        """Let this be what ``time.monotonic`` and ``time.time`` of Python say, too."""
        real = time.monotonic, time.time
        time.monotonic, time.time = self.now, lambda: self.wall + self._now
        try:
            yield
        finally:
            time.monotonic, time.time = real


_monotonic = time.monotonic  # the real one, also while ``everywhere`` is in force


class PacedClock(MonotonicClock):
    """Real time that stands still while the machine does: no thread that attends is ever late.

    A thread that is joined takes its own time: nothing moves this clock ahead of the real one.
    """

    STEP = 0.03
    """How far it advances at a time [s]; a longer pause of the machine is no time at all."""

    def __init__(self):
        self._time = ManualClock(_monotonic())
        self.attend, self.wait = self._time.attend, self._time.wait
        self._stepped = (self._time.now(), _monotonic())
        threading.Thread(target=self._run).start()

    def now(self):
        """The time [s]; a thread that does not attend sees it move between the steps, too."""
        if threading.current_thread() in self._time._threads:
            return self._time.now()
        shown, at = self._stepped
        return shown + min(_monotonic() - at, self.STEP)

    def _run(self):
        while threading.main_thread().is_alive():  # else nanobind finds leaks at the end
            time.sleep(self.STEP)
            at, now = self._stepped[1], _monotonic()
            self._time.advance(min(now - at, 2.0 * self.STEP))
            self._stepped = (self._time.now(), now)


def pace_simulated_arms(setattr=setattr):
    """From now on the real time of all simulated arms of this process is one ``PacedClock``.

    Servos have the real time still: one that is silent keeps its arm's thread, and no other.
    """
    from so101_motion.rig import simulated_rig  # a process begins with this

    clock = PacedClock()
    setattr(simulated_rig, "MonotonicClock", lambda: clock)


def pace_arms_on_servos(setattr=setattr):
    """The same for arms on servos; returns the clock, which is to be that of the servos, too."""
    from so101_motion.rig import hardware_rig

    clock = PacedClock()
    setattr(hardware_rig, "MonotonicClock", lambda: clock)
    return clock


def hurry_simulated_arms(setattr=setattr):
    """From now on the time of all simulated arms passes fifty times as fast as in life.

    Returns an event that ends it.
    """
    from so101_motion.rig import simulated_rig

    clock, over = ManualClock(), threading.Event()
    setattr(simulated_rig, "MonotonicClock", lambda: clock)

    def run():
        while not over.wait(1e-3):
            clock.advance(0.05)

    threading.Thread(target=run, daemon=True).start()
    return over


PACED = (
    f"import sys; sys.path.insert(0, {str(Path(__file__).parents[1])!r}); "
    "from harness.clocks import pace_simulated_arms; pace_simulated_arms(); "
)
"""What a Python process does first, for its simulated arms to lose no setpoint in a stall."""
