from __future__ import annotations

import pytest

from so101_motion.common.named_poses import POSES, NamedPose
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.kinematics.model import RobotModel


@pytest.mark.parametrize("pose", POSES, ids=lambda pose: pose.name)
def test_a_named_pose_lies_within_the_limits_and_touches_nothing(pose: NamedPose) -> None:
    model = RobotModel.load()
    model.check_limits(pose.q)
    contact = CollisionModel(model).first_contact(pose.q)
    assert contact is None


def test_the_names_differ() -> None:
    assert len({pose.name for pose in POSES}) == len(POSES)
