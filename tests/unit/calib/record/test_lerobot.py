import json
import math

import pytest
from harness.held_calibration import ISSUE_930
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.calib.record import lerobot, store, zero
from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.common.errors import CalibrationError, ConfigError

ARM = JOINTS[:5]
STRETCHED_DEG = dict(zip(ARM, (0.0, 90.0, -90.0, 0.0, math.degrees(0.0486795)), strict=True))
TURNED = dict(zip(JOINTS, (0, 1, 0, 0, 1, 0), strict=True))
ALL = {joint: JointCalibration(id=i + 1, homing_offset=7 * i) for i, joint in enumerate(JOINTS)}


def lists_of(zeros, *, slips=(0,) * 6, jaw=(1983, 2793)):
    """What LeRobot wrote before June 2025 for an arm whose encoders read ``zeros`` at zero.

    ``slips`` is by how much each joint was held wrongly in the first pose [tick].
    """
    content = {name: [] for name in ("homing_offset", "drive_mode", "start_pos", "end_pos")}
    for joint, at_zero, slip in zip(ARM, zeros, slips, strict=False):
        sign = -1 if TURNED[joint] else 1
        stretched = round(at_zero + STRETCHED_DEG[joint] * 4096 / 360)
        turned = sign * (stretched + sign * 1024)
        content["start_pos"].append(stretched + slip)
        content["end_pos"].append(turned)
        content["homing_offset"].append(1024 - turned)
    content["start_pos"].append(jaw[0])
    content["end_pos"].append(jaw[1])
    content["homing_offset"].append(1024 - jaw[1])
    return {
        **content,
        "drive_mode": list(TURNED.values()),
        "calib_mode": ["DEGREE"] * 5 + ["LINEAR"],
        "motor_names": list(JOINTS),
    }


MIDDLES = (2048, 2048, 2048, 2048, 2048)


# The format of today


def test_an_exported_file_holds_five_whole_numbers_reads_back_the_same_and_keeps_the_old_one(
    tmp_path,
):
    file = tmp_path / "robots" / "so_follower" / "arm.json"
    lerobot.export(ALL, file)
    content = json.loads(file.read_text())

    assert list(content) == list(JOINTS)
    for joint, entry in content.items():
        assert list(entry) == ["id", "drive_mode", "homing_offset", "range_min", "range_max"]
        assert all(type(value) is int for value in entry.values())
        assert entry["homing_offset"] == ALL[joint].homing_offset
    (tmp_path / "arm.json").write_text("somebody's")
    calibration = {**ALL, "gripper": JointCalibration(id=6, norm_mode=1)}
    lerobot.export(calibration, tmp_path / "arm.json")

    assert store.read(tmp_path / "arm.json").calibration == calibration
    assert (tmp_path / "arm.json.bak").read_text() == "somebody's"


def test_lerobot_is_not_given_a_part_of_an_arm_nor_what_cannot_be_written(tmp_path):
    part = {joint: ALL[joint] for joint in JOINTS if joint not in ("wrist_roll", "elbow_flex")}
    with pytest.raises(CalibrationError, match="elbow_flex, wrist_roll is not calibrated"):
        lerobot.export(part, tmp_path / "arm.json")

    assert not (tmp_path / "arm.json").exists()
    (tmp_path / "robots").write_text("")
    with pytest.raises(CalibrationError, match="cannot be written"):
        lerobot.export(ALL, tmp_path / "robots" / "arm.json")


@pytest.mark.parametrize(
    ("variables", "folder"),
    [
        ({}, "{home}/.cache/huggingface/lerobot/calibration"),
        ({"XDG_CACHE_HOME": "/cache"}, "/cache/huggingface/lerobot/calibration"),
        ({"HF_HOME": "/hf"}, "/hf/lerobot/calibration"),
        ({"HF_HOME": "/hf", "HF_LEROBOT_HOME": "/lr"}, "/lr/calibration"),
        ({"HF_LEROBOT_HOME": "/lr", "HF_LEROBOT_CALIBRATION": "/c"}, "/c"),
    ],
)
def test_lerobot_s_folder_is_where_its_own_variables_say(variables, folder, monkeypatch, tmp_path):
    for name in ("XDG_CACHE_HOME", "HF_HOME", "HF_LEROBOT_HOME", "HF_LEROBOT_CALIBRATION"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    for name, value in variables.items():
        monkeypatch.setenv(name, value)

    assert str(lerobot.folder()) == folder.format(home=tmp_path)


def test_a_follower_s_file_goes_where_this_lerobot_looks(monkeypatch, tmp_path):
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    assert lerobot.path_for("arm") == tmp_path / "robots/so_follower/arm.json"

    (tmp_path / "robots" / "so101_follower").mkdir(parents=True)
    assert lerobot.path_for("arm") == tmp_path / "robots/so101_follower/arm.json"
    leader = lerobot.path_for("arm", kind="so101_leader")
    assert leader == tmp_path / "teleoperators/so101_leader/arm.json"


@pytest.mark.parametrize(
    ("name", "kind", "says"),
    [
        *((name, "so101_follower", "plain name") for name in ("", "..", "a/b", "a\\b", "a\0")),
        ("arm", "so102", "so101_follower"),
    ],
)
def test_a_name_or_kind_that_lerobot_cannot_have_is_refused(name, kind, says):
    with pytest.raises(ConfigError, match=says):
        lerobot.path_for(name, kind=kind)


# The format of before June 2025


@given(
    st.lists(st.integers(-6000, 6000), min_size=5, max_size=5),
    st.lists(st.integers(-120, 120), min_size=6, max_size=6),
)
def test_the_lists_give_back_the_zeros_of_the_arm_they_were_made_with(zeros, slips):
    calibration, found, notes = lerobot.from_lists(lists_of(zeros, slips=slips))

    for joint, at_zero in zip(ARM, zeros, strict=True):
        entry = calibration[joint]
        ticks = zero.zero_ticks(entry, found[joint])  # as the servo will report it
        away = (ticks + entry.homing_offset - at_zero + 2048) % 4096 - 2048
        assert abs(away) <= 0.51  # [tick]; LeRobot rounded
        lower, upper = zero.STOPS[joint]
        travel = (entry.range_max - entry.range_min) / 4096 * math.tau
        assert travel == pytest.approx(upper - lower - math.radians(6.0), abs=0.002)
    assert "calibrate again" in notes[0]


def test_the_jaw_of_the_lists_is_closed_at_their_start():
    calibration, found, _ = lerobot.from_lists(lists_of(MIDDLES, jaw=(1983, 2793)))
    jaw = calibration["gripper"]

    assert jaw.range_min + jaw.homing_offset == 1983
    assert jaw.range_max - jaw.range_min == 2793 - 1983
    assert "gripper" not in found
    some = {**lists_of(MIDDLES), "motor_names": ["shoulder_pan", *"abcd", "gripper"]}
    assert set(lerobot.from_lists(some)[0]) == {"shoulder_pan", "gripper"}


def test_the_lists_are_read_as_a_file_and_saving_makes_them_ours(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    file = tmp_path / "main_follower.json"
    file.write_text(json.dumps(lists_of(MIDDLES)))
    before = store.read(file)
    after = store.save(file, {"gripper": ALL["gripper"]})

    assert after.calibration["elbow_flex"] == before.calibration["elbow_flex"]
    assert after.zeros["elbow_flex"].angle == pytest.approx(
        before.zeros["elbow_flex"].angle, abs=1e-5
    )
    assert json.loads(store.versions(file)[-1].path.read_text())["motor_names"] == list(JOINTS)


# As shown in LeRobot's issue 930; the second servo counts below zero there.
def test_a_file_from_the_field_is_read():
    calibration, found, notes = lerobot.from_lists(ISSUE_930)
    zeros = [
        round(zero.zero_ticks(calibration[joint], found[joint]) + calibration[joint].homing_offset)
        for joint in ARM
    ]

    assert [ticks % 4096 for ticks in zeros] == [2145, -1020 % 4096, 2425, 3126, 2938]
    assert "by up to 10 deg" in notes[0]


def changed(**changes):
    content = lists_of(MIDDLES)
    for name, (place, value) in changes.items():
        content[name][place] = value
    return content


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({**ISSUE_930, "drive_mode": [0] * 6}, "shoulder_lift: drive_mode 0"),
        (changed(homing_offset=(2, 99)), "elbow_flex: homing_offset 99 and end_pos"),
        (changed(start_pos=(3, 2900)), "wrist_flex: was not turned by 90 deg"),
        (changed(calib_mode=(0, "LINEAR")), "shoulder_pan: calib_mode must be DEGREE"),
        (changed(motor_names=(1, "elbow_flex")), "elbow_flex: is in motor_names twice"),
        (changed(end_pos=(1, 2.5)), "end_pos must be a list of whole numbers"),
        (changed(end_pos=(1, True)), "end_pos must be a list of whole numbers"),
        (changed(start_pos=(1, 10**30)), "start_pos must be a list of whole numbers"),
        ({**lists_of(MIDDLES), "start_pos": None}, "start_pos must be a list"),
        ({**lists_of(MIDDLES), "drive_mode": [0]}, "drive_mode has 1 entries, motor_names has 6"),
        ({**lists_of(MIDDLES), "motor_names": ["a"] * 6}, "no joint of this arm"),
        (lists_of(MIDDLES, jaw=(2000, 1900)), "gripper: range"),
    ],
)
def test_lists_that_contradict_themselves_are_refused_by_name(content, says):
    assert lerobot.is_of_lists(content)
    with pytest.raises(CalibrationError, match=says):
        lerobot.from_lists(content)
