import json

import pytest

from so101_motion.calib.record import lerobot, store
from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.common.errors import CalibrationError, ConfigError

ALL = {joint: JointCalibration(id=i + 1, homing_offset=7 * i) for i, joint in enumerate(JOINTS)}


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
