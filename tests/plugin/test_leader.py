"""The leader as a teleoperator of LeRobot: limp while it leads, driven to where a follower is."""

import numpy as np
import pytest
from harness.emulated_rig import MIDDLES_DEG
from harness.lerobot_bench import (
    READY,
    SO101MotionLeader,
    SO101MotionLeaderConfig,
    action,
)

START = (*np.radians(np.add(READY[:5], MIDDLES_DEG)), 0.5)
HINT = 0.1  # of full drive


@pytest.fixture
def leader(folded):
    leader = folded.robot(SO101MotionLeader, SO101MotionLeaderConfig)
    leader.connect(calibrate=False)
    folded.advance(0.3)
    return leader


def values(leader):
    return np.array([leader.get_action()[key] for key in leader.action_features])


def test_its_joints_are_limp_it_says_where_they_are_and_it_is_left_as_it_is(folded, leader):
    assert not any(servo.drive.torque for servo in folded.world.servos)
    true = folded.q_deg[1] - folded.arm_deg(folded.open())[1]
    assert leader.get_action()["shoulder_lift.pos"] == pytest.approx(folded.q_deg[1] - true, abs=1)
    assert leader.feedback_features == leader.action_features
    leader.enable_torque()
    leader.disconnect()
    assert folded.world.servo("shoulder_lift").drive.torque
    assert not leader.is_connected


def test_feedback_drives_it_while_its_torque_is_on_and_not_otherwise(folded, leader):
    here = values(leader)
    leader.send_feedback(action(*READY))
    folded.advance(0.5)
    assert np.abs(values(leader) - here).max() < 1.0
    leader.enable_torque()
    for share in np.linspace(0.0, 1.0, 60):
        leader.send_feedback(action(*(here + share * (READY - here))))
        folded.advance(1.0 / 30.0)
    folded.advance(0.5)
    assert np.abs(values(leader) - READY)[:5].max() < 1.0
    leader.disable_torque()
    assert not any(servo.drive.torque for servo in folded.world.servos)
