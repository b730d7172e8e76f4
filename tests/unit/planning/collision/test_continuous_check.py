"""Proving a path free and sampling it, in joint spaces whose obstacles are known exactly."""

from itertools import pairwise

import numpy as np
import pytest
from harness.coal_check import first_blocked

from so101_motion.planning.collision.continuous_check import CUT, WIDER, Level, travel

REACH = np.array([0.4, 0.3, 0.2, 0.1, 0.05])
MARGIN = 0.003
START, END = np.zeros(5), np.array([1.0, 0.5, -0.5, 1.0, -2.0])
LINE = np.array([START, END])
TOTAL = float(np.abs(END) @ REACH)


class Space:
    """Clearance as a function of joint angles; counts what it is asked."""

    def __init__(self, clearance):
        self._clearance = clearance
        self.asked = []

    def touches_within(self, distance):
        def touches(configuration):
            self.asked.append(configuration.copy())
            return self._clearance(configuration[:5]) <= distance

        return touches

    def levels(self):
        return [Level(each, self.touches_within(each)) for each in (MARGIN, *WIDER)]


def along(q):
    """How much of LINE has been travelled at a configuration on it [m]."""
    return float(q[0]) * TOTAL


def wall(begin, end):
    """Clearance to a wall that is met between two travels [m]: honest, it grows no faster."""
    return lambda q: max(begin - along(q), along(q) - end, -1.0)


def test_travel_is_the_angles_times_the_reach():
    points = np.array([START, END, END, START])
    assert travel(REACH, points) == pytest.approx([0.0, TOTAL, TOTAL, 2.0 * TOTAL])


def test_far_from_everything_a_few_postures_prove_a_line():
    space = Space(lambda q: 1.0)
    assert first_blocked(space.levels(), REACH, LINE, 0.0) is None
    assert len(space.asked) == np.ceil(TOTAL / (2 * WIDER[-1]))


def test_the_jaw_is_asked_for_as_it_is():
    space = Space(lambda q: 1.0)
    first_blocked(space.levels(), REACH, LINE, 0.7)
    assert {configuration[5] for configuration in space.asked} == {0.7}


@pytest.mark.parametrize("width", [0.0, 0.001, 0.02, 0.2])
@pytest.mark.parametrize("at", [0.0, 0.1234, 0.5, 0.87, 1.0])
def test_no_wall_is_so_thin_that_it_is_missed(width, at):
    begin = at * (TOTAL - width)
    space = Space(wall(begin, begin + width))
    blocked = first_blocked(space.levels(), REACH, LINE, 0.0)
    assert blocked is not None
    assert begin - MARGIN <= along(blocked) <= begin + width + MARGIN


def test_an_obstacle_that_is_passed_at_more_than_the_margin_does_not_block():
    for gap in (1.01, 2.0, 5.0, 30.0):
        space = Space(lambda q, gap=gap: max(gap * MARGIN, abs(along(q) - 0.3)))
        assert first_blocked(space.levels(), REACH, LINE, 0.0) is None


def test_what_is_passed_at_less_than_the_margin_blocks_where_it_stays_so():
    space = Space(lambda q: max(0.99 * MARGIN, 0.3 - along(q), along(q) - 0.31))
    assert first_blocked(space.levels(), REACH, LINE, 0.0) is not None


def test_a_lower_level_decides_where_the_margin_is_missed_by_little():
    space = Space(lambda q: max(0.9 * MARGIN, abs(along(q) - 0.3)))
    lenient = [Level(0.8 * MARGIN, space.touches_within(0.8 * MARGIN)), *space.levels()]
    assert first_blocked(space.levels(), REACH, LINE, 0.0) is not None
    assert first_blocked(lenient, REACH, LINE, 0.0) is None


def test_one_posture_is_a_motion_too():
    space = Space(wall(0.3, 0.4))
    q = START + (0.35 / TOTAL) * (END - START)
    assert first_blocked(space.levels(), REACH, q[None], 0.0) == pytest.approx(q)
    assert first_blocked(space.levels(), REACH, START[None], 0.0) is None
    assert first_blocked(space.levels(), REACH, np.array([START, START]), 0.0) is None


def test_a_polyline_is_judged_as_the_lines_it_is_made_of():
    rng = np.random.default_rng(1)
    for _ in range(200):
        begin = rng.uniform(0.0, TOTAL)
        shares = np.sort(np.concatenate([[0.0, 1.0], rng.uniform(0.0, 1.0, rng.integers(0, 20))]))
        points = START + np.repeat(shares, rng.integers(1, 3))[:, None] * (END - START)
        space = Space(wall(begin, begin + 0.001))
        assert first_blocked(space.levels(), REACH, points, 0.0) is not None
        clear = Space(lambda q, begin=begin: 0.0035 + abs(along(q) - begin))
        assert first_blocked(clear.levels(), REACH, points, 0.0) is None


def test_the_levels_are_such_that_cutting_a_part_needs_the_next_one():
    clearances = (MARGIN, *WIDER)
    for narrow, wide in pairwise(clearances):
        assert wide <= CUT * narrow * (1.0 + 1e-12)
