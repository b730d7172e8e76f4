"""What a machine has around its arm, in plans that are made on another computer."""

from contextlib import suppress

import numpy as np
import pytest
from harness.fake_machine import a_box, hanging
from harness.viam_machine import SIM, until_true

from so101_motion.common.errors import InCollision, MachineRefused
from so101_motion.common.geometry import SE3
from so101_motion.planning.goals import JointGoal, PoseGoal
from so101_motion.viam.client import MachineRig

ARM = hanging("arm", joints=5)
OTHER = hanging("other", joints=5, y=-300.0)
CRATE = hanging("crate", x=300.0, z=40.0, geometry=a_box(100, 100, 80))
HELD = hanging("stick", "arm", z=150.0, geometry=a_box(10, 10, 60))
INSIDE = PoseGoal(T_base_tool=SE3.from_translation((0.3, 0.0, 0.06)))


@pytest.fixture
def crowded(machine):
    """With a second arm, and frames that tests set."""
    machine.add(*SIM[0][:2], "other")
    yield machine
    machine.remove(SIM[0][0], "other")
    machine.has_nothing_around()


def test_plans_go_around_it_as_it_is_now_and_not_at_all_if_it_is_not_known(crowded):
    machine = crowded
    machine.has_around(ARM, CRATE, HELD)
    with MachineRig.connect(machine.address, arm="arm") as rig:
        with pytest.raises(InCollision, match="crate"):
            rig.arm.plan(INSIDE)
        request = rig.arm.request(JointGoal(q=np.zeros(5)))
        assert [each.name for each in request.scene.attached] == ["stick"]
        assert rig.arm.scene.obstacles == ()

        machine.has_around(ARM)

        def is_planned():
            with suppress(InCollision):
                return rig.arm.plan(INSIDE)

        until_true(is_planned)  # once it is read
    machine.has_around(ARM, OTHER)
    with MachineRig.connect(machine.address, arm="arm") as rig:
        plans_keep_off_the_other_arms(rig)
    machine.has_around(ARM, hanging("gone"))
    with MachineRig.connect(machine.address, arm="arm") as rig:
        with pytest.raises(MachineRefused, match='"gone" has a frame but does not run'):
            rig.arm.plan(INSIDE)
        rig.arm.stop()


def plans_keep_off_the_other_arms(rig):
    [other] = rig.arm.request(JointGoal(q=np.zeros(5))).scene.arms
    assert other.name == "other"
    assert other.T_base_arm.p == pytest.approx([0.0, -0.3, 0.0])
    with pytest.raises(InCollision, match="other's"):
        rig.arm.plan(JointGoal(q=np.radians([57.0, 0.0, 0.0, 0.0, 0.0])))
    plan = rig.arm.plan(JointGoal(q=np.radians([-40.0, -40.0, 40.0, 0.0, 0.0])))
    assert plan.trajectory.duration > 0.3
