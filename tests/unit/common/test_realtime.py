import gc
import os
import sys
import threading

import pytest

from so101_motion.common.realtime import (
    reduce_jitter,
    restore_normal_priority,
    use_realtime_priority,
)


def in_a_thread(job):
    """What ``job`` returns; a niceness is a thread's own, so the tests' stays as it is."""
    seen = []
    thread = threading.Thread(target=lambda: seen.append(job()))
    thread.start()
    thread.join()
    return seen[0]


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="not on this system")
def test_only_the_thread_that_asks_goes_first_and_what_it_starts_does_not():
    def ask():
        allowed = use_realtime_priority()
        mine = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        return allowed, mine, in_a_thread(lambda: os.sched_getscheduler(0))

    allowed, policy, inherited = in_a_thread(ask)
    assert policy == (os.SCHED_FIFO if allowed else os.SCHED_OTHER)
    assert inherited == os.SCHED_OTHER
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def priority():
    niceness = os.getpriority(os.PRIO_PROCESS, 0)
    return os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, niceness


@pytest.fixture
def unsteady():
    """What a test has changed for the whole interpreter is put back."""
    interval = sys.getswitchinterval()
    yield
    sys.setswitchinterval(interval)
    gc.unfreeze()


def test_a_steady_interpreter_takes_short_turns_and_leaves_alone_what_is_there(unsteady):
    in_a_thread(reduce_jitter)
    assert sys.getswitchinterval() == pytest.approx(0.0005)
    assert gc.get_freeze_count() > 10_000


@pytest.mark.skipif(sys.platform != "linux", reason="a priority is a thread's own only there")
@pytest.mark.parametrize("processors", [1, 2])
def test_all_threads_of_a_steady_program_go_before_others_and_its_children_need_not(
    unsteady, monkeypatch, processors
):
    monkeypatch.setattr(os, "cpu_count", lambda: processors)
    before = priority()

    def begin():
        reduce_jitter()
        mine, of_a_new_thread = priority(), in_a_thread(priority)
        restore_normal_priority()
        return mine, of_a_new_thread, priority()

    mine, of_a_new_thread, afterwards = in_a_thread(begin)
    first = (os.SCHED_OTHER, 0, -11) if processors == 1 else (os.SCHED_RR, 1, 0)
    assert mine == of_a_new_thread
    assert mine in (before, first), "not everybody may"
    assert afterwards == before
    assert priority() == before


@pytest.mark.skipif(sys.platform != "linux", reason="a niceness is a thread's own only there")
def test_a_niceness_that_somebody_has_chosen_stays(unsteady):
    def begin():
        os.setpriority(os.PRIO_PROCESS, 0, 7)
        reduce_jitter()
        chosen = priority()
        restore_normal_priority()
        return chosen, priority()

    assert in_a_thread(begin) == ((os.SCHED_OTHER, 0, 7),) * 2
