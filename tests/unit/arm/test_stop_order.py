"""Motions that were asked for before a stop do not begin after it."""

from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from functools import partial

import pytest

from so101_motion.arm.gripper import Gripper
from so101_motion.arm.motion_queue import MotionQueue
from so101_motion.arm.stop_order import NUMBERS, mark_request, refuse_older
from so101_motion.common.errors import Interrupted
from so101_motion.rig.simulated_rig import open_simulated


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


def test_without_a_stop_nothing_is_refused():
    requested().run(refuse_older, 0)


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
    with ThreadPoolExecutor(1) as beside:
        stopping = beside.submit(gripper.stop)
        while not stopping.done():
            sim.clock.advance(0.01)
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
