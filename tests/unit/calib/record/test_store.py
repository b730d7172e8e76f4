import json
import os
import stat
import threading

import pytest

from so101_motion.calib.record import store, versions
from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.calib.record.zero import Zero
from so101_motion.common.errors import CalibrationError
from so101_motion.files import atomic

PAN = JointCalibration(id=1, homing_offset=-1470, range_min=758, range_max=3292)
ELBOW = JointCalibration(id=3, homing_offset=5, range_min=948, range_max=3146)
JAW = JointCalibration(id=6, homing_offset=1407, range_min=2031, range_max=3476, norm_mode=1)
BY_STOPS = Zero(by="stops", angle=-0.1)


@pytest.fixture(autouse=True)
def disk_that_does_not_take_its_time(monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda _: None)  # what it is for: see test_atomic.py


@pytest.fixture(autouse=True)
def data_home(tmp_path, monkeypatch):
    home = tmp_path / "data"
    monkeypatch.setenv("XDG_DATA_HOME", str(home))
    monkeypatch.delenv("VIAM_MODULE_DATA", raising=False)
    return home


@pytest.fixture
def file(tmp_path):
    return tmp_path / "folder" / "arm.json"


@pytest.fixture
def module_file(tmp_path, monkeypatch):
    folder = tmp_path / "module-data"
    monkeypatch.setenv("VIAM_MODULE_DATA", str(folder))
    return folder / "arm.json"


def delete(file):
    """What viam-server does when the module leaves the configuration."""
    for path in file.parent.iterdir():
        path.unlink()
    file.parent.rmdir()


def put(file, text):
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(text if isinstance(text, bytes) else text.encode())


# Saving


def test_saving_writes_what_the_published_module_writes_and_nothing_else(file):
    store.save(file, {"gripper": JAW, "shoulder_pan": PAN})
    said = {"shoulder_pan": PAN.to_json(), "gripper": JAW.to_json()}

    assert file.read_text() == json.dumps(said, indent=2) + "\n"
    assert os.listdir(file.parent) == ["arm.json"]


@pytest.mark.parametrize("pan", [None, {**PAN.to_json(), "range_min": "left"}])
def test_a_joint_that_makes_no_sense_does_not_cost_the_others(file, pan):
    """The published module writes null for a joint that was left out."""
    put(file, json.dumps({"shoulder_pan": pan, "elbow_flex": ELBOW.to_json()}))
    found = store.save(file, {"gripper": JAW})

    assert set(json.loads(file.read_text())) == {"elbow_flex", "gripper"}
    assert set(found.calibration) == {"elbow_flex", "gripper"}
    kept = [note for note in found.notes if "range_min" in note and "kept as a version" in note]
    assert len(kept) == (pan is not None)


def test_a_version_with_a_joint_that_makes_no_sense_is_not_restored(file):
    store.save(file, {"shoulder_pan": PAN})
    store.save(file, {"gripper": JAW})
    wide = {**ELBOW.to_json(), "range_min": 10, "range_max": 4090}
    put(file, json.dumps({"shoulder_pan": PAN.to_json(), "elbow_flex": wide}))
    store.save(file, {"elbow_flex": ELBOW})
    kept = [v.number for v in store.versions(file) if b"4090" in v.path.read_bytes()]

    with pytest.raises(CalibrationError, match="choose another version"):
        store.restore(file, kept[0])
    assert set(store.restore(file).calibration) == {"shoulder_pan", "gripper"}


def test_rubbish_that_is_saved_over_is_kept_and_put_aside_if_it_is_far_too_large(file):
    put(file, b"\xff rubbish")
    found = store.save(file, {"gripper": JAW})

    assert found.calibration == {"gripper": JAW}
    assert store.versions(file)[-1].path.read_bytes() == b"\xff rubbish"
    assert "kept as a version" in found.notes[0]

    put(file, b"x" * 100_000)
    found = store.save(file, {"gripper": JAW})

    assert file.with_name("arm.json.bak").stat().st_size == 100_000
    assert any("too large" in note for note in found.notes)


def test_a_calibration_that_would_not_read_back_is_not_saved(file):
    with pytest.raises(CalibrationError, match="record says 4"):
        store.save(file, {"shoulder_pan": JointCalibration(id=4)})

    assert not file.exists()


def test_without_a_place_for_second_copies_saving_goes_on_and_says_so(file, data_home):
    data_home.write_text("not a folder")
    store.save(file, {"gripper": JAW})
    found = store.save(file, {"shoulder_pan": PAN})

    assert set(found.calibration) == {"shoulder_pan", "gripper"}
    assert any("no second copy" in note for note in found.notes)
    assert json.loads(file.with_name("arm.json.bak").read_text()) == {"gripper": JAW.to_json()}


def test_writers_at_the_same_time_lose_nothing(file):
    def write(joint, place):
        for offset in range(10):
            entry = JointCalibration(id=place, homing_offset=offset)
            store.save(file, {joint: entry}, zeros={joint: Zero(by="pose", angle=offset / 100)})

    writers = [
        threading.Thread(target=write, args=(joint, i + 1), name=f"so101-writer-{i}")
        for i, joint in enumerate(JOINTS)
    ]
    for writer in writers:
        writer.start()
    while any(writer.is_alive() for writer in writers):
        if file.exists():
            found = store.read(file)  # never half of it, and the zeros are those of the record
            for joint, entry in found.calibration.items():
                angle = entry.homing_offset / 100
                assert found.zeros[joint].angle == pytest.approx(angle, abs=1e-5)
    for writer in writers:
        writer.join()

    assert {joint: e.homing_offset for joint, e in store.read(file).calibration.items()} == {
        joint: 9 for joint in JOINTS
    }


def test_a_writer_that_hangs_is_not_waited_for_for_ever(file, monkeypatch):
    monkeypatch.setattr(atomic, "LONGEST_WAIT", 0.05)
    store.save(file, {"gripper": JAW})
    with atomic.locked(file.parent), pytest.raises(CalibrationError, match="keeps writing"):
        store.save(file, {"shoulder_pan": PAN})


# Versions


def test_every_state_of_the_file_is_kept_and_can_be_restored(file):
    for offset in range(4):
        store.save(file, {"gripper": JointCalibration(id=6, homing_offset=offset)})
        store.save(file, {"gripper": JointCalibration(id=6, homing_offset=offset)})  # no new state
    store.save(file, {"elbow_flex": ELBOW})
    numbers = [version.number for version in store.versions(file)]
    found = store.restore(file, numbers[-1])

    assert numbers == [5, 4, 3, 2, 1]
    assert found.calibration == {"gripper": JointCalibration(id=6)}, "replaced, not merged"
    assert store.restore(file).calibration["gripper"].homing_offset == 3


def test_restoring_takes_back_the_zeros_as_well(file):
    store.save(file, {"elbow_flex": ELBOW}, zeros={"elbow_flex": BY_STOPS})
    store.save(file, {"elbow_flex": JointCalibration(id=3)})
    assert store.read(file).zeros == {}

    assert store.restore(file).zeros["elbow_flex"].by == "stops"
    assert store.restore(file).zeros == {}


@pytest.mark.parametrize(
    ("number", "says"), [(None, "no earlier version"), (7, "no version 7 of .*choose one of.*1$")]
)
def test_a_version_that_is_not_there_is_an_error(file, number, says):
    store.save(file, {"elbow_flex": ELBOW})
    with pytest.raises(CalibrationError, match=says):
        store.restore(file, number)


def test_only_so_many_versions_are_kept(file):
    for offset in range(versions.KEPT + 3):
        zeros = {"elbow_flex": Zero(by="stops", angle=offset / 100)}
        entry = JointCalibration(id=3, homing_offset=offset)
        store.save(file, {"elbow_flex": entry}, zeros=zeros)
    kept = store.versions(file)
    store.save(file.parent.parent / "other" / file.name, {"gripper": JAW})  # has its own

    assert [version.number for version in kept] == list(range(versions.KEPT + 3, 3, -1))
    assert len(os.listdir(kept[0].path.parent)) == 2 * versions.KEPT + 1


# The module's data directory, which viam-server deletes


def test_a_calibration_comes_back_after_viam_server_deleted_it(module_file):
    store.save(module_file, {"elbow_flex": ELBOW}, zeros={"elbow_flex": BY_STOPS})
    before = store.read(module_file)
    delete(module_file)
    found = store.load(module_file)

    assert (found.calibration, found.zeros) == (before.calibration, before.zeros)
    assert store.load(module_file).notes == ()
    assert "was gone" in found.notes[0]
    assert "restored" in found.notes[0]


def test_a_file_of_the_published_module_has_a_second_copy_once_it_was_used(module_file):
    put(module_file, json.dumps({"gripper": JAW.to_json()}))
    assert store.read(module_file).calibration == {"gripper": JAW}
    assert store.versions(module_file) == ()

    store.load(module_file)
    delete(module_file)
    assert store.load(module_file).calibration == {"gripper": JAW}


def test_a_file_that_a_person_removed_elsewhere_stays_removed(file):
    store.save(file, {"gripper": JAW})
    file.unlink()
    with pytest.raises(CalibrationError, match=r"cannot be read.*calibration restore"):
        store.load(file)
    assert store.restore(file).calibration == {"gripper": JAW}


def test_a_file_that_was_spoiled_points_to_the_versions(module_file):
    store.save(module_file, {"gripper": JAW})
    put(module_file, "{")
    with pytest.raises(CalibrationError, match=r"not JSON.*so101 calibration restore"):
        store.load(module_file)

    assert store.restore(module_file).calibration == {"gripper": JAW}


def test_rubbish_is_not_brought_back(module_file):
    store.save(module_file, {"gripper": JAW})
    put(module_file, "{")
    store.restore(module_file)  # the rubbish is a version now
    put(module_file, "[")
    versions.keep(module_file, b"[", None)
    delete(module_file)

    assert store.load(module_file).calibration == {"gripper": JAW}


# Where


def test_relative_paths_lie_in_the_module_s_data_directory(tmp_path, monkeypatch):
    monkeypatch.setenv("VIAM_MODULE_DATA", str(tmp_path))
    assert store.resolve("arm.json") == tmp_path / "arm.json"
    assert store.resolve("/etc/arm.json").as_posix() == "/etc/arm.json"

    monkeypatch.delenv("VIAM_MODULE_DATA")
    monkeypatch.chdir(tmp_path)
    assert store.resolve("arm.json") == tmp_path / "arm.json"


@pytest.mark.parametrize("path", ["a\0b", "~nobody-of-this-name/arm.json"])
def test_an_invalid_path_is_refused(path):
    with pytest.raises(CalibrationError, match="cannot be a path"):
        store.resolve(path)


def test_versions_are_for_the_user_who_runs_the_program(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_DATA_HOME", "relative/does/not/count")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("sys.platform", "linux")
    assert versions.root() == tmp_path / ".local/share/so101_motion/calibrations"

    monkeypatch.setattr("sys.platform", "darwin")
    assert versions.root() == tmp_path / "Library/Application Support/so101_motion/calibrations"

    monkeypatch.setattr("sys.platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    assert versions.root() == tmp_path / "local/so101_motion/calibrations"


def test_a_calibration_that_is_in_its_place_is_saved_though_the_disk_is_full_by_then(
    file, monkeypatch
):
    store.save(file, {"elbow_flex": ELBOW}, zeros={"elbow_flex": BY_STOPS})
    moved = JointCalibration(id=3, homing_offset=9, range_min=940, range_max=3150)

    def fsync(opened):
        is_file = stat.S_ISREG(os.fstat(opened).st_mode)
        if is_file and b'"homing_offset": 9' in file.read_bytes():
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fsync)
    found = store.save(file, {"elbow_flex": moved}, zeros={"elbow_flex": BY_STOPS})
    assert store.read(file).calibration == found.calibration == {"elbow_flex": moved}
    assert "No space left" in " ".join(found.notes)
