from types import SimpleNamespace

import numpy as np
import pytest

from so101_motion.planning.paths.compiled_search import Deadline, Space, Tree
from so101_motion.planning.paths.path import PathFinder

# Free at both ends, but the straight joint line dips into the table.
OVER_THE_TABLE = np.radians([[-90, -10, 60, -20, -40], [10, -10, 40, 60, 10]])


def test_a_free_straight_line_is_taken(model, collision):
    goal = np.radians([30, -20, 20, 10, 0])
    found = PathFinder(model, collision).find(np.zeros(5), [goal], 1.0)
    assert np.array_equal(found.waypoints, [np.zeros(5), goal])
    assert found.goal == 0


def test_a_path_around_is_found_where_the_line_is_blocked(model, collision):
    start, goal = OVER_THE_TABLE
    finder = PathFinder(model, collision)
    assert not finder.is_free_line(start, goal)
    found = finder.find(start, [goal], 5.0)
    assert len(found.waypoints) > 2
    assert np.array_equal(found.waypoints[[0, -1]], OVER_THE_TABLE)
    assert all(model.outside(q) is None for q in found.waypoints)
    assert collision.first_blocked(found.waypoints) is None


def test_of_several_goals_the_first_with_a_free_line_is_taken(model, collision):
    start, behind = OVER_THE_TABLE
    easy = start + np.radians([5, -5, 0, 0, 0])
    assert PathFinder(model, collision).is_free_line(start, easy)
    found = PathFinder(model, collision).find(start, [behind, easy], 5.0)
    assert found.goal == 1
    assert np.array_equal(found.waypoints[-1], easy)


def test_goals_are_worked_out_only_as_far_as_they_are_needed(model, collision):
    asked = []

    def goals():
        for angle in (0.1, 0.2):
            asked.append(angle)
            yield np.full(5, angle)

    PathFinder(model, collision).find(np.zeros(5), goals(), 1.0)
    assert asked == [0.1]


@pytest.mark.parametrize("shut_in", ["start", "goal"])
def test_an_end_that_is_shut_in_is_named(model, collision, shut_in):
    finder, random = PathFinder(model, collision), np.random.default_rng(0)
    space = Space(lower=model.lower, upper=model.upper, weights=collision.reach)
    wide = Tree(random.uniform(model.lower, model.upper, (100, 5)), space, random)
    low = np.radians([0.0, 34.0, -14.0, 36.5, 0.0])  # the jaw just above the table
    narrow = Tree(low[None], space, random)
    ends = (narrow, wide) if shut_in == "start" else (wide, narrow)
    search = SimpleNamespace(from_start=ends[0], from_goals=ends[1])
    found = finder._no_path(search, Deadline(0.3))
    assert found.where == shut_in
    assert f"the {shut_in} is free but shut in, mostly by the floor: " in str(found)
    assert found.blockers[0] == "floor"
