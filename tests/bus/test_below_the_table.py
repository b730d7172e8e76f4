"""An arm that hangs below its table comes back by itself when asked. The emulator has none."""

import numpy as np
import pytest

from so101_motion.common.errors import InCollision
from so101_motion.planning.goals import LeaveContactGoal
from so101_motion.planning.motion_builder import DEPARTURE_SPEED

# The gripper is far below the table.
pytestmark = pytest.mark.emulated(q_start=(0.0, 1.2, 0.0, 1.2, 0.0, 0.0))


def test_an_arm_leaves_its_table_by_itself_when_asked_to(bench):
    rig = bench.open()
    bench.advance(1.0)
    with pytest.raises(InCollision, match=r"into the floor.*back out slowly, guide it by hand"):
        bench.finish(bench.go(rig, 0, 0, 0, 0, 0))
    q_start = rig.arm.state.q
    motion = rig.arm.move(LeaveContactGoal(), wait=False)
    bench.under_way(motion, rig)
    bench.advance(0.5)
    assert np.abs(rig.arm.state.qd).max() < 1.2 * DEPARTURE_SPEED
    bench.finish(motion, at_most=30.0)
    assert np.abs(rig.arm.state.q - q_start).max() > 0.5
    bench.finish(bench.go(rig, 20, 0, 0, 0, 0))
