"""Joints outside their limits: which they are, where a motion takes them, and what is refused."""

import numpy as np
import pytest

from so101_motion.common.errors import MotionError
from so101_motion.common.state import ARM_JOINTS, JointReading
from so101_motion.control.limit_recovery import LimitRecovery, remarks

INSIDE = np.radians([0.0, 0.0, 40.0, 0.0, -80.0])


def outside(elbow_deg, roll_deg=0.0):
    """The arm with its elbow and roll so far beyond the nearest angle inside."""
    found, q = LimitRecovery(ARM_JOINTS), INSIDE + np.radians([0.0, 0.0, elbow_deg, 0.0, -roll_deg])
    out = {"elbow_flex": INSIDE[2]} | ({"wrist_roll": INSIDE[4]} if roll_deg else {})
    found.update(q, out)
    return found, q, out


def test_joints_outside_are_taken_in_by_the_next_motion_and_left_alone_by_all_else():
    found, q, _ = outside(3.0, 5.0)
    assert found
    assert found.mask.tolist() == [False, False, True, False, True]
    assert found.farthest() == ("wrist_roll", pytest.approx(np.radians(5.0)))
    wanted = np.full(5, 0.1)
    assert found.inside(wanted) == pytest.approx([0.1, 0.1, INSIDE[2], 0.1, INSIDE[4]])
    assert found.left_alone(wanted) == pytest.approx([0.1, 0.1, q[2], 0.1, q[4]])
    with pytest.raises(MotionError, match="wrist_roll is outside its calibrated range"):
        found.refuse()
    found.update(INSIDE, {})
    assert not found.is_needed
    assert found.inside(wanted) == pytest.approx(wanted)
    found.refuse()
    found.refuse_far()


@pytest.mark.parametrize(("off_deg", "comes_in"), [(9.9, True), (10.2, False)])
def test_a_joint_more_than_ten_degrees_outside_is_not_brought_in_unseen(off_deg, comes_in):
    found, q, out = outside(off_deg)
    zeros = np.zeros(5)
    reading = JointReading(q=q, q_jaw=0.0, qd=zeros, qd_jaw=0.0, out_of_range=out)
    (remark,) = remarks(reading)
    assert f"elbow_flex is {off_deg:.1f} deg outside" in remark
    assert ("the next move brings it in, slowly" in remark) == comes_in
    if comes_in:
        found.refuse_far()
        return
    with pytest.raises(MotionError, match=r"elbow_flex is 10 deg outside .* by hand, or calibrate"):
        found.refuse_far()
