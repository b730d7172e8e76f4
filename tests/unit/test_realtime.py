import gc
import os
import sys
import threading

import pytest

from so101_motion.realtime import go_first, steady_interpreter


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="not on this system")
def test_only_the_thread_that_asks_goes_first_and_what_it_starts_does_not():
    seen = []

    def ask():
        allowed = go_first()
        child = threading.Thread(target=lambda: seen.append(os.sched_getscheduler(0)))
        seen.append((allowed, os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK))
        child.start()
        child.join()

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    (allowed, policy), inherited = seen

    assert policy == (os.SCHED_FIFO if allowed else os.SCHED_OTHER)
    assert inherited == os.SCHED_OTHER
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def test_a_steady_interpreter_takes_short_turns_and_leaves_alone_what_is_there():
    interval = sys.getswitchinterval()
    try:
        steady_interpreter()
        assert sys.getswitchinterval() == pytest.approx(0.0005)
        assert gc.get_freeze_count() > 10_000
    finally:
        sys.setswitchinterval(interval)
        gc.unfreeze()
