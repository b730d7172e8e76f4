from itertools import pairwise

import numpy as np
import pytest

from so101_motion.common.errors import NoPath
from so101_motion.planning.collision.collision import Clearance, CollisionModel
from so101_motion.planning.collision.continuous_check import SampledCheck
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.paths.path import PathFinder

# Free at both ends, but the straight joint line dips into the table.
OVER_THE_TABLE = np.radians([[-90, -10, 60, -20, -40], [10, -10, 40, 60, 10]])


@pytest.fixture(scope="module")
def model():
    return RobotModel.load()


@pytest.fixture(scope="module", params=[True, False], ids=["compiled", "coal alone"])
def collision(model, request):
    return CollisionModel(model, compiled=request.param)


class Wall:
    """Surroundings in joint space: blocked where ``is_wall`` says so."""

    reach = np.full(5, 0.3)
    scene = Scene()

    def __init__(self, is_wall):
        self._is_wall = is_wall

    def is_free(self, q, q_jaw):
        return not self._is_wall(q)

    def first_blocked(self, points, q_jaw):
        for begin, end in pairwise(points):
            for u in np.linspace(0.0, 1.0, 30):
                q = begin + u * (end - begin)
                if self._is_wall(q):
                    return q
        return None

    def sampled_check(self, q_jaw, *, spacing, extra=0.0):
        return SampledCheck(
            lambda configuration: self._is_wall(configuration[:5]),
            self.reach,
            q_jaw=q_jaw,
            spacing=spacing,
        )

    def clearance(self, q, q_jaw):
        return Clearance(0.0, "gripper", "brick", 0.003, ("the gripper", "'brick'"))


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


def test_the_same_seed_finds_the_same_path(model, collision):
    start, goal = OVER_THE_TABLE
    first, second = (
        PathFinder(model, collision, seed=7).find(start, [goal], 5.0) for _ in range(2)
    )
    assert first.waypoints.tobytes() == second.waypoints.tobytes()


def test_a_detour_is_not_much_longer_than_the_line(model, collision):
    start, goal = OVER_THE_TABLE
    for seed in range(5):
        found = PathFinder(model, collision, seed=seed).find(start, [goal], 5.0)
        length = np.linalg.norm(np.diff(found.waypoints, axis=0), axis=1).sum()
        assert length < 2.0 * np.linalg.norm(goal - start)


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


def test_the_tree_of_all_goals_says_which_one_it_reached(model):
    def is_wall(q):  # two rooms, joined only where the lift is high
        return abs(q[0]) < 0.2 and q[1] < 1.0

    goals = [np.array([0.8, -0.5, 0.0, 0.0, 0.0]), np.array([0.8, 0.5, 0.0, 0.0, 0.0])]
    finder = PathFinder(model, Wall(is_wall), seed=3)
    found = finder.find(np.array([-0.8, 0.0, 0.0, 0.0, 0.0]), goals, 5.0)
    assert np.array_equal(found.waypoints[-1], goals[found.goal])


def test_a_blocked_path_is_named(model):
    finder = PathFinder(model, Wall(lambda q: abs(q[0]) < 0.2))
    says = r"no path found in 0\.3 s .* the path between them is blocked, mostly by 'brick'"
    with pytest.raises(NoPath, match=says) as caught:
        finder.find(np.full(5, -0.8), [np.full(5, 0.8)], 0.3)
    assert caught.value.where == "path"
    assert caught.value.blockers == ("brick",)


def test_why_a_brief_search_fails_is_not_looked_into(model):
    looks = 0

    def is_wall(q):
        nonlocal looks
        looks += 1
        return abs(q[0]) < 0.2

    finder = PathFinder(model, Wall(is_wall))
    with pytest.raises(NoPath, match=r"no path found in 0\.000 s; allow more time"):
        finder.find(np.full(5, -0.8), [np.full(5, 0.8)], -1.0)
    assert looks < 100


def test_a_goal_that_is_shut_in_is_named(model):
    goal = np.full(5, 0.5)
    finder = PathFinder(model, Wall(lambda q: 0.1 < np.abs(q - goal).max() < 0.2))
    with pytest.raises(NoPath, match="the goal is free but shut in, mostly by 'brick': ") as caught:
        finder.find(np.full(5, -0.8), [goal], 0.3)
    assert caught.value.where == "goal"


def test_a_start_that_is_shut_in_is_named(model):
    start = np.full(5, 0.5)
    finder = PathFinder(model, Wall(lambda q: 0.1 < np.abs(q - start).max() < 0.2))
    with pytest.raises(
        NoPath, match="the start is free but shut in, mostly by 'brick': "
    ) as caught:
        finder.find(start, [np.full(5, -0.8)], 0.3)
    assert caught.value.where == "start"


def test_an_edge_that_does_not_stand_its_proof_is_replaced(model):
    """Looks are 25 mm of travel apart; a thin wall with a gap is only seen by the proof."""

    class ThinWall(Wall):
        def __init__(self):
            super().__init__(lambda q: abs(q[0]) < 0.01 and q[1] < 1.0)
            self.proven = False

        def sampled_check(self, q_jaw, *, spacing, extra=0.0):
            return SampledCheck(
                lambda configuration: False, self.reach, q_jaw=q_jaw, spacing=spacing
            )

        def first_blocked(self, points, q_jaw):
            for begin, end in pairwise(points):
                for u in np.linspace(0.0, 1.0, 200):
                    q = begin + u * (end - begin)
                    if self._is_wall(q):
                        return q
            return None

    wall = ThinWall()
    found = PathFinder(model, wall).find(np.full(5, -0.5), [np.full(5, 0.5)], 10.0)
    assert wall.first_blocked(found.waypoints, 0.0) is None
    assert found.waypoints[:, 1].max() > 0.9
