import itertools
import threading

import pytest

from so101_motion.common.clock import ManualClock, Metronome, MonotonicClock


class Worker:
    """A thread that waits for a list of moments on a clock and notes when it came back."""

    def __init__(self, clock, moments, log, name="so101-test-worker"):
        self.clock, self.moments, self.log = clock, moments, log
        self.wake, self.attending = threading.Event(), threading.Event()
        self.thread = threading.Thread(target=self.run, name=name)
        self.thread.start()
        self.attending.wait()

    def run(self):
        with self.clock.attend():
            self.attending.set()
            for moment in self.moments:
                self.clock.wait(moment, self.wake)
                self.log.append((self.thread.name, self.clock.now()))


def test_everything_due_has_been_done_when_advance_returns_and_time_stands_still_before(clock):
    assert ManualClock(100.0).now() == 100.0
    log = []
    worker = Worker(clock, [0.1, 0.2, 0.3, 5.0], log)
    clock.advance(0.25)
    assert [t for _, t in log] == [0.1, 0.2]
    clock.advance(4.75)
    assert [t for _, t in log] == [0.1, 0.2, 0.3, 5.0]
    assert clock.now() == 5.0
    clock.join(worker.thread)


def test_a_moment_that_rounding_puts_behind_the_end_is_still_met(clock):
    log = []
    worker = Worker(clock, [57 * 0.01], log)  # 0.5700000000000001
    clock.advance(0.57)
    assert len(log) == 1
    worker.thread.join()


def test_a_wake_up_ends_the_wait_without_time_passing(clock):
    log = []
    worker = Worker(clock, [10.0, 20.0], log)
    clock.advance(0.0)
    worker.wake.set()
    clock.advance(0.0)
    assert log == [("so101-test-worker", 0.0)]
    assert not worker.wake.is_set()
    clock.join(worker.thread)
    assert clock.now() == 20.0


@pytest.mark.parametrize("dt", [-0.1, float("nan"), float("inf")])
def test_time_neither_runs_backwards_nor_jumps_to_infinity(clock, dt):
    with pytest.raises(ValueError, match="forward by a finite amount"):
        clock.advance(dt)


def test_a_reader_of_the_clock_cannot_move_it_and_others_cannot_wait(clock):
    with clock.attend():
        with pytest.raises(RuntimeError, match="advance was called by a thread that keeps time"):
            clock.advance(1.0)
        with pytest.raises(RuntimeError, match="join was called by a thread that keeps time"):
            clock.join(threading.current_thread())
    with pytest.raises(RuntimeError, match="does not attend"):
        clock.wait(1.0, threading.Event())


def test_the_real_clock_waits_until_the_moment_or_a_wake_up():
    clock, wake = MonotonicClock(), threading.Event()
    with clock.attend():
        before = clock.now()
        clock.wait(before + 0.002, wake)
        assert clock.now() >= before + 0.002
        wake.set()
        clock.wait(before + 3600.0, wake)
        assert not wake.is_set()
    thread = threading.Thread(target=lambda: None)
    thread.start()
    clock.join(thread)
    assert not thread.is_alive()


def test_a_metronome_ticks_at_exact_multiples():
    beat = Metronome(0.01)
    beat.restart(5.0)
    for k in range(1000):
        assert beat.deadline == 5.0 + k * 0.01
        assert not beat.is_due(beat.deadline - 0.001)
        assert beat.is_due(beat.deadline)
        assert beat.k == k
        beat.advance()
    assert beat.late == 0


def after_three_ticks():
    beat = Metronome(0.01)
    beat.restart(0.0)
    for _ in range(3):
        beat.advance()
    return beat


@pytest.mark.parametrize(
    ("lateness", "due", "k", "late"),
    [
        (0.0, True, 3, 0),
        (0.0049, True, 3, 0),
        (0.0051, False, 4, 1),  # too late for 3, too early for 4
        (0.0101, True, 4, 1),
        (0.0149, True, 4, 1),
        (0.0151, False, 5, 2),
        (0.0249, True, 5, 2),
    ],
)
def test_a_tick_more_than_half_a_period_late_is_left_out(lateness, due, k, late):
    beat = after_three_ticks()
    assert beat.is_due(beat.deadline + lateness) is due
    assert (beat.k, beat.late, beat.missed) == (k, late, late)


@pytest.mark.parametrize("lateness", [0.0251, 0.0449, 10.0])
def test_after_a_longer_pause_everything_happens_later_instead(lateness):
    beat = after_three_ticks()
    beat.is_due(0.03 + lateness)
    assert beat.k == 3  # the next setpoint is the next one, so nothing jumps
    assert beat.deadline == pytest.approx(0.03 + beat.late * 0.01)
    assert abs(beat.deadline - (0.03 + lateness)) <= 0.005 + 1e-9


def test_ticks_never_come_closer_together_than_half_a_period():
    beat, now, ticks = Metronome(0.01), 0.0, []
    beat.restart(now)
    for step in range(2000):
        if beat.is_due(now):
            ticks.append(now)
            beat.advance()
            now += (0.0003 * step) % 0.029  # the work of this tick
        else:
            now = beat.deadline
    gaps = [after - before for before, after in itertools.pairwise(ticks)]
    assert min(gaps) >= 0.005 - 1e-9
    assert beat.late > 100
