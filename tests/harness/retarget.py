"""Send an executor's joints to a goal from whatever they are doing, without a collision check."""

import numpy as np

from so101_motion.control.following import Following
from so101_motion.control.joint_group import Channel


def retarget(executor, q_goal, limits, *, channel=Channel.ARM):
    """Turn to ``q_goal``, shape (n,), [rad]; the future of the motion."""
    n, state = len(limits.velocity), executor.state
    following = Following(
        q_start=state.q_ref if channel is Channel.ARM else [state.q_jaw_ref],
        lower=np.full(n, -np.inf),
        upper=np.full(n, np.inf),
        limits=limits,
        stop_limits=executor.stop_limits(channel),
        dt=executor.dt,
        stale_after=None,
        ends_there=True,
    )
    following.aim(q_goal)
    return executor.turn(following, channel=channel)
