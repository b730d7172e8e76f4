"""The step nearest to a wanted one that keeps its bounds."""

import numpy as np
import pytest
from scipy.optimize import minimize

from so101_motion.planning.differential.guard import MOST, BoundedStep

nearest = BoundedStep().nearest


def drawn(random, n=6):
    """A step and bounds that it may break; a step that keeps them is drawn first."""
    G, kept = random.normal(size=(n, 5)), 0.3 * random.normal(size=5)
    least = G @ kept - random.uniform(0.0, 0.2, n)
    return random.normal(size=5), np.column_stack([G, least, random.random(n)])


def test_it_is_the_nearest_of_all_that_keep_the_bounds():
    random, held = np.random.default_rng(1), []
    for _ in range(60):
        step, bounds = drawn(random)
        x, active = nearest(step, [bounds])
        G, least = bounds[:, :5], bounds[:, 5]
        if x is None:  # the search may end without one
            continue
        assert (G @ x >= least - 1e-8).all()
        best = minimize(
            lambda y, step=step: np.sum((y - step) ** 2),
            np.zeros(5),
            jac=lambda y, step=step: 2.0 * (y - step),
            constraints={"type": "ineq", "fun": lambda y, G=G, b=least: G @ y - b},
            method="SLSQP",
            options={"ftol": 1e-12},
        )
        assert np.linalg.norm(x - step) <= np.linalg.norm(best.x - step) + 1e-5
        assert G[list(active)] @ x == pytest.approx(least[list(active)], abs=1e-8)
        held.append(len(active))
    assert len(held) > 50
    assert max(held) > 1


def test_a_step_that_nothing_stands_against_is_itself():
    step = np.full(5, 0.1)
    none = np.zeros((0, 7))
    assert nearest(step, [none])[0] == pytest.approx(step)
    x, active = nearest(step, [none, np.eye(5, 7)])
    assert x is step or x == pytest.approx(step)
    assert list(active) == []


def test_bounds_that_no_step_keeps_have_none():
    against = np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]])
    assert nearest(np.zeros(5), [against])[0] is None


@pytest.mark.parametrize("many", [MOST, 100])
def test_the_bounds_with_the_least_room_count_and_are_reported_by_number(many):
    wide = np.tile([-1.0, 0.0, 0.0, 0.0, 0.0, -5.0, 1.0], (many, 1))
    tight = np.array([[0.0, -1.0, 0.0, 0.0, 0.0, -0.5, 0.0]])
    x, active = nearest(np.ones(5), [wide, tight])
    assert x == pytest.approx([1.0, 0.5, 1.0, 1.0, 1.0])
    assert list(active) == [many]
