from itertools import pairwise

from so101_motion.drivers.bus.registers import END
from so101_motion.drivers.bus.stale_replies import OVERDUE, StaleReplies

POSITION, CURRENT = 56, 69


def lengths(stale, count, now, servos=(1,), **options):
    """How long the answers to so many questions in a row shall be."""
    asked = []
    for _ in range(count):
        begin, length = stale.span(servos, POSITION, 2, now, **options)
        assert begin <= POSITION
        assert begin + length >= POSITION + 2
        assert begin + length <= END
        asked.append(length)
    return asked


def test_the_next_question_has_another_length_while_an_answer_is_overdue():
    stale = StaleReplies()
    stale.missed([3], 2, 1.0)
    stale.missed([3], 3, 1.1)
    assert lengths(stale, 1, 1.2, (3,), again=True) == [4]
    assert lengths(stale, 1, 1.2, (1, 3), again=True) == [4]
    assert lengths(stale, 1, 1.2, (1,), again=True) == [2]
    assert lengths(stale, 1, 1.3, (3,), again=True) == [2], "it will not come any more"
    assert lengths(stale, 1, 1.5, (3,), again=True) == [2]


def test_a_copy_of_an_answer_is_reckoned_with_for_a_while():
    stale = StaleReplies()
    asked = lengths(stale, 10, 0.0)
    assert all(one != other for one, other in pairwise(asked))
    assert set(asked) <= set(range(2, 7))
    assert lengths(stale, 1, OVERDUE + 0.05) == [2]


def test_a_control_cycle_asks_for_the_same_again_without_a_change():
    stale = StaleReplies()
    assert lengths(stale, 5, 0.0, (1, 2, 3), again=True) == [2] * 5
    stale.span((1, 2), CURRENT, 2, 0.0, again=True)
    assert lengths(stale, 1, 0.0, (1, 2), again=True) == [4], "copies of either are about"


def test_where_there_is_no_time_for_a_longer_one_the_oldest_straggler_is_put_up_with():
    stale = StaleReplies()
    for k in range(15):
        (length,) = lengths(stale, 1, 0.01 * k, again=True, longest=lambda _: 16)
        assert length == 2 + k
        stale.missed([1], length, 0.01 * k)
    assert lengths(stale, 1, 0.2, again=True, longest=lambda _: 16) == [2]
    assert lengths(stale, 1, 0.2, again=True) == [17]


def test_what_is_needed_is_asked_for_however_slow_the_wire_and_at_the_end_of_the_registers():
    stale = StaleReplies()
    for length in range(2, 9):
        stale.missed([1], length, 0.0)
    assert lengths(stale, 1, 0.1, again=True, longest=lambda _: -3) == [9]
    stale = StaleReplies()
    for length in range(END):
        stale.missed([1], length, 0.0)
    assert stale.span((1,), END - 1, 1, 0.1) == (END - 1, 1)
    assert stale.span((1,), 0, END, 0.1) == (0, END)
