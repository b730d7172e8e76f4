import json
import os

import pytest

from so101_motion.calib.record import file_search, store, versions
from so101_motion.calib.record.record import JointCalibration
from so101_motion.calib.record.zero import Zero

JAW = {"gripper": JointCalibration(id=6, homing_offset=1407, norm_mode=1)}
ELBOW = {"elbow_flex": JointCalibration(id=3, range_min=948, range_max=3146)}
TEXT = json.dumps({"gripper": JAW["gripper"].to_json()})


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """A user's home, with nothing else of this computer in sight."""
    home = tmp_path / "home"
    home.mkdir()
    for name in ("VIAM_MODULE_DATA", "VIAM_HOME", "XDG_CACHE_HOME", "HF_HOME", "HF_LEROBOT_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.delenv("HF_LEROBOT_CALIBRATION", raising=False)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("XDG_DATA_HOME", str(home / "data"))
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return home


def put(path, text=TEXT):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def found_in(folder):
    """What is found below a folder; the computer may have more of it elsewhere."""
    return [found for found in file_search.find() if found.path.is_relative_to(folder)]


@pytest.mark.parametrize(
    ("where", "origin", "role"),
    [
        ("home/.viam/module-data/3f2a/so101/arm.json", "module data", "unknown"),
        ("work/so101_calibration.json", "module folder", "unknown"),
        ("home/.viam/packages/data/module/so101-1_2_0/arm.json", "module folder", "unknown"),
        ("home/.cache/huggingface/lerobot/calibration/robots/so_follower/a.json", "LeRobot",
         "follower"),
        ("home/.cache/huggingface/lerobot/calibration/robots/so101_follower/a.json", "LeRobot",
         "follower"),
        ("home/.cache/huggingface/lerobot/calibration/teleoperators/so101_leader/a.json",
         "LeRobot", "leader"),
    ],
)  # fmt: skip
def test_files_are_found_where_programs_put_them(tmp_path, where, origin, role):
    path = put(tmp_path / where)
    (found,) = found_in(tmp_path)

    assert (found.path, found.origin, found.role) == (path, origin, role)
    assert (found.name, found.problem) == (path.stem, "")
    assert found.stored.calibration == JAW


def test_the_module_s_own_data_comes_first(tmp_path, monkeypatch):
    monkeypatch.setenv("VIAM_MODULE_DATA", str(tmp_path / "home/.viam/module-data/3f2a/ours"))
    put(tmp_path / "home/.viam/module-data/3f2a/another/arm.json")
    put(tmp_path / "work/arm.json")
    ours = put(tmp_path / "home/.viam/module-data/3f2a/ours/zzz.json")

    found = found_in(tmp_path)
    assert found[0].path == ours
    assert len(found) == 3  # each once, though the module's own is in two of the places


def test_zeros_are_found_with_their_calibration_beside_a_damaged_history(tmp_path):
    (versions.root() / "arm-123").mkdir(parents=True)
    put(versions.root() / "arm-456" / "0001_20260101T000000Z.json")
    put(versions.root() / "notes.txt")
    file = tmp_path / "work/arm.json"
    store.save(file, ELBOW, zeros={"elbow_flex": Zero(by="stops", angle=-0.1)})
    (found,) = found_in(tmp_path)

    assert found.stored.zeros["elbow_flex"].by == "stops"


def test_a_file_that_cannot_be_used_is_reported_with_its_problem(tmp_path):
    put(tmp_path / "work/arm.json", '{"gripper": {"id": 6}}')
    (found,) = found_in(tmp_path)

    assert found.stored is None
    assert "gripper: homing_offset" in found.problem


@pytest.mark.parametrize("text", ["{", "[]", '{"name": "so101"}', '"gripper"', "\0" * 70_000])
def test_other_files_are_ignored(tmp_path, text):
    put(tmp_path / "work/package.json", text)

    assert found_in(tmp_path) == []


def test_a_file_that_viam_server_deleted_is_found_as_its_second_copy(tmp_path, monkeypatch):
    file = tmp_path / "module" / "arm.json"
    monkeypatch.setenv("VIAM_MODULE_DATA", str(file.parent))
    store.save(file, JAW)
    store.save(file, ELBOW)
    assert [found.origin for found in found_in(tmp_path)] == ["module data"]

    file.unlink()
    (found,) = found_in(tmp_path)
    assert (found.origin, found.name) == ("kept copy", str(file))
    assert found.stored.calibration == {**JAW, **ELBOW}
    assert not file.exists()  # looking brings nothing back


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="such folders stop nobody there")
def test_a_folder_that_may_not_be_read_is_left_out(tmp_path):
    locked = tmp_path / "home/.viam/module-data"
    put(locked / "3f2a/so101/arm.json")
    locked.chmod(0)
    try:
        assert found_in(tmp_path) == []
    finally:
        locked.chmod(0o700)
