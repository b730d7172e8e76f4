from itertools import product

import numpy as np
import pytest

from so101_motion.planning.cartesian.ladder_graph import (
    JUMP,
    OF_MOTION,
    PAN_JUMP,
    SIDE_JUMP,
    LadderGraph,
    are_near,
)


def ladder(random, columns=5, rows=6, spread=0.12):
    q = [spread * random.standard_normal((rows, 5)) for _ in range(columns)]
    price = [random.random(rows) for _ in range(columns)]
    price[0][1:] = np.inf
    return LadderGraph(q, price, [np.ones(rows, dtype=bool)] * columns), q, price


def cost_of(q, price, rows):
    total = 0.0
    for i, row in enumerate(rows):
        total += price[i][row] / (len(q) - 1)
        if i:
            step = q[i][row] - q[i - 1][rows[i - 1]]
            if np.linalg.norm(step[1:]) > JUMP or abs(step[0]) > PAN_JUMP:
                return np.inf
            total += (len(q) - 1) * (step[1:4].sum() ** 2 + OF_MOTION * (step[1:] @ step[1:]))
    return total


@pytest.mark.parametrize("seed", range(8))
def test_the_best_sequence_is_the_cheapest_of_all(seed):
    made, q, price = ladder(np.random.default_rng(seed))
    every = product(*(range(len(column)) for column in q))
    cheapest = min(cost_of(q, price, rows) for rows in every)
    rows = made.best()
    assert cost_of(q, price, rows) == pytest.approx(cheapest)
    assert np.array_equal(made.sequence(rows), [c[row] for c, row in zip(q, rows, strict=True)])


def test_forbidden_steps_are_avoided():
    made, q, price = ladder(np.random.default_rng(1))
    first = made.best()
    made.forbid(2, first[2])
    second = made.best()
    assert second[2] != first[2]
    price[2][first[2]] = np.inf
    every = product(*(range(len(column)) for column in q))
    assert cost_of(q, price, second) == pytest.approx(
        min(cost_of(q, price, rows) for rows in every)
    )


def test_a_forbidden_step_leaves_its_postures():
    made, _, _ = ladder(np.random.default_rng(2))
    first = made.best()
    made.forbid_step(1, first[1], first[2])
    second = made.best()
    assert (second[1], second[2]) != (first[1], first[2])


def test_without_a_sequence_it_says_how_far_any_gets():
    made, _, _ = ladder(np.random.default_rng(3))
    for row in range(6):
        made.forbid(3, row)
    assert made.best() is None
    assert made.farthest() == 2
    assert len(made.best(2)) == 3
    useful = made.useful()
    assert len(useful) == 3
    assert list(useful[0]) == [0]


def test_a_column_without_postures_ends_it():
    q = [np.zeros((1, 5)), np.zeros((2, 5)), np.empty((0, 5)), np.zeros((1, 5))]
    in_front = [np.ones(len(column), dtype=bool) for column in q]
    made = LadderGraph(q, [np.zeros(len(column)) for column in q], in_front)
    assert made.best() is None
    assert made.farthest() == 1


def test_postures_far_apart_are_not_one_motion():
    here = np.zeros((1, 5))
    there = np.zeros((3, 5))
    there[1, 2] = 0.3
    there[2, 0] = 1.01
    assert are_near(here, there, 0.2, 1.0).tolist() == [[True, False, False]]


def test_front_becomes_back_only_where_both_are_one_posture():
    q = [np.zeros((1, 5)), np.zeros((2, 5))]
    q[1][:, 0] = SIDE_JUMP + 0.1, SIDE_JUMP - 0.1
    price = [np.zeros(1), np.array([0.0, 1.0])]
    in_front = [np.array([True]), np.array([False, False])]
    assert LadderGraph(q, price, in_front).best()[1] == 1
    assert LadderGraph(q, price, [np.array([False]), in_front[1]]).best()[1] == 0
