from so101_motion.calib.record.compare import diff
from so101_motion.calib.record.record import JointCalibration

CALIBRATION = {
    "gripper": JointCalibration(id=6, homing_offset=1407, range_min=2031, range_max=3476),
    "shoulder_pan": JointCalibration(id=1, homing_offset=-1470, range_min=758, range_max=3292),
}
PAN_HELD = {"homing_offset": -1471, "range_min": 758, "range_max": 3300}


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


def test_the_tolerance_can_be_chosen():
    exact = diff(CALIBRATION, {"shoulder_pan": PAN_HELD}, tolerance=0)
    loose = diff(CALIBRATION, {"shoulder_pan": PAN_HELD}, tolerance=10)

    assert [row.field for row in exact if row.differs] == ["homing_offset", "range_max"]
    assert not any(row.differs for row in loose)
