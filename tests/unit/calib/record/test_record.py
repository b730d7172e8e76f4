import json

import pytest

from so101_motion.calib.record import record
from so101_motion.calib.record.compare import diff
from so101_motion.calib.record.record import JOINTS, HeldCalibration, JointCalibration
from so101_motion.common.errors import CalibrationError

SEED = {
    "shoulder_pan": {
        "id": 1, "drive_mode": 0, "homing_offset": -1470, "range_min": 758, "range_max": 3292,
        "norm_mode": 3,
    },
    "shoulder_lift": {
        "id": 2, "drive_mode": 0, "homing_offset": 157, "range_min": 612, "range_max": 3401,
        "norm_mode": 3,
    },
    "gripper": {
        "id": 6, "drive_mode": 0, "homing_offset": 1407, "range_min": 2031, "range_max": 3476,
        "norm_mode": 1,
    },
}  # fmt: skip


def seed_with(joint="shoulder_pan", **changes):
    content = json.loads(json.dumps(SEED))
    content[joint].update(changes)
    return content


def test_the_published_example_is_read_and_lerobots_five_fields_are_enough():
    found = record.parse({**SEED, "elbow_flex": None, "something_else": 5})

    assert set(found) == {"shoulder_pan", "shoulder_lift", "gripper"}, "null is as missing"
    assert found["shoulder_pan"].to_json() == SEED["shoulder_pan"]
    content = {joint: {k: v for k, v in SEED[joint].items() if k != "norm_mode"} for joint in SEED}
    found = record.parse(content)

    assert found["shoulder_pan"].norm_mode == 3
    assert found["gripper"].norm_mode == 1


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"id": 3}, "elbow_flex"),
        ({"id": 77}, "no joint"),
        ({"drive_mode": 2}, "drive_mode"),
        ({"homing_offset": 2048}, "2047"),
        ({"homing_offset": -2048}, "2047"),
        ({"range_min": 3292}, "range"),
        ({"range_min": -1}, "range"),
        ({"range_max": 4096}, "range"),
        ({"range_max": 800}, "3.7 deg"),
        ({"range_min": 3145, "range_max": 948}, "range_min 3145 is above range_max 948"),
        ({"range_min": 10, "range_max": 4090}, "more than the joint can turn"),
        ({"norm_mode": 4}, "norm_mode"),
        ({"range_min": 700.5}, "whole number"),
        ({"range_min": "700"}, "whole number"),
        ({"range_min": True}, "whole number"),
        ({"homing_offset": 10**400}, "homing_offset is 10.*which is impossible"),
        ({"homing_offset": None}, "homing_offset must be a whole number, not None"),
    ],
)
def test_impossible_values_are_refused_by_joint(changes, says):
    with pytest.raises(CalibrationError, match=says) as caught:
        record.parse(seed_with(**changes))

    assert caught.value.joint == "shoulder_pan"
    assert caught.value.next_step


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ([], "object"),
        ({}, "no joint of this arm"),
        ({"shoulder_pan": {"id": 1}}, "homing_offset, range_min, range_max missing"),
        ({"shoulder_pan": 5}, "shoulder_pan: must be an object"),
    ],
)
def test_an_invalid_calibration_is_refused(content, says):
    with pytest.raises(CalibrationError, match=says):
        record.parse(content)


def test_a_joint_without_a_drive_mode_has_0_and_one_without_an_offset_is_refused():
    content = seed_with()
    del content["shoulder_pan"]["drive_mode"], content["gripper"]["homing_offset"]
    found = record.usable(content)

    assert found.calibration["shoulder_pan"] == record.parse(SEED)["shoulder_pan"]
    assert set(found.refused) == {"gripper"}
    assert "gripper is not taken from the calibration: homing_offset missing" in found.notes[0]


@pytest.mark.parametrize("offset", [2048, -2048])
def test_an_offset_of_half_a_turn_becomes_what_a_servo_stores(offset):
    found = record.usable(seed_with(homing_offset=offset))

    assert abs(found.calibration["shoulder_pan"].homing_offset) == 2047
    assert found.calibration["shoulder_pan"].homing_offset * offset > 0
    assert f"homing_offset {offset} is more than a servo stores" in found.notes[0]


@pytest.mark.parametrize(
    "changes", [{"range_max": 800}, {"homing_offset": 2049}, {"drive_mode": 2}, {"range_min": None}]
)
def test_one_impossible_joint_does_not_lose_the_others(changes):
    found = record.usable(seed_with(**changes))

    assert set(found.calibration) == {"shoulder_lift", "gripper"}
    assert set(found.refused) == {"shoulder_pan"}
    (note,) = found.notes
    assert note.startswith("shoulder_pan is not taken from the calibration: ")
    assert "the values in its servo are used" in note


@pytest.mark.parametrize("changes", [{"id": 3}, {"id": 77}])
def test_the_calibration_of_another_arm_is_refused_as_a_whole(changes):
    with pytest.raises(CalibrationError, match="belongs to this arm"):
        record.usable(seed_with(**changes))
    with pytest.raises(CalibrationError, match="must be an object"):  # or without a possible joint
        record.usable({"shoulder_pan": 5, "gripper": {"id": 6}})


def test_defaults_are_the_published_ones_and_a_servo_with_its_first_limits_looks_as_new():
    pan, jaw = record.default("shoulder_pan"), record.default("gripper")

    assert (pan.id, pan.homing_offset, pan.range_min, pan.range_max) == (1, 0, 500, 3500)
    assert (jaw.id, jaw.range_min, jaw.range_max, jaw.norm_mode) == (6, 2048, 3248, 1)
    for joint, expected in (("elbow_flex", True), ("wrist_roll", False)):
        found, _ = record.from_registers(joint, 3, HeldCalibration())
        assert record.looks_as_new(joint, found) is expected


@pytest.mark.parametrize(
    ("joint", "held", "believed", "says"),
    [
        ("elbow_flex", (-5, 900, 3100), (-5, 900, 3100), None),
        ("gripper", (7, 0, 4095), (7, 2048, 3248), "calibrate"),  # not driven past its stops
        ("gripper", (0, 2030, 3481), (0, 2030, 3481), None),
        ("shoulder_pan", (0, 0, 4095), (0, 0, 4095), "new servo, not calibrated yet"),
        ("shoulder_pan", (0, 9, 9), (0, 500, 3500), "no sense"),
    ],
)
def test_registers_are_believed_when_they_make_sense(joint, held, believed, says):
    offset, lower, upper = held
    there = HeldCalibration(homing_offset=offset, range_min=lower, range_max=upper)
    found, odd = record.from_registers(joint, JOINTS.index(joint) + 1, there)

    assert (found.homing_offset, found.range_min, found.range_max) == believed
    assert odd is None if says is None else says in odd


def test_an_arm_on_another_robot_is_read_under_its_prefix_and_two_arms_are_asked_about():
    wheel = {"id": 7, "drive_mode": 0, "homing_offset": 0, "range_min": 0, "range_max": 4095}
    robot = {f"arm_{joint}": entry for joint, entry in SEED.items()} | {"base_left_wheel": wheel}
    assert record.parse(robot) == record.parse(SEED)
    two = robot | {f"left_arm_{joint}": entry for joint, entry in SEED.items()}
    with pytest.raises(CalibrationError, match="several arms: arm_, left_arm_"):
        record.parse(two)


def with_travels(*ticks):
    return {
        joint: {"id": i, "homing_offset": 0, "range_min": 100, "range_max": 100 + travel}
        for i, (joint, travel) in enumerate(zip(JOINTS, ticks, strict=True), start=1)
    }


@pytest.mark.parametrize("roll", [2367, 3995])  # recorded, or a full turn as LeRobot has it
def test_the_record_of_an_arm_whose_ids_run_the_other_way_is_refused(roll):
    content = with_travels(1251, 3824, 2335, 2198, roll, 2714)
    for read in (record.parse, record.usable):
        with pytest.raises(CalibrationError, match=r"6 to 1.*--start-over"):
            read(content)


@pytest.mark.parametrize("pan", [1200, 2714])
def test_a_pan_that_was_hardly_moved_is_no_other_order(pan):
    record.usable(with_travels(pan, 2367, 2198, 2335, 3824, 1463))


@pytest.mark.parametrize(("ids", "wrong"), [
    (range(1, 7), ""), (range(2, 8), "from 2 to 7"), (range(6), "from 0 to 5"),
    ((2, 3, 4, 5, 6), ""), ((1, 2, 3, 4, 5, 9), ""), ((), ""),
])  # fmt: skip
def test_six_ids_in_a_row_that_do_not_begin_at_1_are_misplaced(ids, wrong):
    assert wrong in record.misplaced(ids, {})
    assert bool(wrong) == bool(record.misplaced(ids, {}))


CALIBRATION = {
    "gripper": JointCalibration(id=6, homing_offset=1407, range_min=2031, range_max=3476),
    "shoulder_pan": JointCalibration(id=1, homing_offset=-1470, range_min=758, range_max=3292),
}
PAN_HELD = HeldCalibration(homing_offset=-1471, range_min=758, range_max=3300)


def test_each_number_stands_beside_what_the_servo_holds():
    rows = diff(CALIBRATION, {"shoulder_pan": PAN_HELD})

    assert [(row.joint, row.field, row.filed, row.held, row.differs) for row in rows] == [
        ("shoulder_pan", "homing_offset", -1470, -1471, False),  # the published module's one tick
        ("shoulder_pan", "range_min", 758, 758, False),
        ("shoulder_pan", "range_max", 3292, 3300, True),
        ("gripper", "homing_offset", 1407, None, False),
        ("gripper", "range_min", 2031, None, False),
        ("gripper", "range_max", 3476, None, False),
    ]
    assert rows[2].sentence == (
        "shoulder_pan: range_max is 3292 in the calibration, the servo holds 3300"
    )
    assert (
        rows[5].sentence == "gripper: range_max is 3476 in the calibration, the servo is not known"
    )
