from itertools import pairwise

import numpy as np
import pytest

from so101_motion.planning.paths.rrt_connect import STEP, Deadline, Space, Tree, TreeSearch

SPACE = Space(
    lower=np.full(5, -1.5), upper=np.full(5, 1.5), weights=np.array([0.4, 0.3, 0.2, 0.1, 0.05])
)


class Rooms:
    """Blocked where ``is_wall`` says so; looks closely."""

    def __init__(self, is_wall):
        self.is_wall = is_wall

    def is_free(self, q):
        return not self.is_wall(q)

    def first_free(self, configurations):
        return next((k for k, q in enumerate(configurations) if self.is_free(q)), None)

    def is_clear(self, q_from, q_to):
        shares = np.linspace(0.0, 1.0, 30)[1:-1, None]
        return all(map(self.is_free, q_from + shares * (q_to - q_from)))


OPEN = Rooms(lambda q: False)
LEFT, RIGHT = np.array([-1.0, 0, 0, 0, 0]), np.array([1.0, 0, 0, 0, 0])
GATE = Rooms(lambda q: abs(q[0]) < 0.1 and q[1] < 0.8)


def search(checker, goals, seed=0):
    return TreeSearch(SPACE, checker, LEFT, goals, np.random.default_rng(seed))


@pytest.mark.parametrize("seed", range(10))
def test_the_path_found_is_free_and_leads_from_the_start_to_a_goal(seed):
    goals = [RIGHT, RIGHT + np.array([0.0, -0.5, 0.3, 0.0, 0.0])]
    points, index = search(GATE, goals, seed).run(Deadline(10.0))
    assert np.array_equal(points[0], LEFT)
    assert np.array_equal(points[-1], goals[index])
    for a, b in pairwise(points):
        assert GATE.is_free(a)
        assert GATE.is_clear(a, b)
        assert np.linalg.norm((b - a) * SPACE.weights) <= STEP * (1.0 + 1e-9)
        assert np.all((SPACE.lower <= b) & (b <= SPACE.upper))


def test_the_same_seed_finds_the_same_path():
    first, second = (search(GATE, [RIGHT], seed=4).run(Deadline(10.0))[0] for _ in range(2))
    assert np.array_equal(first, second)
    other = search(GATE, [RIGHT], seed=5).run(Deadline(10.0))[0]
    assert len(other) != len(first) or not np.array_equal(first, other)


def test_it_ends_when_time_or_tries_run_out():
    closed = Rooms(lambda q: abs(q[0]) < 0.1)
    assert search(closed, [RIGHT]).run(Deadline(0.05)) is None
    assert search(closed, [RIGHT]).run(Deadline(60.0), 5) is None


def test_the_tree_that_is_behind_grows_first():
    boxed = Rooms(lambda q: 0.05 < np.abs(q - RIGHT).max() < 0.1)
    tried = search(boxed, [RIGHT])
    assert tried.run(Deadline(60.0), 60) is None
    assert tried.from_start.grown <= tried.from_goals.grown + 1


def test_a_tree_knows_its_nearest_node_and_the_path_back():
    rng = np.random.default_rng(0)
    tree = Tree([LEFT, RIGHT], SPACE, rng)
    for _ in range(400):
        tree.grow(OPEN)
    assert tree.grown > 300
    nodes = tree.points[: tree.count]
    for q in rng.uniform(-1.5, 1.5, (50, 5)):
        index, distance = tree.nearest(q)
        away = np.linalg.norm((nodes - q) * SPACE.weights, axis=1)
        assert distance == pytest.approx(away.min())
        assert away[index] == pytest.approx(away.min())
    last = tree.count - 1
    branch = tree.branch(last)
    assert np.array_equal(branch[0], tree.points[last])
    assert np.array_equal(branch[-1], tree.points[tree.root(last)])
    assert tree.root(last) in (0, 1)


def test_following_stops_where_the_path_is_blocked():
    tree = Tree([LEFT], SPACE, np.random.default_rng(0))
    wall = Rooms(lambda q: q[0] > 0.3)
    assert tree.follow(wall, RIGHT) is None
    assert tree.points[: tree.count, 0].max() < 0.3
    met = tree.follow(OPEN, RIGHT)
    assert met is not None
    assert OPEN.is_clear(tree.points[met], RIGHT)


def test_probing_tells_what_was_met_and_grows_meanwhile():
    tree = Tree([LEFT], SPACE, np.random.default_rng(0))
    wall = Rooms(lambda q: q[0] > -0.9)
    met = [q for _ in range(20) for q in tree.probe(wall)]
    assert met
    assert all(max(begin[0], end[0]) > -0.9 for begin, end in met)
    assert tree.grown > 0


def test_how_far_a_tree_has_spread_is_a_share_of_the_range():
    tree = Tree([LEFT], SPACE, np.random.default_rng(0))
    assert tree.spread() == 0.0
    tree.follow(OPEN, RIGHT)
    assert 0.3 < tree.spread() <= 0.67


def test_the_space_around_an_edge_stays_inside_the_limits():
    near = SPACE.around(np.full(5, -1.4), np.full(5, 0.2), 0.3)
    assert near.lower == pytest.approx(np.full(5, -1.5))
    assert near.upper == pytest.approx(np.full(5, 0.5))
