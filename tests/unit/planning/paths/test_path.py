from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.bench_no_path import closed
from benchmarks.no_path_problems import cut_off, shut_in, slot, tube
from so101_motion.common.errors import NoPath
from so101_motion.planning.checkpoint import Abandoned, never_abandoned
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.paths.compiled_search import Deadline, Space, Tree
from so101_motion.planning.paths.path import PathFinder
from so101_motion.planning.paths.start_recovery import find_departure, is_harmless, needs_departure

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


# Leaving a bad start


# How a powered-off arm lies: beyond two limits, gripper on the shoulder.
RESTING = np.radians([0, -105, 91, 77, 0])


def departure(model, collision, q_start, towards=()):
    return find_departure(model, collision, q_start, q_jaw=0.0, towards=towards, seed=0)


def test_one_tick_outside_is_noise(model, collision):
    assert not needs_departure(model, collision, np.zeros(5), 0.0)
    q = np.zeros(5)
    q[0] = model.upper[0] + 0.0015
    assert not needs_departure(model, collision, q, 0.0)
    q[0] = model.upper[0] + 0.0016
    assert needs_departure(model, collision, q, 0.0)


def test_an_arm_that_lies_folded_can_leave(model, collision):
    assert needs_departure(model, collision, RESTING, 0.0)
    q_exit = departure(model, collision, RESTING)
    assert model.outside(q_exit) is None
    assert collision.is_free(q_exit)
    assert collision.travel(np.array([RESTING, q_exit]))[-1] < 0.4
    depths = [collision.distances(q) for q in np.linspace(RESTING, q_exit, 100)]
    deepest = np.min(depths, axis=0)
    allowed = np.minimum(depths[0], collision.margin) - 0.001
    assert np.all(deepest >= allowed)


def test_a_start_outside_the_limits_goes_straight_in(model, collision):
    q_start = np.radians([0, -104, 0, 0, 0])
    q_exit = departure(model, collision, q_start)
    assert np.array_equal(q_exit, np.clip(q_start, model.lower, model.upper))


def test_the_way_out_leans_towards_the_goal_if_it_can(model, collision):
    # Just too close to the floor; the goal is straight above.
    q_start = np.radians([0, 20, -10, 78.0, 0])
    while collision.is_free(q_start):
        q_start[1] += 0.002
    goal = q_start - [0.0, 0.5, 0.0, 0.0, 0.0]
    q_exit = departure(model, collision, q_start, [goal])
    assert collision.is_free(q_exit)
    assert is_harmless(collision, np.array([q_start, q_exit]), 0.0)


def test_a_motion_into_contact_is_not_harmless(collision):
    down = np.array([np.zeros(5), np.radians([0, 60, 20, 40, 0])])
    assert not is_harmless(collision, down, 0.0)
    assert is_harmless(collision, down[[0, 0]], 0.0)


# That there is none


AGES = 1e6
"""A time budget that is never used up [s]."""


def refused(model, problem, checkpoint=never_abandoned):
    finder = PathFinder(model, CollisionModel(model, problem.scene, checkpoint))
    with pytest.raises(NoPath, match="there is no path: ") as caught:
        finder.find(problem.path[0], [problem.path[-1]], AGES)
    return caught.value


def test_a_goal_that_is_shut_in_is_refused_whatever_the_time(model):
    error = refused(model, shut_in(model, 1))
    assert error.where == "goal"
    assert {"left", "right", "above", "below"} & set(error.blockers[:2])
    assert "the goal is free but shut in by '" in str(error)
    assert str(error).endswith(
        ": nothing leads up to it; choose another approach, or clear the way"
    )
    assert str(error) == str(refused(model, shut_in(model, 1)))


def test_walls_that_cut_the_goal_off_are_named(model):
    error = refused(model, cut_off(model, 0))
    assert error.where == "path"
    assert set(error.blockers[:2]) <= {"left", "right", "inner left", "inner right"}
    assert "the path between them is blocked by '" in str(error)
    assert str(error).endswith("; choose another goal, or clear the way")


@pytest.mark.parametrize(("make", "seed"), [(slot, 0), (slot, 1), (tube, 14)])
def test_gaps_two_millimetres_wider_than_what_must_pass_are_not_taken_for_closed(model, make, seed):
    problem = make(model, seed)
    assert CollisionModel(model, problem.scene).first_blocked(problem.path) is None
    assert closed(model, problem, 20_000) is None


def test_it_ends_when_the_plan_is_not_wanted_any_more(model):
    problem, left = cut_off(model, 0), [100]

    def checkpoint():
        left[0] -= 1
        if left[0] < 0:
            raise Abandoned

    with pytest.raises(Abandoned):
        PathFinder(model, CollisionModel(model, problem.scene, checkpoint)).find(
            problem.path[0], [problem.path[-1]], AGES
        )
    assert left == [-1]
