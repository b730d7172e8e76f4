"""How fast several arms may be on a common path."""

import numpy as np
import pytest

from so101_motion.common.geometry import SE3, rot_z
from so101_motion.planning.cell.pace import FAR, LOOKS, SHARE, PacedArm, _gaps, pace_on
from so101_motion.planning.collision.apart import EARLY, ROOM, gaps
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.course import Course
from so101_motion.planning.timing.path_geometry import blended_path

T_FACING = SE3(rot_z(np.pi), np.array([0.35, 0.0, 0.0]))
ASIDE = np.array([0.9, 0.0, 0.0, 0.0, 0.0])


def arms(T=T_FACING):
    return [PacedArm(bodies_of(), each, 0.0) for each in (SE3.identity(), T)]


def test_compiled_gaps_are_those_of_coal_at_least_and_about():
    random = np.random.default_rng(3)
    q = [random.uniform(-0.8, 0.8, (LOOKS, 6)) for _ in range(2)]
    found = _gaps(bodies_of(), bodies_of(), T_FACING, *q)
    pair = [(bodies_of(), Course(t=0.0, dt=1.0, q=each)) for each in q]
    true = np.array([*gaps(*pair, T_FACING, np.arange(float(LOOKS)))])
    moved = np.isfinite(true)
    np.testing.assert_array_equal(np.isfinite(found), moved)
    found, true = found[moved], true[moved]
    assert np.any(true < 0.0)
    assert np.all(found <= np.maximum(true, 0.0) + 1e-5)
    near = (true > 0.0) & (true < FAR)
    assert np.all(found[near] > true[near] - 2e-4 - 0.12 * np.maximum(true[near] - ROOM, 0.0))


def test_arms_are_slow_where_they_are_near_and_free_where_they_are_not():
    nearer = np.array([0.45, -0.2, 0.2, 0.0, 0.0])
    path = blended_path(np.array([np.tile(ASIDE, 2), np.tile(nearer, 2)]), 0.01)
    pace = pace_on(path, arms())
    rate = np.ones((2, 10))
    q = path.evaluate(np.array([0.0, path.length])).q
    far, near = pace(q, rate)
    assert near > 2.0 * far
    assert pace(q, 2.0 * rate) == pytest.approx([2.0 * far, 2.0 * near])
    rate[:, 5:] = 0.0  # who rests is never early
    np.testing.assert_array_equal(pace(q, rate), 0.0)
    bodies = bodies_of()
    gap = _gaps(bodies, bodies, T_FACING, *(np.append(nearer, 0.0)[None],) * 2)[0]
    fast = bodies.levers[:, :5].sum(axis=1)
    wanted = np.minimum(fast[:, None], fast) * EARLY / (SHARE * (gap - ROOM))
    assert near == pytest.approx(wanted.max(), rel=0.02)


def test_a_path_on_which_arms_could_not_move_at_all_has_no_pace():
    ahead = np.zeros(5)
    path = blended_path(np.array([np.tile(ASIDE, 2), np.tile(ahead, 2)]), 0.01)
    assert pace_on(path, arms()) is None
    far = SE3(rot_z(np.pi), np.array([2.0, 0.0, 0.0]))
    pace = pace_on(path, arms(far))
    assert np.all(pace(path.evaluate([0.0]).q, np.ones((1, 10))) < 0.2)
