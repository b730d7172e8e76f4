from functools import partial

import numpy as np
import pytest
from harness.coal_check import CoalJudge
from harness.random_scenes import LEFT, POST, RIGHT

from benchmarks.bench_no_path import closed
from benchmarks.no_path_problems import cut_off, shut_in, slot, tube
from so101_motion.common.errors import ConfigError, NoPath
from so101_motion.native.library import native
from so101_motion.planning.checkpoint import never_abandoned
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import MARGIN_TOLERANCE
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.paths.compiled_search import Deadline, Space
from so101_motion.planning.paths.infeasibility import Infeasibility
from so101_motion.planning.paths.path import PathFinder
from so101_motion.planning.paths.routes import Routing
from so101_motion.planning.paths.start_recovery import find_departure, is_harmless, needs_departure
from so101_motion.planning.planner import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Strength

# Free at both ends, but the straight joint line dips into the table.
OVER_THE_TABLE = np.radians([[-90, -10, 60, -20, -40], [10, -10, 40, 60, 10]])


def test_a_free_straight_line_is_taken(model, collision):
    goal = np.radians([30, -20, 20, 10, 0])
    asked = []

    def goals():
        for each in (goal, -goal):
            asked.append(each)
            yield each

    found = PathFinder(model, collision).find(np.zeros(5), goals(), 1.0)
    assert np.array_equal(found.waypoints, [np.zeros(5), goal])
    assert found.goal == 0
    assert len(asked) == 1, "goals are worked out only as far as they are needed"


def test_of_several_goals_the_first_with_a_free_line_is_taken(model, collision):
    start, behind = OVER_THE_TABLE
    easy = start + np.radians([5, -5, 0, 0, 0])
    assert PathFinder(model, collision).is_free_line(start, easy)
    found = PathFinder(model, collision).find(start, [behind, easy], 5.0)
    assert found.goal == 1
    assert np.array_equal(found.waypoints[-1], easy)


# Leaving a bad start


def departure(model, collision, q_start, towards=()):
    return find_departure(model, collision, q_start, q_jaw=0.0, towards=towards, seed=0)


def test_one_tick_outside_is_noise(model, collision):
    assert not needs_departure(model, collision, np.zeros(5), 0.0)
    q = np.zeros(5)
    q[0] = model.upper[0] + 0.0015
    assert not needs_departure(model, collision, q, 0.0)
    q[0] = model.upper[0] + 0.0016
    assert needs_departure(model, collision, q, 0.0)


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
    down = np.array([np.zeros(5), np.radians([0, 60, 20, 40, 0])])
    assert not is_harmless(collision, down, 0.0), "it leads into contact"
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


def test_a_body_that_grazes_its_margin_is_not_asked_about_at_every_place_of_the_wrist(model):
    """Coal was asked 23,000 times here, for 2 s."""
    problem = cut_off(model, 4)
    collision = CollisionModel(model, problem.scene)
    space = Space(lower=model.lower, upper=model.upper, weights=collision.reach)
    ends = Infeasibility(space, collision, 0.0, problem.path[0], [problem.path[1]])
    assert ends.look(Deadline(AGES), 250_000, 1) is not None
    _, by_coal = collision.batch.tally()
    assert by_coal < 100


@pytest.mark.parametrize(("make", "seed"), [(slot, 0), (tube, 14)])
def test_gaps_two_millimetres_wider_than_what_must_pass_are_not_taken_for_closed(model, make, seed):
    problem = make(model, seed)
    assert CollisionModel(model, problem.scene).first_blocked(problem.path) is None
    assert closed(model, problem, 10_000) is None


# Routes around an obstacle: compared by counted work, cut short in time, proven, and given up


LIMITS = MotionLimits(
    velocity=np.array([3.0, 2.0, 3.0, 2.5, 3.0]),
    acceleration=np.array([10.0, 6.0, 10.0, 10.0, 12.0]),
    jerk=np.full(5, 300.0),
)


def request(effort, **changes):
    made = {"q_start": LEFT, "goal": JointGoal(q=RIGHT), "limits": LIMITS, "scene": POST}
    return PlanRequest(**{**made, "route_effort": effort, **changes})


@pytest.mark.parametrize("seed", range(2))
def test_more_effort_gives_a_quicker_motion_that_coal_finds_free(planner, seed):
    some, more = (planner.plan(request(effort, seed=seed)) for effort in (1, 16))
    assert (some.report.routes, some.report.out_of_time) == (1, False)
    assert 8 < more.report.routes <= 16
    assert more.duration <= some.duration
    judge = CoalJudge(RobotModel.load(), POST)
    for each in (some, more):
        np.testing.assert_array_equal(each.trajectory.q[[0, -1]], [LEFT, RIGHT])
        assert judge.keeps_room_along(each.trajectory.q, share=1.0 - MARGIN_TOLERANCE)
        assert judge.keeps_room_along(each.path, share=1.0 - MARGIN_TOLERANCE)


def found_route(effort=8, checkpoint=None, budget=10.0):
    model = RobotModel.load()
    collision = CollisionModel(model, POST, *([checkpoint] if checkpoint else []))
    finder = PathFinder(model, collision)
    return finder.find(LEFT, [RIGHT], budget, partial(Routing.within, LIMITS, effort))


def test_when_the_time_is_up_the_best_route_so_far_is_taken(monkeypatch):
    looks = 0

    def has_passed(self):
        nonlocal looks
        looks += 1
        return looks > 30

    monkeypatch.setattr(Deadline, "has_passed", has_passed)
    found = found_route(effort=1000)
    assert found.out_of_time
    assert 1 < found.routes < 30
    assert found.motion.length > 0.0


def test_weak_servos_hold(planner):
    hard = MotionLimits.uniform(velocity=8.0, acceleration=80.0, jerk=5000.0)
    weak = Strength(holding=1.1, moving=0.6)
    made = planner.plan(request(16, limits=hard, strength=weak))
    assert 0.99 < made.report.effort <= 1.001
    assert made.duration > 1.1 * planner.plan(request(16, limits=hard)).duration


@pytest.mark.parametrize("effort", [0, 2.5, 10_001])
def test_an_effort_out_of_range_is_refused(effort):
    with pytest.raises(ConfigError, match=r"route_effort.*1 to 10000"):
        request(effort)


# The compiled search


def length(points):
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


@pytest.mark.parametrize("seed", range(2))
def test_a_path_around_a_post_is_proven_by_coal_and_the_same_at_any_width(model, seed):
    judge = CoalJudge(model, POST)
    found = []
    for lanes in (4, 8):
        native().library.so101_start(lanes)
        finder = PathFinder(model, CollisionModel(model, POST), seed=seed)
        found.append(finder.find(LEFT, [RIGHT], 10.0).waypoints)
    native().library.so101_start(native().lanes)
    assert judge.keeps_room_along(found[0], share=1.0 - MARGIN_TOLERANCE)
    assert len(found[0]) > 2
    for other in found[1:]:
        np.testing.assert_array_equal(found[0], other)
    assert length(found[0]) < 3.6  # the straight line: 1.6


def test_of_several_goals_the_one_that_is_reached_is_reported(model):
    finder = PathFinder(model, CollisionModel(model, POST))
    goals = [RIGHT, RIGHT + 0.1]
    found = finder.find(LEFT, goals, 10.0)
    np.testing.assert_array_equal(found.waypoints[-1], goals[found.goal])
