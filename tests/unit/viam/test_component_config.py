import pytest

from so101_motion.common.compliance import Compliance
from so101_motion.common.errors import ConfigError
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_rad
from so101_motion.viam.component_config import (
    CalibrationConfig,
    DiscoveryConfig,
    HardwareArmConfig,
    HardwareGripperConfig,
    SimulatedArmConfig,
    SimulatedGripperConfig,
    duration,
)
from so101_motion.viam.conversion.world_state import MOST_THINGS
from so101_motion.viam.models.arm_resource import scene_of
from so101_motion.viam.models.configured import without_ignored

PORT = {"port": "/dev/ttyACM0"}


def test_all_that_later_versions_know_is_taken():
    arm = HardwareArmConfig.from_attributes(
        {
            **PORT,
            "calibration_file": "arm.json",
            "baudrate": 500000.0,
            "servo_ids": [1.0, 2.0, 3.0, 4.0, 5.0],
            "timeout": "5s",
            "speed_degs_per_sec": 0.0,
            "acceleration_degs_per_sec_per_sec": 10.0,
            "motion": "mine",
            "visualize_ee_frame": True,
            "use_urdf": True,
            "mesh_decimation_ratios": [0.9] * 5,
            "waypoint_lookahead_deg": 3.0,
            "disable_servo_gains": True,
            "manual_mode": {"pos_deadband_deg": 0.5, "loop_hz": 50.0, "torque_limit": 50.0},
            "orientation_tolerance_deg": 30.0,
            "position_tolerance_mm": 1.0,
        }
    )

    assert arm.connection.timeout == 5.0
    assert arm.connection.baudrate == 500000
    assert arm.speed == pytest.approx(to_rad(50.0)), "0 counts as not given"
    assert set(arm.unused) == {
        "mesh_decimation_ratios", "waypoint_lookahead_deg", "disable_servo_gains",
        "manual_mode.loop_hz",
    }  # fmt: skip
    assert arm.compliance == Compliance(resistance=0.05), "as asked"


@pytest.mark.parametrize(
    ("given", "wall"),
    [
        ({"manual_mode": {}}, 0.3),
        ({"manual_mode": {"wall_torque_limit": 0}}, 0.0),
        ({"manual_mode": {"wall_torque_limit": 500.0}}, 0.5),
        ({"collision_guard": False}, 0.0),
    ],
)
def test_the_wall_that_a_hand_feels_can_be_switched_off(given, wall):
    assert HardwareArmConfig.from_attributes(PORT | given).compliance.wall == wall


REFUSED = {
    HardwareArmConfig: [
        ({}, "port"),
        ({"port": ""}, "port"),
        ({"prot": "/dev/ttyACM0"}, 'did you mean "port"'),
        ({**PORT, "servo_ids": [1, 2, 3, 4]}, "five different"),
        ({**PORT, "servo_ids": [1, 2, 3, 4, 4]}, "five different"),
        ({**PORT, "servo_ids": [1, 2, 3, 5, 4.5]}, "five different"),
        ({**PORT, "servo_ids": [0, 2, 3, 4, 5]}, "from 1 to 5"),
        ({**PORT, "servo_ids": "1-5"}, "list"),
        ({**PORT, "speed_degs_per_sec": 2.9}, "3 to 180"),
        ({**PORT, "waypoint_lookahead_deg": 46}, "0.1 to 45"),
        ({**PORT, "disable_servo_gains": 1}, "true or false"),
        ({**PORT, "servo_gains": {}}, "unknown attribute"),
        ({**PORT, "vision": "finder"}, 'name it in "camera"'),
        ({**PORT, "ignore_components": "crate"}, "list of names"),
        ({**PORT, "control_rate_hz": 1000}, r"control_rate_hz.*50 to 200"),
        ({**PORT, "baudrate": 9600}, "baudrate"),
        ({**PORT, "baudrate": 500000.5}, "whole number"),
        ({**PORT, "manual_mode": {"loop_hz": 201}}, "loop_hz"),
        ({**PORT, "manual_mode": 5}, "object"),
        ({**PORT, "manual_mode": {"wall_torque_limit": -1}}, "wall_torque_limit"),
        *(
            ({**PORT, "joint_zero_offsets_deg": given}, says)
            for given, says in (
                ({"elbow": 1.0}, 'did you mean "elbow_flex"'),
                ({"gripper": 1.0}, "unknown joint of joint_zero_offsets_deg"),
                ({"elbow_flex": 181}, "elbow_flex.*-180 to 180 deg"),
                ({"elbow_flex": float("nan")}, "finite"),
                ([1.0, 2.0], "five angles, base to wrist"),
                ([1.0] * 6, "at most 5"),
                ([0.0] * 4 + [500.0], r"joint_zero_offsets_deg\[4\].*-180 to 180"),
                ("stops", "list"),
            )
        ),
    ],
    HardwareGripperConfig: [
        ({"gripper_type": "leader"}, "port"),
        ({**PORT, "gripper_type": "claw"}, "gripper_type"),
        ({**PORT, "articulated_jaw": True}, r"articulated_jaw.*is not supported"),
    ],
    CalibrationConfig: [
        ({}, "name the serial port"),
        ({**PORT, "calibration": "arm.json"}, 'did you mean "calibration_file"'),
        ({**PORT, "servo_ids": [1, 1]}, "different"),
        ({**PORT, "servo_ids": [1.5]}, "whole numbers"),
        ({**PORT, "servo_ids": [0]}, "from 1 to 6"),
        ({**PORT, "servo_ids": [7]}, "from 1 to 6"),
    ],
    DiscoveryConfig: [
        ({"ports": "/dev/ttyAMA0"}, "must be a list"),
        ({"ports": [3.0]}, "must hold names"),
        ({"ports": [""]}, "must hold names"),
        ({"port": "/dev/ttyAMA0"}, 'did you mean "ports"'),
    ],
}


@pytest.mark.parametrize(
    ("model", "attributes", "says"), [(m, *row) for m, rows in REFUSED.items() for row in rows]
)
def test_what_a_model_cannot_use_is_named(model, attributes, says):
    with pytest.raises(ConfigError, match=says):
        model.from_attributes(attributes)


def test_values_that_the_published_module_takes_for_none_are_none():
    arm = HardwareArmConfig.from_attributes(
        {**PORT, "baudrate": 0, "timeout": 0.0, "servo_ids": [], "mesh_decimation_ratios": [1] * 6}
    )
    gripper = HardwareGripperConfig.from_attributes({**PORT, "servo_id": 0.0, "baudrate": 0.0})
    sensor = CalibrationConfig.from_attributes({**PORT, "baudrate": 0, "timeout": 0})

    assert (arm.connection.baudrate, arm.connection.timeout) == (1_000_000, 1.0)
    assert arm.servo_ids == (1, 2, 3, 4, 5)
    assert (gripper.servo_id, gripper.connection.baudrate) == (6, 1_000_000)
    assert sensor.connection.timeout == 1.0
    assert DiscoveryConfig.from_attributes({}).ports == ()
    assert DiscoveryConfig.from_attributes({"ports": ["/dev/ttyAMA0"]}).ports == ("/dev/ttyAMA0",)


@pytest.mark.parametrize(
    ("speed_deg", "taken_deg", "note"),
    [
        (0.0, 90.0, None),
        (500.0, 180.0, "speed_degs_per_sec is 500; 180 is used, the nearest of 3 to 180 deg/s"),
        (0.5, 3.0, "speed_degs_per_sec is 0.5; 3 is used, the nearest of 3 to 180 deg/s"),
        (60.0, 60.0, None),
    ],
)
def test_a_simulated_arm_takes_any_positive_speed_and_says_which_it_uses(
    speed_deg, taken_deg, note
):
    arm = SimulatedArmConfig.from_attributes({"speed_degs_per_sec": speed_deg})

    assert arm.speed == pytest.approx(to_rad(taken_deg))
    assert arm.notes == (() if note is None else (note,))


@pytest.mark.parametrize(
    ("value", "seconds"),
    [
        ("5s", 5.0), ("500ms", 0.5), ("1m30s", 90.0), ("1.5s", 1.5), (" 2s ", 2.0), ("20us", 2e-5),
        (5, 5.0), (0.25, 0.25), (5_000_000_000, 5.0), (500_000_000.0, 0.5),
    ],
)  # fmt: skip
def test_durations_are_read_as_people_write_them(value, seconds):
    assert duration("timeout", value) == pytest.approx(seconds)


@pytest.mark.parametrize("value", ["5", "5 s", "-5s", "s", "", "0s", 0, -1, True, None, "11m"])
def test_an_invalid_duration_is_refused(value):
    with pytest.raises(ConfigError, match="timeout"):
        duration("timeout", value)


def test_a_gripper_names_its_port_or_its_arm():
    with_port = HardwareGripperConfig.from_attributes(PORT)
    with_arm = HardwareGripperConfig.from_attributes({"arm": "my-arm"})

    assert with_port.connection.port == "/dev/ttyACM0"
    assert (with_port.arm, with_port.servo_id, with_port.gripper_type) == (None, 6, "follower")
    assert (with_arm.connection, with_arm.arm) == (None, "my-arm")
    assert HardwareGripperConfig.from_attributes({**PORT, "articulated_jaw": False}).servo_id == 6


@pytest.mark.parametrize(
    ("given", "degrees"),
    [
        ({"elbow_flex": -5.8}, {"elbow_flex": -5.8}),
        ({"elbow_flex": 0}, {"elbow_flex": 0.0}),
        ({"shoulder_pan": 4.1, "wrist_roll": None}, {"shoulder_pan": 4.1}),
        (None, {}),
        ({}, {}),
        ({"elbow_flex": None}, {}),
        (
            [4.1, -1.5, -5.8, -0.6, 0.0],
            dict(zip(ARM_JOINTS, (4.1, -1.5, -5.8, -0.6, 0.0), strict=True)),
        ),
    ],
)
def test_zeros_may_be_given_by_joint_or_for_all_five(given, degrees):
    config = HardwareArmConfig.from_attributes({**PORT, "joint_zero_offsets_deg": given})

    wanted = {j: pytest.approx(to_rad(d)) for j, d in degrees.items()}
    assert config.zero_offsets == (wanted or None)


def test_a_calibration_needs_a_port_and_takes_what_the_published_module_takes():
    fresh = CalibrationConfig.from_attributes(PORT)
    full = CalibrationConfig.from_attributes(
        {
            **PORT,
            "calibration_file": "my_awesome_arm.json",
            "baudrate": 500000.0,
            "timeout": "5s",
            "servo_ids": [3.0, 1.0, 6.0],
        }
    )

    assert fresh.connection.calibration_file is None
    assert fresh.joints == (*ARM_JOINTS, "gripper")
    assert fresh.unused == ()
    assert full.connection.calibration_file == "my_awesome_arm.json"
    assert full.joints == ("shoulder_pan", "elbow_flex", "gripper")
    assert full.unused == ("timeout",)
    assert CalibrationConfig.from_attributes({**PORT, "servo_ids": []}).joints == fresh.joints


# Attributes that a model does not know

URDF = next(row for row in HardwareArmConfig.rows() if row.name == "use_urdf")


@pytest.mark.parametrize(
    ("model", "attributes", "ignored"),
    [
        (SimulatedArmConfig, {"port": "/dev/a", "calibration_file": "a.json"}, None),
        (SimulatedGripperConfig, {"port": "/dev/a", "servo_id": 6}, None),
        (HardwareArmConfig, {"servo_id": 6, "gripper_type": "leader"}, None),  # near servo_ids
        (HardwareGripperConfig, {"servo_ids": [1, 2, 3, 4, 5]}, None),
        (HardwareArmConfig, {"leader_arm": "one", "rate_hz": 20}, None),  # of teleoperation
        (HardwareArmConfig, {"_comment": "mine", "comment": 1, "//": "x", "_port": "/dev/b"}, None),
        (HardwareArmConfig, {"something": 1, "x" * 5000: 2}, None),
        (HardwareArmConfig, {"manual_mode": {"p_gain": 8, "what": 1}}, ("manual_mode.what",)),
        (HardwareArmConfig, {"manual_mode": {"p_gain": 8}, "port": "/dev/a"}, ()),
        (HardwareArmConfig, {"manual_mode": 5, "port": "/dev/a"}, ()),  # refused when it is read
    ],
)
def test_what_a_model_does_not_know_is_left_out_and_named(model, attributes, ignored):
    values, names = without_ignored({**attributes, "use_urdf": True}, (*model.rows(), URDF))

    assert names == (tuple(attributes) if ignored is None else ignored)
    assert values["use_urdf"] is True
    assert set(values) <= {"use_urdf", "manual_mode", "port"}
    assert values.get("manual_mode") in (None, 5, {"p_gain": 8})


@pytest.mark.parametrize(
    ("attributes", "says"),
    [
        ({"prot": "/dev/a"}, 'did you mean "port"'),
        ({"speed": 20}, 'did you mean "speed_degs_per_sec"'),
        ({"max_speed_deg_per_sec": 20}, 'did you mean "max_speed_degs_per_sec"'),
        ({"Port": "/dev/a"}, 'did you mean "port"'),
        ({"servo_gains": {}}, "did you mean"),
        ({"manual_mode": {"torque_limt": 5}}, 'did you mean "torque_limit"'),
        ({f"unknown {i}": 1 for i in range(1000)}, "unknown attribute; known: port"),
    ],
)
def test_what_looks_misspelt_is_refused_with_the_nearest(attributes, says):
    with pytest.raises(ConfigError, match=says):
        without_ignored(attributes, HardwareArmConfig.rows())


# Obstacles


def config(count):
    boxes = [
        {"name": f"box {i}", "box_mm": [5, 5, 5], "position_mm": [500, 0, i]} for i in range(count)
    ]
    return SimulatedArmConfig.from_attributes({"obstacles": boxes})


def test_what_was_checked_once_is_not_built_again_and_too_many_are_refused():
    assert len(scene_of(config(2)).obstacles) == 2
    assert scene_of(config(2)) is scene_of(config(2))
    assert scene_of(config(2)) is not scene_of(config(1))
    with pytest.raises(ConfigError, match=f"{MOST_THINGS + 1} obstacles.*more than"):
        scene_of(config(MOST_THINGS + 1))
