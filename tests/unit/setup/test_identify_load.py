"""What plans do with a load that was weighed in the hand."""

from dataclasses import replace

import pytest

from so101_motion.calib.procedure.servo_fit import Load
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Attached, Box
from so101_motion.planning.goals import JointGoal
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.setup.identify import count_with

REACHING = JointGoal(q=[0.0, 1.2, -0.6, 0.3, 0.0])
HEAVY = Load(mass=0.3, com=(0.0, 0.0, -0.05), mass_deviation=0.004)


@pytest.fixture
def arm(clock):
    with open_simulated(clock=clock) as rig:
        yield rig.arm


def test_plans_count_with_a_load_that_was_weighed(arm):
    free = arm.request(REACHING)
    count_with(arm, HEAVY)
    assert free.payload is None
    assert arm.request(REACHING).payload.mass == pytest.approx(0.3)


def test_a_load_too_light_to_be_sure_of_does_not_count(arm):
    count_with(arm, replace(HEAVY, mass=0.01))
    assert arm.request(REACHING).payload is None


def test_what_the_scene_says_of_the_hand_is_not_counted_twice(arm):
    held = Attached(
        name="cup", shape=Box(size=(0.05, 0.05, 0.05)), T_tool_object=SE3.identity(), mass=0.3
    )
    arm.scene = replace(arm.scene, attached=(held,))
    count_with(arm, HEAVY)
    assert arm.request(REACHING).payload is None
