import asyncio
import logging
import threading
from concurrent.futures import Future

import pytest

from so101_motion.arm.motion_handle import Motion
from so101_motion.common.errors import Interrupted, NoPath
from so101_motion.viam.requests.await_motion import log_failure_of, run_to_end, wait_for_arrival


class Mover:
    """A motion under way that takes a moment to come to rest when it is halted."""

    def __init__(self):
        self.motion = Motion()
        self.running = Future()
        self.halts = []
        self.motion.halt = self.halt
        self.running.add_done_callback(self.motion.take_outcome)

    def halt(self, by):
        self.halts.append(by)
        threading.Timer(0.05, lambda: self.running.set_exception(Interrupted(by))).start()


async def test_arrival_returns_when_the_arm_is_there_and_raises_what_went_wrong():
    mover = Mover()
    call = asyncio.create_task(wait_for_arrival(mover.motion))
    await asyncio.sleep(0)
    assert not call.done()
    mover.running.set_result(None)
    await call

    mover = Mover()
    mover.running.set_exception(NoPath("no way"))
    with pytest.raises(NoPath):
        await wait_for_arrival(mover.motion)


@pytest.mark.parametrize(
    ("times", "is_over", "halts"),
    [(1, False, ["cancelled"]), (2, False, ["cancelled"]), (1, True, [])],
)
async def test_a_cancelled_wait_ends_only_after_the_motion_is_at_rest(times, is_over, halts):
    mover = Mover()
    if is_over:
        mover.running.set_result(None)
    call = asyncio.create_task(wait_for_arrival(mover.motion))
    if is_over:
        call.cancel()
    for _ in range(times):
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        call.cancel()

    with pytest.raises(asyncio.CancelledError):
        await call
    assert mover.halts == halts
    assert mover.running.done()


@pytest.mark.parametrize(
    ("error", "lines"), [(None, 0), (Interrupted("stop"), 0), (NoPath("no way"), 1)]
)
def test_a_motion_nobody_waits_for_reports_what_went_wrong(caplog, error, lines):
    mover = Mover()
    log_failure_of(mover.motion, logging.getLogger("test"))
    if error is None:
        mover.running.set_result(None)
    else:
        mover.running.set_exception(error)

    assert len(caplog.records) == lines


async def test_a_step_raises_what_it_does_and_is_finished_although_nobody_waits_for_it_any_more():
    begun, may_end, done = threading.Event(), threading.Event(), []

    def step():
        begun.set()
        may_end.wait(60.0)
        done.append(True)

    call = asyncio.create_task(run_to_end(step))
    await asyncio.to_thread(begun.wait, 60.0)
    call.cancel()
    for _ in range(3):  # it hears of that in one turn of the loop
        await asyncio.sleep(0)
    assert not call.done()
    may_end.set()
    with pytest.raises(asyncio.CancelledError):
        await call
    assert done == [True]

    assert await run_to_end(lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        await run_to_end(lambda: 1 // 0)
