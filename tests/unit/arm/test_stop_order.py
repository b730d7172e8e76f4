"""Motions that were asked for before a stop do not begin after it."""

from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context

import pytest

from so101_motion.arm.gripper import Gripper
from so101_motion.arm.motion_queue import MotionQueue
from so101_motion.arm.stop_order import LastStop, mark_request
from so101_motion.common.errors import SUPERSEDED, Interrupted


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
    last, before = LastStop(), requested()
    last.note()
    with pytest.raises(Interrupted, match="stop"):
        before.run(last.refuse_older)
    requested().run(last.refuse_older)
    last.refuse_older()  # outside of any request


def test_the_stop_of_another_arm_ends_nothing():
    mine, request = LastStop(), requested()
    LastStop().note()
    request.run(mine.refuse_older)


def test_a_stopped_queue_begins_nothing_that_was_asked_for_before(queue):
    request = requested()
    queue.give_up("stop")
    for begin in (queue.start, queue.take_over):
        with pytest.raises(Interrupted):
            request.run(begin, lambda motion: None)
    requested().run(queue.start, lambda motion: None).result(10.0)


def test_what_makes_way_for_a_request_does_not_end_it(queue):
    request = requested()
    queue.give_up(SUPERSEDED)
    request.run(queue.start, lambda motion: None).result(10.0)


def test_a_motion_that_has_begun_may_begin_others_after_a_stop_of_something_else(queue):
    """Such as the jaw's of a program."""
    last, request = LastStop(), requested()

    def run(motion):
        last.note()
        last.refuse_older()

    request.run(queue.start, run).result(10.0)


def test_a_jaw_begins_nothing_that_was_asked_for_before_its_stop(make_sim):
    sim = make_sim()
    sim.executor.start()
    gripper, request = Gripper(sim.executor), requested()
    with ThreadPoolExecutor(1) as beside:
        stopping = beside.submit(gripper.stop)
        while not stopping.done():
            sim.clock.advance(0.01)
    for begin in (lambda: gripper.start_move(0.5), gripper.start_grab, gripper.open_following):
        with pytest.raises(Interrupted):
            request.run(begin)
    assert not gripper.is_moving
    sim.after(3.0, requested().run(gripper.start_move, 0.5).future)
