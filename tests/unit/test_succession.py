"""Motions that supersede each other, of an arm that is only told when to come to rest."""

from concurrent.futures import Future

import pytest

from so101_motion.errors import Interrupted, MotionError
from so101_motion.motion import Motion
from so101_motion.succession import Succession


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def motions(told):
    succession = Succession(lambda: told.append("rest"))
    yield succession
    succession.close()


def until_interrupted(motion: Motion) -> None:
    motion.wait_for(Future())


def test_before_the_first_motion_nothing_is_under_way(motions) -> None:
    assert motions.current.future.done()


def test_a_motion_begins_at_rest_and_ends_when_it_has_run(motions, told) -> None:
    motion = motions.start(lambda motion: told.append("moves"))
    motion.result(5.0)
    assert told == ["rest", "moves"]


def test_a_newer_motion_ends_the_one_under_way_and_waits_for_its_end(motions, told) -> None:
    first = motions.start(until_interrupted)
    second = motions.start(lambda motion: told.append(str(first.future.exception())))
    second.result(5.0)
    assert "a newer motion" in told[-1]
    with pytest.raises(Interrupted, match="a newer motion"):
        first.result(5.0)


def test_what_a_motion_raises_is_heard_by_who_waits_for_it(motions) -> None:
    def fails(motion: Motion) -> None:
        raise MotionError("it broke")

    with pytest.raises(MotionError, match="it broke"):
        motions.start(fails).result(5.0)


def test_a_turn_begins_before_it_ends_the_motion_under_way(motions, told) -> None:
    first = motions.start(until_interrupted)
    running: Future[None] = Future()

    def begin(motion: Motion) -> Future[None]:
        assert not first.future.done()
        return motion.begin(lambda: running, lambda running, by: told.append(by))

    turn = motions.turn(begin)
    with pytest.raises(Interrupted, match="a newer motion"):
        first.result(5.0)
    running.set_result(None)
    turn.result(5.0)
    assert told == ["rest"]


def test_a_turn_that_cannot_begin_leaves_the_motion_under_way_alone(motions) -> None:
    first = motions.start(until_interrupted)

    def refuses(motion: Motion) -> Future[None]:
        raise MotionError("not now")

    with pytest.raises(MotionError, match="not now"):
        motions.turn(refuses)
    assert motions.current is first
    assert not first.future.done()


def test_the_arm_is_at_rest_while_something_else_is_opened(motions, told) -> None:
    first = motions.start(until_interrupted)
    with motions.at_rest():
        assert first.future.done()
        assert told[-1] == "rest"


def test_closing_ends_what_is_under_way(told) -> None:
    motions = Succession(lambda: told.append("rest"))
    first = motions.start(until_interrupted)
    motions.close()
    with pytest.raises(Interrupted, match="shutdown"):
        first.result(0.0)
