"""The step nearest to a wanted one that keeps its bounds."""

import numpy as np
import pytest
from scipy.optimize import minimize

from so101_motion.planning.differential import nearest_within as module
from so101_motion.planning.differential.nearest_within import MOST, Bounds, nearest_within
from so101_motion.planning.native.library import Native


def drawn(random, n=6):
    """A step and bounds that it may break; a step that keeps them is drawn first."""
    G, kept = random.normal(size=(n, 5)), 0.3 * random.normal(size=5)
    return random.normal(size=5), Bounds(
        G, G @ kept - random.uniform(0.0, 0.2, n), random.random(n)
    )


@pytest.fixture(params=["compiled", "plain"])
def library(request, monkeypatch):
    if request.param == "plain":
        monkeypatch.setattr(module, "native", lambda: Native(None, 0, "switched off"))


def test_it_is_the_nearest_of_all_that_keep_the_bounds(library):
    random, held = np.random.default_rng(1), []
    for _ in range(60):
        step, bounds = drawn(random)
        x, active = nearest_within(step, [bounds])
        if x is None:  # the search may end without one
            continue
        assert (bounds.G @ x >= bounds.least - 1e-8).all()
        best = minimize(
            lambda y, step=step: np.sum((y - step) ** 2),
            np.zeros(5),
            jac=lambda y, step=step: 2.0 * (y - step),
            constraints={"type": "ineq", "fun": lambda y, b=bounds: b.G @ y - b.least},
            method="SLSQP",
            options={"ftol": 1e-12},
        )
        assert np.linalg.norm(x - step) <= np.linalg.norm(best.x - step) + 1e-5
        assert bounds.G[list(active)] @ x == pytest.approx(bounds.least[list(active)], abs=1e-8)
        held.append(len(active))
    assert len(held) > 50
    assert max(held) > 1


def test_a_step_that_nothing_stands_against_is_itself(library):
    step = np.full(5, 0.1)
    none = Bounds(np.zeros((0, 5)), np.zeros(0), np.zeros(0))
    assert nearest_within(step, [none])[0] == pytest.approx(step)
    x, active = nearest_within(step, [none, Bounds(np.eye(5), np.zeros(5), np.zeros(5))])
    assert x is step or x == pytest.approx(step)
    assert list(active) == []


def test_bounds_that_no_step_keeps_have_none(library):
    against = Bounds(np.array([[1.0] + 4 * [0.0], [-1.0] + 4 * [0.0]]), np.ones(2), np.zeros(2))
    assert nearest_within(np.zeros(5), [against])[0] is None


def test_the_bounds_with_the_least_room_count_and_are_told_by_number(library):
    wide = Bounds(np.tile(-np.eye(5)[0], (MOST, 1)), np.full(MOST, -5.0), np.full(MOST, 1.0))
    tight = Bounds(np.array([-np.eye(5)[1]]), np.array([-0.5]), np.array([0.0]))
    x, active = nearest_within(np.ones(5), [wide, tight])
    assert x == pytest.approx([1.0, 0.5, 1.0, 1.0, 1.0])
    assert list(active) == [MOST]


def test_plain_and_compiled_find_the_same(monkeypatch):
    random = np.random.default_rng(2)
    asked = [drawn(random, n) for n in (1, 2, 3, 5, 8, 12, 20) for _ in range(30)]
    compiled = [nearest_within(step, [bounds]) for step, bounds in asked]
    monkeypatch.setattr(module, "native", lambda: Native(None, 0, "switched off"))
    for (step, bounds), (x, active) in zip(asked, compiled, strict=True):
        plain, same = nearest_within(step, [bounds])
        assert (plain is None) == (x is None)
        assert list(active) == list(same)
        if x is not None:
            assert x == pytest.approx(plain, abs=1e-9)
