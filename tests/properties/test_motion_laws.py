"""Laws of what the executor sends, whatever is asked of it and whenever."""

import numpy as np
from harness.setpoints import TapedArm, shares
from hypothesis import given, settings
from hypothesis import strategies as st

from so101_motion.common.clock import ManualClock
from so101_motion.common.modes import Mode
from so101_motion.control.executor import Executor
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits

DT = 0.01
LIMITS = MotionLimits.uniform(velocity=1.5, acceleration=5.0, jerk=50.0)
STOP_LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=8.0, jerk=200.0)

angles = st.floats(-1.5, 1.5).map(lambda angle: round(angle, 3))
goals = st.lists(angles, min_size=5, max_size=5).map(np.array)


@settings(max_examples=20)
@given(goal=goals, when=st.floats(0.0, 2.5))
def test_a_stop_at_any_instant_is_smooth_and_ends_at_rest_on_the_path(goal, when):
    clock = ManualClock()
    arm = TapedArm(clock)
    with Executor(arm, clock, dt=DT, stop_limits=STOP_LIMITS) as executor:
        executor.execute(online.point_to_point(np.zeros(5), goal, LIMITS, DT))
        clock.advance(when)
        stopped = executor.stop()
        clock.advance(2.0)
        assert stopped.result(timeout=0) is None
        assert executor.state.mode is Mode.HOLDING
        assert max(shares(arm.goals, DT, STOP_LIMITS)) <= 1.02
        for q in arm.goals:
            share = q @ goal / max(goal @ goal, 1e-12)
            np.testing.assert_allclose(q, share * goal, atol=1e-6)
