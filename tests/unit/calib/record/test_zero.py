import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.calib.record import zero
from so101_motion.calib.record.record import JointCalibration
from so101_motion.calib.record.zero import MIDDLE, ROLL_UPRIGHT, STOPS, SWEPT, Zero, encoder_zeros
from so101_motion.calib.record.zero_report import explain
from so101_motion.common.encoder_zeros import EncoderZero
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.drivers.bus.ticks import Ticks
from so101_motion.drivers.emulator.joint_figures import SO101
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.joint_setup import joint_map

TICKS_PER_DEG = 4096 / 360


def recorded(joint, *, short_deg=(0.0, 0.0), middle=2047.5, drive_mode=0):
    """What a sweep records that stops so far before either stop; and the angle at ``middle``."""
    lower, upper = np.degrees(STOPS[joint]) + np.array([short_deg[0], -short_deg[1]])
    half = (upper - lower) / 2 * TICKS_PER_DEG
    return JointCalibration(
        id=ARM_JOINTS.index(joint) + 1,
        range_min=round(middle - half),
        range_max=round(middle + half),
        drive_mode=drive_mode,
    ), (lower + upper) / 2


def mapped(joint, entry, known):
    return joint_map(joint, entry, offset=0, zero=known)


@given(joint=st.sampled_from(SWEPT), middle=st.floats(1500, 2600), drive_mode=st.integers(0, 1))
def test_a_joint_swept_from_stop_to_stop_has_the_model_s_zero(joint, middle, drive_mode):
    entry, middle_deg = recorded(joint, middle=middle, drive_mode=drive_mode)
    known = zero.by_stops(joint, entry)
    sign = -1 if drive_mode else 1
    at_zero = middle - sign * middle_deg * TICKS_PER_DEG

    assert known.by == "stops"
    angle = mapped(joint, entry, known).to_rad(Ticks(round(at_zero)))
    assert abs(math.degrees(angle)) < 0.1


@pytest.mark.parametrize("joint", SWEPT)
@pytest.mark.parametrize("short_deg", [(4.2, 0.0), (30.0, 20.0), (0.0, -5.2)])
def test_a_sweep_that_is_not_from_stop_to_stop_says_nothing_of_the_stops(joint, short_deg):
    assert zero.by_stops(joint, recorded(joint, short_deg=short_deg)[0]) is None


def test_neither_roll_nor_jaw_go_by_their_stops():
    assert zero.by_stops("wrist_roll", recorded("wrist_roll")[0]) is None
    assert zero.by_stops("gripper", JointCalibration(id=6, range_min=1000, range_max=2462)) is None


@given(
    lower=st.integers(0, 1500),
    upper=st.integers(2500, 4095),
    ticks=st.integers(1600, 2400),
    angle=st.floats(-1.0, 1.0),
    drive_mode=st.integers(0, 1),
)
def test_a_pose_is_where_it_was(lower, upper, ticks, angle, drive_mode):
    entry = JointCalibration(id=5, range_min=lower, range_max=upper, drive_mode=drive_mode)
    known = zero.by_pose(entry, ticks, angle=angle)

    assert mapped("wrist_roll", entry, known).to_rad(Ticks(ticks)) == pytest.approx(angle)


def test_the_configuration_outranks_the_file_and_both_the_published_module_s_zero():
    known, entry = (
        Zero(by="stops", angle=0.1),
        JointCalibration(id=3, range_min=800, range_max=3000),
    )

    assert zero.in_force(None, None, entry, None) is MIDDLE
    assert mapped("elbow_flex", entry, MIDDLE).to_rad(Ticks(1900)) == 0.0
    assert zero.in_force(known, None, entry, "homing") is known
    assert zero.in_force(known, 0.0, entry, "homing") == Zero(by="configured", angle=0.0)


@pytest.mark.parametrize("drive_mode", [0, 1])
def test_the_published_module_s_newer_zero_is_the_homing_tick(drive_mode):
    entry = JointCalibration(id=3, range_min=866, range_max=3073, drive_mode=drive_mode)
    newer = zero.in_force(None, None, entry, "homing")
    map_ = mapped("elbow_flex", entry, newer)
    sign = -1 if drive_mode else 1
    ends = sorted(math.degrees(map_.to_rad(Ticks(tick))) for tick in (866, 3073))

    assert map_.to_rad(Ticks(2047)) == pytest.approx(0.0)
    assert ends == pytest.approx(sorted((sign * -103.8, sign * 90.2)), abs=0.05)
    told = zero.about_homing({"elbow_flex": entry}, {}).replace("(", "")
    assert f'"joint_zero": "homing" would add elbow_flex {-6.8 * sign:+.1f} deg' in told
    assert not zero.about_homing({"elbow_flex": entry}, {"elbow_flex": MIDDLE})
    even = JointCalibration(id=3, range_min=947, range_max=3147)
    assert not zero.about_homing({"elbow_flex": even}, {})


def test_the_emulated_arm_has_the_stops_that_calibration_knows_and_the_model_stays_inside(model):
    for joint in SO101:
        assert STOPS[joint.name] == pytest.approx((joint.lower, joint.upper))
    for i, joint in enumerate(ARM_JOINTS):
        assert STOPS[joint][0] <= model.lower[i]
        assert model.upper[i] <= STOPS[joint][1] + 1e-4


@pytest.fixture(scope="module")
def model():
    return RobotModel.load()


# In words


def calibrated(zeros):
    return {joint: recorded(joint)[0] for joint in zeros}


def test_the_published_zero_is_40_mm_off_at_the_jaws_and_that_is_said(model):
    zeros = dict.fromkeys(ARM_JOINTS, MIDDLE)
    *joints, together = explain(zeros, calibrated(zeros), model)

    assert [one.joint for one in joints] == list(ARM_JOINTS)
    assert "elbow_flex: zero is the middle of its travel, as for LeRobot" in joints[2].sentence
    assert "-5.8 deg" in joints[2].sentence
    assert "about 39 mm" in together.sentence
    assert (together.by, together.jaws_mm) == ("middle", 0.0)


def test_zeros_that_are_known_are_reported_with_their_source(model):
    zeros = {
        joint: zero.by_stops(joint, recorded(joint)[0]) or Zero(by="pose", angle=ROLL_UPRIGHT)
        for joint in ARM_JOINTS
    } | {"shoulder_pan": Zero(by="configured", angle=math.radians(4.0))}
    pan, _, elbow, _, roll, together = explain(zeros, calibrated(zeros), model)

    assert "from joint_zero_offsets_deg" in pan.sentence
    assert "by its stops (the travel is 0.1 deg longer" in elbow.sentence
    assert elbow.jaws_mm == pytest.approx(30.0, abs=3.0)
    assert "from the pose it was held in" in roll.sentence
    assert together.by == "configured, pose, stops"
    assert 45.0 < together.jaws_mm < 60.0


def test_joints_that_nobody_calibrated_are_left_out(model):
    zeros = {"elbow_flex": MIDDLE, "wrist_flex": MIDDLE}
    calibration = calibrated({"wrist_flex": MIDDLE})

    assert [one.joint for one in explain(zeros, calibration, model)] == ["wrist_flex", ""]


ENTRY = JointCalibration(id=1, homing_offset=100, range_min=1000, range_max=3000)


@pytest.mark.parametrize(
    ("entry", "zero", "ticks"),
    [
        (ENTRY, None, 2100.0),
        (replace(ENTRY, range_min=900, range_max=3100), None, 2100.0),  # limits alone: no angle
        (replace(ENTRY, homing_offset=600, range_min=500, range_max=2500), None, 2100.0),
        (replace(ENTRY, homing_offset=-2047, range_min=500, range_max=1500), None, 3049.0),
        (ENTRY, Zero(by="stops", angle=0.1), 2100.0 - 65.2),
    ],
)
def test_zero_on_the_encoder_is_that_of_ticks_and_offset_together(entry, zero, ticks) -> None:
    joint = ARM_JOINTS[0]
    found = encoder_zeros({joint: entry}, {} if zero is None else {joint: zero})
    assert found == {joint: EncoderZero(direction=1, ticks=pytest.approx(ticks))}


def test_a_jaw_is_at_zero_where_it_is_closed() -> None:
    turned = replace(ENTRY, drive_mode=1)
    assert encoder_zeros({GRIPPER_JOINT: ENTRY}, {})[GRIPPER_JOINT].ticks == 1100.0
    assert encoder_zeros({GRIPPER_JOINT: turned}, {})[GRIPPER_JOINT] == EncoderZero(
        direction=-1, ticks=3100.0
    )


ELBOW = JointCalibration(id=3, homing_offset=5, range_min=948, range_max=3146)
PAN = JointCalibration(id=1, homing_offset=-1470, range_min=758, range_max=3292)
BOTH = {"elbow_flex": ELBOW, "shoulder_pan": PAN}
ZEROS = {"elbow_flex": Zero(by="stops", angle=-0.1), "shoulder_pan": Zero(by="pose", angle=0.07)}


@pytest.fixture
def file(tmp_path):
    return tmp_path / "arm.zero.json"


def test_a_written_file_reads_back_the_same_and_no_file_knows_no_zeros(file):
    assert zero.read_zeros(file, BOTH) == ({}, ())
    assert zero.zeros_text((BOTH, {})) == b""
    file.write_bytes(zero.zeros_text((BOTH, ZEROS)))
    zeros, notes = zero.read_zeros(file, BOTH)

    assert (zeros["elbow_flex"].by, zeros["shoulder_pan"].by) == ("stops", "pose")
    assert zeros["elbow_flex"].angle == pytest.approx(-0.1, abs=1e-6)
    assert notes == ()


@pytest.mark.parametrize(
    "change", [{"range_min": 949}, {"range_max": 9}, {"homing_offset": 4}, {"drive_mode": 1}]
)
def test_the_zero_of_another_record_is_not_used_and_that_is_said(file, change):
    file.write_bytes(zero.zeros_text((BOTH, ZEROS)))
    zeros, notes = zero.read_zeros(file, {**BOTH, "elbow_flex": replace(ELBOW, **change)})

    assert set(zeros) == {"shoulder_pan"}
    assert len(notes) == 1
    assert notes[0].startswith("elbow_flex: another program has calibrated")


def test_while_saving_the_old_record_and_the_new_each_have_their_own(file):
    new = {"elbow_flex": replace(ELBOW, range_min=900)}
    new_zeros = {"elbow_flex": Zero(by="pose", angle=0.5)}
    file.write_bytes(zero.zeros_text((BOTH, ZEROS), (new, new_zeros)))

    assert zero.read_zeros(file, BOTH)[0]["elbow_flex"].by == "stops"
    assert zero.read_zeros(file, new)[0]["elbow_flex"].by == "pose"
    # A new zero for the same numbers counts.
    file.write_bytes(zero.zeros_text((BOTH, ZEROS), (BOTH, new_zeros)))
    assert zero.read_zeros(file, BOTH)[0]["elbow_flex"].by == "pose"


def elbow(**zero):
    filed = {"drive_mode": 0, "homing_offset": 5, "range_min": 948, "range_max": 3146}
    return {"joints": {"elbow_flex": [{**filed, **zero}]}}


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("{", "not JSON"),
        ([], 'no "joints"'),
        ({"joints": []}, 'no "joints"'),
        ({"joints": {"elbow_flex": 5}}, "elbow_flex: its zeros must be a list"),
        ({"joints": {"elbow_flex": [5]}}, "elbow_flex: its zeros must be a list"),
        (elbow(), 'elbow_flex: "by" is stops or pose or middle or homing, not None'),
        (elbow(by="luck"), "not 'luck'"),
        (elbow(by="stops"), '"middle_deg": must be a number from -180 to 180'),
        (elbow(by="stops", middle_deg=math.nan), '"middle_deg" = nan: must be a finite'),
        (
            elbow(by="stops", middle_deg=181),
            '"middle_deg" = 181: out of range; must be a number from -180 to 180',
        ),
        (elbow(by="stops", middle_deg=10**400), '"middle_deg" = 1000.*finite number from -180'),
    ],
)
def test_a_spoiled_file_is_not_used_and_that_is_said(file, content, says):
    file.write_text(content if isinstance(content, str) else json.dumps(content))
    zeros, notes = zero.read_zeros(file, BOTH)

    assert zeros == {}
    assert len(notes) == 1
    assert re.search(says, notes[0])
    assert "middle of each travel" in notes[0]
