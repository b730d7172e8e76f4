"""Attributes that a model does not know: ignored, unless they look misspelt."""

import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.viam.component_config import (
    HardwareArmConfig,
    HardwareGripperConfig,
    SimulatedArmConfig,
    SimulatedGripperConfig,
)
from so101_motion.viam.models.configured import without_ignored

URDF = next(row for row in HardwareArmConfig.rows() if row.name == "use_urdf")


@pytest.mark.parametrize(
    ("rows", "attributes", "ignored"),
    [
        (SimulatedArmConfig.rows(), {"port": "/dev/a", "calibration_file": "a.json"}, None),
        (SimulatedGripperConfig.rows(), {"arm": "my-arm", "port": "/dev/a", "servo_id": 6}, None),
        (
            HardwareArmConfig.rows(),
            {"servo_id": 6, "gripper_type": "leader"},
            None,
        ),  # near servo_ids, but known
        (HardwareGripperConfig.rows(), {"servo_ids": [1, 2, 3, 4, 5]}, None),
        (HardwareArmConfig.rows(), {"leader_arm": "one", "rate_hz": 20}, None),  # of teleoperation
        (
            HardwareArmConfig.rows(),
            {"_comment": "mine", "comment": 1, "//": "x", "_port": "/dev/b"},
            None,
        ),
        (HardwareArmConfig.rows(), {"something": 1, "x" * 5000: 2}, None),
        (
            HardwareArmConfig.rows(),
            {"manual_mode": {"p_gain": 8, "whatever": 1}},
            ("manual_mode.whatever",),
        ),
        (
            HardwareArmConfig.rows(),
            {"manual_mode": 5, "port": "/dev/a"},
            (),
        ),  # refused when it is read
    ],
)
def test_what_a_model_does_not_know_is_left_out_and_named(rows, attributes, ignored):
    values, names = without_ignored({**attributes, "use_urdf": True}, (*rows, URDF))

    assert names == (tuple(attributes) if ignored is None else ignored)
    assert values["use_urdf"] is True
    assert set(values) <= {"use_urdf", "manual_mode", "port"}


def test_a_key_of_manual_mode_that_is_not_known_is_left_out():
    values, _ = without_ignored(
        {"manual_mode": {"p_gain": 8, "whatever": 1}}, HardwareArmConfig.rows()
    )

    assert values == {"manual_mode": {"p_gain": 8}}


@pytest.mark.parametrize(
    ("rows", "attributes", "says"),
    [
        (HardwareArmConfig.rows(), {"prot": "/dev/a"}, 'did you mean "port"'),
        (HardwareArmConfig.rows(), {"speed": 20}, 'did you mean "speed_degs_per_sec"'),
        (
            HardwareArmConfig.rows(),
            {"max_speed_deg_per_sec": 20},
            'did you mean "max_speed_degs_per_sec"',
        ),
        (HardwareArmConfig.rows(), {"Port": "/dev/a"}, 'did you mean "port"'),
        (HardwareArmConfig.rows(), {"servo_gains": {}}, "did you mean"),
        (
            HardwareArmConfig.rows(),
            {"manual_mode": {"torque_limt": 5}},
            'did you mean "torque_limit"',
        ),
        (
            HardwareArmConfig.rows(),
            {f"unknown {i}": 1 for i in range(1000)},
            "unknown attribute; known: port",
        ),
    ],
)
def test_what_looks_misspelt_is_refused_with_the_nearest(rows, attributes, says):
    with pytest.raises(ConfigError, match=says):
        without_ignored(attributes, rows)


def test_what_is_known_is_left_alone():
    attributes = {"port": "/dev/a", "manual_mode": {"p_gain": 8}}
    values, names = without_ignored(attributes, HardwareArmConfig.rows())

    assert (values, names) == (attributes, ())
