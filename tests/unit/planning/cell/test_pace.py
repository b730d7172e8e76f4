"""How fast several arms may move along a common path."""

import numpy as np
import pytest

from so101_motion.common.geometry import SE3, rot_z
from so101_motion.planning.cell.team_requests import TeamMember
from so101_motion.planning.cell.together import FAR, SHARE, pace_on
from so101_motion.planning.collision.apart import EARLY, ROOM, distances
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.path_geometry import blended_path

T_FACING = SE3(rot_z(np.pi), np.array([0.35, 0.0, 0.0]))
CAPS = MotionLimits.uniform(velocity=1.5, acceleration=6.0, jerk=60.0)
ASIDE = np.array([0.9, 0.0, 0.0, 0.0, 0.0])


def arms(T=T_FACING):
    request = PlanRequest(q_start=ASIDE, goal=JointGoal(q=ASIDE), limits=CAPS)
    return [TeamMember(name="", T_cell_base=each, request=request) for each in (SE3.identity(), T)]


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
    q_both = np.append(nearer, 0.0)[None]
    gap = distances(bodies, bodies, T_FACING, q_both, q_both, need=ROOM, enough=FAR)[0]
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
