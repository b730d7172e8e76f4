"""Attributes that a model does not know: ignored, unless they look misspelt."""

import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.viam import attribute_table as table
from so101_motion.viam.ignored_attributes import without_ignored

URDF = next(row for row in table.ARM if row.name == "use_urdf")


@pytest.mark.parametrize(
    ("rows", "attributes", "ignored"),
    [
        (table.SIMULATED_ARM, {"port": "/dev/a", "calibration_file": "a.json"}, None),
        (table.SIMULATED_GRIPPER, {"arm": "my-arm", "port": "/dev/a", "servo_id": 6}, None),
        (table.ARM, {"servo_id": 6, "gripper_type": "leader"}, None),  # near servo_ids, but known
        (table.GRIPPER, {"servo_ids": [1, 2, 3, 4, 5]}, None),
        (table.ARM, {"leader_arm": "one", "rate_hz": 20}, None),  # of teleoperation
        (table.ARM, {"_comment": "mine", "comment": 1, "//": "x", "_port": "/dev/b"}, None),
        (table.ARM, {"something": 1, "x" * 5000: 2}, None),
        (table.ARM, {"manual_mode": {"p_gain": 8, "whatever": 1}}, ("manual_mode.whatever",)),
        (table.ARM, {"manual_mode": 5, "port": "/dev/a"}, ()),  # refused when it is read
    ],
)
def test_what_a_model_does_not_know_is_left_out_and_named(rows, attributes, ignored):
    found = without_ignored({**attributes, "use_urdf": True}, (*rows, URDF))

    assert found.ignored == (tuple(attributes) if ignored is None else ignored)
    assert found.values["use_urdf"] is True
    assert set(found.values) <= {"use_urdf", "manual_mode", "port"}


def test_a_key_of_manual_mode_that_is_not_known_is_left_out():
    found = without_ignored({"manual_mode": {"p_gain": 8, "whatever": 1}}, table.ARM)

    assert found.values == {"manual_mode": {"p_gain": 8}}


@pytest.mark.parametrize(
    ("rows", "attributes", "says"),
    [
        (table.ARM, {"prot": "/dev/a"}, 'did you mean "port"'),
        (table.ARM, {"speed": 20}, 'did you mean "speed_degs_per_sec"'),
        (table.ARM, {"max_speed_deg_per_sec": 20}, 'did you mean "max_speed_degs_per_sec"'),
        (table.ARM, {"Port": "/dev/a"}, 'did you mean "port"'),
        (table.ARM, {"servo_gains": {}}, "did you mean"),
        (table.ARM, {"manual_mode": {"torque_limt": 5}}, 'did you mean "torque_limit"'),
        (table.ARM, {f"unknown {i}": 1 for i in range(1000)}, "unknown attribute; known: port"),
    ],
)
def test_what_looks_misspelt_is_refused_with_the_nearest(rows, attributes, says):
    with pytest.raises(ConfigError, match=says):
        without_ignored(attributes, rows)


def test_what_is_known_is_left_alone():
    attributes = {"port": "/dev/a", "manual_mode": {"p_gain": 8}}
    found = without_ignored(attributes, table.ARM)

    assert (found.values, found.ignored) == (attributes, ())
