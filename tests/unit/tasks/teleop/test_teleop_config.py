import numpy as np
import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.common.state import ARM_JOINTS
from so101_motion.tasks.teleop.config import TeleopConfig

ARMS = {"leader_arm": "left", "follower_arm": "right"}


def config(**attributes):
    return TeleopConfig.from_attributes({**ARMS, **attributes})


def test_the_published_attributes_mean_what_they_meant():
    grippers = {"leader_gripper": "lg", "follower_gripper": "rg"}
    how = {"manage_leader_torque": False, "auto_start": True, "max_consecutive_errors": 10.0}
    found = config(**grippers, **how, rate_hz=20.0)
    assert found.dependencies == ("left", "right", "lg", "rg")
    assert found.grippers == ("lg", "rg")
    assert (found.rate, found.lets_go, found.auto_start) == (20.0, False, True)
    alone = config(follower_gripper="rg", leader_gripper="", rate_hz=0.0)  # is not mirrored
    assert (alone.rate, alone.guarded) == (100.0, True)
    assert np.degrees(alone.pace.approach.velocity) == pytest.approx(30.0)
    assert (alone.grippers, alone.dependencies) == (None, ("left", "right", "rg"))


def test_mirror_scale_and_offsets():
    found = config(mirror=True, scale=0.5, offsets_deg={"elbow_flex": 10.0})
    assert found.mirror.of(np.ones(5)) == pytest.approx(
        [-0.5, 0.5, 0.5 + np.radians(10.0), 0.5, -0.5]
    )
    found = config(scale=[1.0, 1.0, -1.0, 1.0, 2.0], offsets_deg=[0.0, 0.0, 0.0, 0.0, -20.0])
    assert found.mirror.of(np.ones(5)) == pytest.approx(
        [1.0, 1.0, -1.0, 1.0, 2.0 - np.radians(20.0)]
    )
    for i, joint in enumerate(ARM_JOINTS):
        assert config(offsets_deg={joint: 5.0}).mirror.offsets[i] == pytest.approx(np.radians(5.0))


def test_the_approach_is_never_faster_than_the_rest():
    pace = config(speed_degs_per_sec=10.0, acceleration_degs_per_sec_per_sec=50.0).pace
    assert np.all(pace.approach.velocity <= pace.full.velocity)
    assert np.all(pace.approach.acceleration <= pace.full.acceleration)
    assert np.all(pace.approach.jerk <= pace.full.jerk)


@pytest.mark.parametrize(
    ("attributes", "says"),
    [
        ({"leader_arm": ""}, "leader_arm"),
        ({"follower_arm": "left"}, "is the leader already"),
        ({"rate_hz": -1.0}, "rate_hz"),
        ({"rate_hz": 1001.0}, "rate_hz"),
        ({"max_consecutive_errors": -1.0}, "max_consecutive_errors"),
        ({"mirror": "yes"}, "true or false"),
        ({"scale": 0.0}, "scale"),
        ({"scale": 5.0}, "0.1 to 3"),
        ({"scale": [1.0, 1.0]}, "5 of them"),
        ({"offsets_deg": [1.0]}, "five angles"),
        ({"offsets_deg": {"elbow": 1.0}}, 'did you mean "elbow_flex"'),
        ({"offsets_deg": {"elbow_flex": 999.0}}, "-180 to 180"),
        ({"speed_degs_per_sec": 200.0}, "180"),
        ({"approach_speed_degs_per_sec": 0.5}, "1 to 90"),
        ({"collision_gard": True}, 'did you mean "collision_guard"'),
    ],
)
def test_invalid_input_is_refused_by_name(attributes, says):
    with pytest.raises(ConfigError, match=says):
        config(**attributes)
