"""The nearest reachable point against descents from many starts and against dense sampling."""

import numpy as np
import pytest

from so101_motion.common.errors import Unreachable
from so101_motion.planning.goals import PoseGoal
from so101_motion.planning.kinematics.ik_task import check_goal, minimise

HOME = np.zeros(5)


def points_out_of_reach(solver, frame, n, seed):
    """Points all around: far outside, close to the base, behind the pan's limits."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < n:
        spread = ([0.6, 0.6, 0.7], [0.12, 0.12, 0.3])[len(found) % 2]
        p_base = rng.uniform(-np.array(spread), spread)
        try:
            solver.solve(PoseGoal.at_point(p_base, frame=frame), HOME)
        except Unreachable as error:
            found.append((p_base, error))
    return found


@pytest.mark.parametrize("frame", ["tool", "jaw_tip"])
def test_no_descent_from_anywhere_comes_nearer(model, solver, frame):
    starts = np.random.default_rng(1).uniform(model.lower, model.upper, (12, 5))
    for p_base, error in points_out_of_reach(solver, frame, 12, seed=2):
        task = check_goal(model, PoseGoal.at_point(p_base, frame=frame))
        for q in starts:
            q = minimise(model, task, q)
            away = np.linalg.norm(model.frame(q, frame).p - p_base)
            assert error.error_position <= away + 1e-6


@pytest.mark.parametrize("frame", ["tool", "jaw_tip"])
def test_the_point_named_is_reachable_as_far_off_as_said_and_none_is_nearer(model, solver, frame):
    sample = np.random.default_rng(3).uniform(model.lower, model.upper, (20_000, 5))
    within_reach = np.array([model.rotation_and_position(q, frame)[1].copy() for q in sample])
    for p_base, error in points_out_of_reach(solver, frame, 60, seed=5):
        reached = model.frame(error.q_nearest, frame).p
        np.testing.assert_allclose(error.p_base_nearest, reached, atol=1e-12)
        assert np.linalg.norm(reached - p_base) == pytest.approx(error.error_position, abs=1e-12)
        assert error.error_position <= np.linalg.norm(within_reach - p_base, axis=1).min() + 1e-9
        assert model.outside(error.q_nearest, tolerance=0.0) is None
        assert error.limit
        goal = PoseGoal.at_point(error.p_base_nearest, frame=frame)
        assert solver.solve(goal, HOME).error_position < 1e-4


@pytest.mark.parametrize(
    ("p_base", "limit", "off_mm"),
    [
        ((0.6, 0.0, 0.2), "full stretch", 225.2),
        ((0.3, 0.1, -0.3), "shoulder_lift at its upper limit", 200.2),
        ((0.1, 0.3, 0.9), "full stretch", None),
        ((-0.2, 0.2, 0.1), "shoulder_lift at its lower limit", 31.4),
    ],
)
def test_the_binding_limit_is_named(solver, p_base, limit, off_mm):
    said = limit.replace("full stretch", "fully stretched")
    with pytest.raises(Unreachable, match=said) as caught:
        solver.solve(PoseGoal.at_point(p_base), HOME)
    assert caught.value.limit == limit
    if off_mm is not None:
        assert caught.value.error_position * 1000.0 == pytest.approx(off_mm, abs=0.1)


def test_the_pan_is_named_where_it_cannot_turn_far_enough(model, solver):
    q = np.array([model.upper[0], 0.8, -0.3, 0.1, 0.0])
    T = model.frame(q)
    sideways = np.cross(T.R[:, 2], [0.0, 0.0, 1.0])
    sideways *= 0.02 / np.linalg.norm(sideways)
    with pytest.raises(Unreachable) as caught:
        solver.solve(PoseGoal.at_point(T.p + sideways), HOME)
    assert caught.value.limit == "shoulder_pan at its upper limit"
    assert caught.value.error_position == pytest.approx(0.02, abs=1e-6)


def test_on_the_pan_axis_the_tool_passes_by_a_fifth_of_a_millimetre(solver):
    x, y = solver.structure.measures.pan
    with pytest.raises(Unreachable, match="the pan axis") as caught:
        solver.solve(PoseGoal.at_point((x, y, 0.3)), HOME)
    assert caught.value.error_position == pytest.approx(0.000178, abs=1e-6)
    # Within a tolerance of half a millimetre that is arrival.
    goal = PoseGoal.at_point((x, y, 0.3))
    wide = PoseGoal(T_base_tool=goal.T_base_tool, position_tolerance=5e-4)
    assert solver.solve(wide, HOME).error_position == pytest.approx(0.000178, abs=1e-6)
