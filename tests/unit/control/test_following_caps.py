"""Targets that come and go again and again: a following keeps its speed caps."""

import numpy as np
import pytest

from so101_motion.control.following import Following
from so101_motion.planning.timing.limits import MotionLimits


@pytest.mark.parametrize("jerk", [150.0, 1000.0])
def test_joints_that_are_told_to_brake_while_they_speed_up_keep_their_speed_cap(jerk):
    """A stop takes an acceleration back more slowly than it was built up."""
    rng = np.random.default_rng(1)
    caps = MotionLimits.uniform(velocity=1.0, acceleration=6.0, jerk=jerk)
    stop = MotionLimits.uniform(velocity=3.0, acceleration=6.0, jerk=60.0)
    following = Following(
        q_start=np.zeros(5), lower=np.full(5, -3.0), upper=np.full(5, 3.0), limits=caps,
        stop_limits=stop, dt=0.01, stale_after=None,
    )  # fmt: skip
    q = [following.now.q]
    for k in range(2000):
        if k % 40 == 0:
            following.aim(rng.uniform(-2.0, 2.0, 5))
        if rng.random() < 0.04:
            following.hold()
        elif following.target is None:
            following.aim(rng.uniform(-2.0, 2.0, 5))
        q.append(following.sample(k).q)
    speeds = np.abs(np.diff(q, axis=0)) / 0.01
    assert 0.95 < speeds.max() <= 1.0 + 1e-6
