import pytest

from benchmarks.bench_no_path import closed
from benchmarks.no_path_problems import cut_off, shut_in, slot, tube
from so101_motion.common.errors import NoPath
from so101_motion.planning.checkpoint import Abandoned, never_abandoned
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.paths.path import PathFinder

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
