"""A cell of emulated arms: they set out together."""

import numpy as np
import pytest
from harness.emulated_pair import Arm

from so101_motion.arm.cell import Cell
from so101_motion.common.clock import ManualClock
from so101_motion.common.geometry import SE3
from so101_motion.planning.goals import JointGoal

T_FAR = SE3.from_rpy((0.0, 0.0, np.pi), (0.9, 0.0, 0.0))

PHASE = 0.004
"""By how much the control cycles of the arms are apart [s]."""


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def arms(tmp_path, clock):
    opened = []
    try:
        for name in ("left", "right"):
            opened.append(Arm(tmp_path, name, clock, 2.0))
            clock.advance(PHASE)
        clock.advance(1.0)  # their weight is taken up
        yield opened
    finally:
        for arm in opened:
            arm.close()


def test_a_common_motion_begins_within_five_milliseconds(arms, clock):
    cell = Cell()
    for name, arm, T in zip(("left", "right"), arms, (SE3.identity(), T_FAR), strict=True):
        cell.add(name, arm.rig, T)
    begun = {}
    endings = []
    for k, arm in enumerate(arms):
        q = arm.rig.arm.state.q_ref

        def note(state, k=k, q=q):
            if not np.array_equal(state.q_ref, q):
                begun.setdefault(k, state.t)

        endings.append(arm.rig.executor.listen(note))
    goals = {name: JointGoal(q=np.full(5, 0.05)) for name in ("left", "right")}
    motions = cell.start_together(goals).values()
    while not all(each.future.done() for each in motions):
        if sum(each.plan is not None for each in motions) != 1:  # else the other is about to begin
            clock.advance(0.002)
    for end in endings:
        end()
    for motion in motions:
        motion.result()
    assert abs(begun[0] - begun[1]) < 0.005
