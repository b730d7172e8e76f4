"""Motions that replace each other, on a stand-in arm that is only asked to stop."""

import gc
import threading
import weakref
from concurrent.futures import Future
from contextvars import copy_context
from functools import partial

import pytest
from harness.facing_arms import in_time

from so101_motion.arm.gripper import Gripper
from so101_motion.arm.motion_handle import Motion
from so101_motion.arm.motion_queue import MotionQueue
from so101_motion.arm.stop_order import NUMBERS, mark_request, refuse_older
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import Interrupted, MotionError
from so101_motion.rig.simulated_rig import open_simulated


@pytest.fixture
def told() -> list[str]:
    return []


def over() -> Future[None]:
    done: Future[None] = Future()
    done.set_result(None)
    return done


def resting(told: list[str]) -> Future[None]:
    told.append("rest")
    return over()


@pytest.fixture
def motions(told):
    queue = MotionQueue(lambda: resting(told))
    yield queue
    queue.close()


def until_interrupted(motion: Motion) -> None:
    motion.wait_for(Future())


def under_way(motions: MotionQueue, lasts: threading.Event | None = None) -> Motion:
    """A motion that has begun, and lasts until it is interrupted, or until it is let go."""
    begun = threading.Event()

    def run(motion: Motion) -> None:
        begun.set()
        if lasts is None:
            until_interrupted(motion)
        else:
            lasts.wait(60.0)

    motion = motions.start(run)
    assert begun.wait(60.0)
    return motion


def test_failed_motions_do_not_keep_each_other(motions) -> None:
    def fail(motion: Motion) -> None:
        raise MotionError("no")

    refs = []
    for _ in range(3):
        motion = motions.start(fail)
        assert isinstance(motion.future.exception(60.0), MotionError)
        refs.append(weakref.ref(motion))
    del motion
    gc.collect()
    assert refs[0]() is None  # a module that runs for a month has refused many


def test_a_turn_that_cannot_begin_leaves_the_motion_under_way_alone(motions) -> None:
    first = motions.start(until_interrupted)

    def refuses(motion: Motion) -> Future[None]:
        raise MotionError("not now")

    with pytest.raises(MotionError, match="not now"):
        motions.take_over(refuses)
    assert motions.current is first
    assert not first.future.done()


def test_a_stop_does_not_wait_for_a_beginning_motion(motions, told) -> None:
    """It may come from the event loop, which must not wait for a lock that others hold for long."""
    beginning, go_on = threading.Event(), threading.Event()

    def begin(motion: Motion) -> Future[None]:
        beginning.set()
        go_on.wait(60.0)
        return Future()

    turning = threading.Thread(target=lambda: motions.take_over(begin))
    turning.start()
    assert beginning.wait(60.0)
    stopping = threading.Thread(target=lambda: motions.current.interrupt("stop"))
    stopping.start()
    stopping.join(20.0)  # less than the motion waits to be let go
    waited = stopping.is_alive()
    go_on.set()
    turning.join()
    stopping.join()
    assert not waited


@pytest.mark.parametrize("how", ["interrupted", "superseded"])
def test_a_motion_ended_before_it_began_does_not_touch_the_arm(motions, told, how: str) -> None:
    gate = threading.Event()
    first = under_way(motions, gate)
    second = motions.start(lambda motion: told.append("moves"))
    if how == "interrupted":
        motions.current.interrupt("stop")
    else:
        motions.take_over(lambda motion: over())
    gate.set()
    with pytest.raises(Interrupted, match="stop" if how == "interrupted" else "a newer motion"):
        second.result(60.0)
    first.result(60.0)
    assert told == ["rest"]


def test_a_newer_motion_tells_the_older_one_at_once(motions) -> None:
    """Even if no thread is free to wait for it: a stop tells the newest alone."""
    gate = threading.Event()
    first = under_way(motions, gate)
    waiting = [motions.start(until_interrupted) for _ in range(6)]
    with pytest.raises(Interrupted, match="a newer motion"):
        waiting[-2].wait_for(Future())
    assert not first.future.done()
    gate.set()


def test_an_interrupted_motion_never_begins_and_its_wait_leaves_another_alone():
    motion, other = Motion(), Motion()
    motion.interrupt("cancelled")
    with pytest.raises(Interrupted, match="cancelled"), motion.begin():
        pytest.fail("must not start")
    with pytest.raises(Interrupted, match="cancelled"):
        motion.wait_for(other.future)
    assert not other.future.cancelled()
    other.future.set_result(None)


def test_interrupting_halts_what_was_begun_and_is_not_over():
    motion, over, halted = Motion(), Motion(), []
    with motion.begin():
        motion.halt = over.halt = halted.append
    motion.interrupt("stop")
    motion.interrupt("stop")
    over.future.set_result(None)
    over.interrupt("stop")
    assert halted == ["stop"]
    over.result()


@pytest.mark.parametrize("interrupted", [False, True])
def test_a_pause_lasts_its_time_unless_the_motion_is_interrupted(interrupted):
    clock, motion, ended = ManualClock(), Motion(), Future()

    def pause():
        try:
            motion.pause_until(clock, clock.now() + 3.0)
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


# Motions that were asked for before a stop do not begin after it


def requested():
    """A request that arrives now; ``run`` carries something out for it."""
    context = copy_context()
    context.run(mark_request)
    return context


@pytest.fixture
def queue():
    queue = MotionQueue(lambda: None)
    yield queue
    queue.close()


def test_a_request_from_before_the_stop_is_refused_and_one_from_after_it_is_not():
    before = requested()
    stopped = next(NUMBERS)
    with pytest.raises(Interrupted, match="stop"):
        before.run(refuse_older, stopped)
    requested().run(refuse_older, stopped)
    refuse_older(stopped)  # outside of any request
    requested().run(refuse_older, 0)  # without a stop


def test_a_stopped_queue_begins_nothing_that_was_asked_for_before(queue):
    request = requested()
    queue.stopped = next(NUMBERS)
    for begin in (queue.start, queue.take_over):
        with pytest.raises(Interrupted):
            request.run(begin, lambda motion: None)
    requested().run(queue.start, lambda motion: None).result(10.0)


def test_a_motion_that_has_begun_may_begin_others_after_a_stop_of_something_else(queue):
    """Such as the jaw's of a program."""
    request = requested()
    request.run(queue.start, lambda motion: refuse_older(next(NUMBERS))).result(10.0)


def test_a_jaw_begins_nothing_that_was_asked_for_before_its_stop(make_sim):
    sim = make_sim()
    sim.executor.start()
    gripper, request = Gripper(sim.executor), requested()
    in_time(sim.clock, gripper.stop)
    for begin in (
        partial(gripper.move, 0.5, wait=False),
        partial(gripper.grab, wait=False),
        gripper.follow,
    ):
        with pytest.raises(Interrupted):
            request.run(begin)
    assert not gripper.is_moving
    sim.after(3.0, requested().run(partial(gripper.move, 0.5, wait=False)).future)


def test_manual_mode_that_was_asked_for_before_a_stop_does_not_begin_after_it():
    with open_simulated() as rig:
        before = requested()
        rig.arm.stop()
        with pytest.raises(Interrupted, match="stop"):
            before.run(rig.arm.set_manual, True)
        make_wall = rig.arm._open_ended.wall

        def wall(now):
            rig.arm.stop()
            return make_wall(now)

        rig.arm._open_ended.wall = wall
        with pytest.raises(Interrupted, match="stop"):
            requested().run(rig.arm.set_manual, True)
        assert not rig.arm.is_movable_by_hand
