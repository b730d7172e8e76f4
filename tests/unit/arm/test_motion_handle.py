import threading
import tracemalloc
from concurrent.futures import Future

import pytest

from so101_motion.arm.motion_handle import Motion
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import Interrupted


def test_interrupting_halts_what_was_begun_and_nothing_else():
    motion, halted = Motion(), []
    with motion.begin():
        motion.halt = halted.append
    motion.interrupt("stop")
    motion.interrupt("stop")
    assert halted == ["stop"]


def test_an_interrupted_motion_never_begins():
    motion = Motion()
    motion.interrupt("cancelled")
    with pytest.raises(Interrupted, match="cancelled"), motion.begin():
        pytest.fail("must not start")


def test_interrupting_a_motion_that_is_over_does_nothing():
    motion, halted = Motion(), []
    motion.halt = halted.append
    motion.future.set_result(None)
    motion.interrupt("stop")
    assert not halted
    motion.result()


@pytest.mark.parametrize("interrupted", [False, True])
def test_a_pause_lasts_its_time_unless_the_motion_is_interrupted(interrupted):
    clock, motion, ended = ManualClock(), Motion(), Future()

    def pause():
        try:
            motion.pause(clock, 3.0)
        except Interrupted as error:
            ended.set_result(error.by)
        else:
            ended.set_result(clock.now())

    thread = threading.Thread(target=pause)
    thread.start()
    if interrupted:
        motion.interrupt("stop")
        assert ended.result(60.0) == "stop"
    else:
        while not ended.done():
            clock.advance(0.5)
        assert ended.result() >= 3.0
    thread.join()


def test_an_interrupted_wait_for_another_motion_leaves_its_future_alone():
    waiting, other = Motion(), Motion()
    waiting.interrupt("stop")
    with pytest.raises(Interrupted, match="stop"):
        waiting.wait_for(other.future)
    assert not other.future.cancelled()
    other.future.set_result(None)


def test_pauses_of_an_endless_motion_leave_nothing_behind():
    clock, motion = ManualClock(), Motion()
    motion.pause(clock, 0.0)
    tracemalloc.start()
    for _ in range(1000):
        motion.pause(clock, 0.0)
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 50_000
