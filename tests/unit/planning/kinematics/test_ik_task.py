import numpy as np
import pytest

from so101_motion.planning.goals import GoalMetric, PoseGoal
from so101_motion.planning.kinematics.ik_task import check_goal, half_square, minimise


def configurations(model, n, seed=0):
    return np.random.default_rng(seed).uniform(model.lower, model.upper, (n, 5))


def task_at(model, q, metric, frame="jaw_tip"):
    return check_goal(
        model, PoseGoal(T_base_tool=model.frame(q, frame), metric=metric, frame=frame)
    )


@pytest.mark.parametrize("metric", GoalMetric)
def test_the_gradient_is_that_of_the_value(model, metric):
    h = 1e-6 * np.eye(5)
    for q, q_goal in configurations(model, 40).reshape(20, 2, 5):
        task = task_at(model, q_goal, metric)
        gradient = half_square(model, task, q)[1]
        differences = [
            (half_square(model, task, q + e)[0] - half_square(model, task, q - e)[0]) / 2e-6
            for e in h
        ]
        np.testing.assert_allclose(gradient, differences, atol=1e-8)


def test_the_curvature_of_the_position_is_that_of_its_gradient(model):
    h = 1e-6 * np.eye(5)
    for q, q_goal in configurations(model, 40).reshape(20, 2, 5):
        task = task_at(model, q_goal, GoalMetric.POSITION_ONLY)
        differences = [
            (half_square(model, task, q + e)[1] - half_square(model, task, q - e)[1]) / 2e-6
            for e in h
        ]
        np.testing.assert_allclose(half_square(model, task, q)[2], differences, atol=1e-8)


@pytest.mark.parametrize("metric", GoalMetric)
def test_a_descent_never_goes_uphill_nor_outside(model, metric):
    for q, q_goal in configurations(model, 40, seed=1).reshape(20, 2, 5):
        task = task_at(model, q_goal, metric)
        end = minimise(model, task, 2.0 * q)
        assert model.outside(end, tolerance=0.0) is None
        begin = np.clip(2.0 * q, model.lower, model.upper)
        assert half_square(model, task, end)[0] <= half_square(model, task, begin)[0]
