"""How far a jogged arm may move near the table."""

import numpy as np
import pytest
from scipy.optimize import minimize

from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.differential.guard import (
    AHEAD,
    FAST,
    GAP,
    INEXACT,
    MOST,
    BoundedStep,
    Guard,
    room_of,
)
from so101_motion.planning.kinematics.model import RobotModel

ACCELERATION = np.full(5, 10.5)
READY = np.radians([0.0, -45.0, 45.0, 60.0, 0.0])
LOW = np.radians([0.0, 34.0, -14.0, 36.5, 0.0])  # the jaw some millimetres above the table
DOWN = np.radians([0.0, 1.0, 0.0, 0.0, 0.0])


@pytest.fixture
def guard(collision):
    return Guard(collision, lambda: 0.3, acceleration=ACCELERATION)


def path(q, step, n=10):
    return q + np.linspace(0.0, 1.0, n)[:, None] * step


def test_far_from_everything_a_target_is_within_reach_and_so_is_the_path(guard):
    target = READY + np.radians(5.0)
    assert guard.within_reach(READY, target) is target
    assert guard.against == ()
    assert guard.admits(path(READY, target - READY))


def test_a_target_in_the_table_is_drawn_back_to_above_it_and_the_rest_is_kept(guard, collision):
    q = LOW - 3.0 * DOWN
    wanted = q + np.radians([20.0, 30.0, 0.0, 0.0, 10.0])
    drawn = guard.within_reach(q, wanted)
    assert guard.against == ("the gripper close to the floor",)
    assert drawn[0] == pytest.approx(wanted[0], abs=0.02), "it slides"
    assert drawn[4] == pytest.approx(wanted[4], abs=0.02)
    step = 0.02 * (drawn - q) / np.abs(drawn - q).max()
    assert collision.distances(q + step, 0.3).min() > collision.margin
    assert not guard.admits(path(q, wanted - q))


def test_a_hand_is_held_back_where_it_leads_the_jaw_into_the_table_and_only_there(guard, collision):
    lowest, q_guided = LOW, LOW + np.radians([2.0, 3.0, 0.0, -2.0, 1.0])
    lifts_jaw = collision.distances(LOW + np.radians([0, 0, 0, -2.0, 0]), 0.3).min()
    assert lifts_jaw > collision.distances(LOW, 0.3).min()
    for _ in range(50):  # as in as many control cycles
        lowest = guard.guided_to(lowest, q_guided)
        assert collision.distances(lowest, 0.3).min() > collision.margin
    free = [0, 3, 4]
    np.testing.assert_allclose(lowest[free], q_guided[free], atol=1e-12)
    assert LOW[1] < lowest[1] < q_guided[1]


@pytest.mark.parametrize("seed", range(20))
def test_a_hand_leads_no_joint_farther_than_it_goes_nor_back(guard, seed):
    rng = np.random.default_rng(seed)
    q = LOW + rng.normal(0.0, 0.05, 5)
    q_guided = q + rng.normal(0.0, 0.03, 5)
    share = (guard.guided_to(q, q_guided) - q) / (q_guided - q)
    assert np.all((share >= 0.0) & (share <= 1.0))


def test_a_short_step_may_go_nearer_than_a_long_one(guard, collision):
    q = LOW.copy()
    while collision.distances(q, 0.3).min() > collision.margin + 0.005:
        q += 0.1 * DOWN
    slow, fast = np.array([0.002, 0.0, 0.0, 0.0, 0.0]), np.array([0.3, 0.0, 0.0, 0.0, 0.0])
    guard.look(q)
    assert guard.admits(path(q, slow))
    assert fast @ collision.reach > FAST
    guard.look(q)
    assert not guard.admits(path(q, fast + 0.05 * DOWN))


def test_a_long_step_keeps_clearer_for_servos_that_are_driven_ahead_of_it(guard, collision):
    q, pan = LOW - 2.0 * DOWN, np.array([0.3, 0.0, 0.0, 0.0, 0.0])
    while collision.distances(q, 0.3).min() < collision.margin + INEXACT + 0.5 * AHEAD:
        q -= 0.1 * DOWN
    guard.look(q)
    assert guard.admits(path(q, pan + 0.05 * DOWN))
    assert not guard.admits(path(q, pan + 0.05 * DOWN), ahead=True)
    assert guard.admits(path(q, 0.01 * pan), ahead=True)


def test_bodies_that_are_too_close_may_part_but_come_no_closer(collision):
    wide = CollisionModel(RobotModel.load(), Scene(margin=0.02))
    guard = Guard(wide, lambda: 0.3, acceleration=ACCELERATION)
    q = LOW
    assert not wide.is_free(q, 0.3)
    assert room_of(guard.look(q)[0]) < GAP
    assert guard.admits(path(q, -1.0 * DOWN))
    guard.look(q)
    assert not guard.admits(path(q, 1.0 * DOWN))


def test_a_path_is_shown_often_enough_that_it_cannot_bend_by_more_than_is_allowed_for(
    guard, collision
):
    bend = float(ACCELERATION @ collision.reach) * guard.look_every**2 / 8.0
    assert bend <= 0.5 * guard.margin
    assert Guard(collision, lambda: 0.3).look_every == np.inf


def test_no_check_is_made_in_a_control_cycle():
    collision = CollisionModel(RobotModel.load())
    made = Guard(collision, lambda: 0.3, acceleration=ACCELERATION)
    before = collision._bent.cache_info().misses
    for share in np.linspace(0.0, 2.0, 120):  # from standing to as fast as is told apart
        for ahead in (False, True):
            made.look(READY)
            made.admits(path(READY, share * np.array([0.4, 0.3, 0.3, 0.2, 0.5])), ahead=ahead)
    assert collision._bent.cache_info().misses == before
    assert collision._bent.cache_info().currsize == before


# The step nearest to a wanted one that keeps its bounds


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
