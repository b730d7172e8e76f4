"""Calibration files on the command line."""

import json

import pytest
from harness.command_line import refused

from so101_motion.calib.record import lerobot, store
from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.calib.record.zero import Zero


@pytest.fixture(autouse=True)
def own_home(tmp_path, monkeypatch):
    home = tmp_path / "home"
    monkeypatch.setenv("HOME", str(home))
    for name in ("VIAM_MODULE_DATA", "VIAM_HOME", "HF_HOME", "HF_LEROBOT_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(home / "lerobot"))
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")


def calibration(shift=0):
    return {
        joint: JointCalibration(
            id=place,
            range_min=900 + shift,
            range_max=2500 + shift,
            norm_mode=1 if place == 6 else 3,
        )
        for place, joint in enumerate(JOINTS, start=1)
    }


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "work" / "arm.json"
    store.save(path, calibration(), zeros={"elbow_flex": Zero(by="stops", angle=-0.1)})
    return path


@pytest.fixture
def run(so101):
    return lambda line: so101(f"calibration {line}")


def test_a_file_is_shown_with_what_its_zeros_mean_to_people_and_programs(run, file):
    result = run("show arm.json")
    assert result.exit_code == 0, result.output
    for words in (str(file), "elbow_flex", "by its stops", "at the jaws", "version 1"):
        assert words in result.stdout
    told = json.loads(run(f"show {file} --json").stdout)
    assert told["schema"] == "so101/calibration/1"
    assert told["calibration"]["gripper"]["range_max"] == 2500
    assert told["zeros"] == {"elbow_flex": {"by": "stops", "middle_deg": pytest.approx(-5.73)}}
    assert [one["joint"] for one in told["meaning"]] == [*JOINTS[:5], ""]
    assert [one["number"] for one in told["versions"]] == [1]


def test_all_files_are_listed_with_those_that_cannot_be_used(run, file):
    (file.parent / "odd.json").write_text('{"elbow_flex": {"id": "three"}}')
    result = run("show")
    assert str(file) in result.stdout
    assert "id must be a whole number" in result.stdout
    told = json.loads(run("show --json").stdout)["files"]
    assert [one["origin"] for one in told] == ["saved", "module folder"]
    assert len(told[0]["joints"]) == 6


def test_no_file_at_all_is_said(run):
    result = run("show")
    assert result.exit_code == 0
    assert "so101 calibrate makes one" in result.stderr


def test_two_files_are_compared(run, file, tmp_path):
    other = tmp_path / "work" / "other.json"
    store.save(other, {**calibration(), "gripper": calibration(40)["gripper"]})
    result = run("diff arm.json other.json")
    assert result.exit_code == 6
    assert "gripper: range_min is 900 in the file, 940 in other.json" in result.stdout
    assert "elbow_flex" not in result.stdout
    assert run("diff arm.json arm.json").exit_code == 0
    told = json.loads(run("diff arm.json other.json --json").stdout)
    assert sum(row["differs"] for row in told["rows"]) == 2
    assert told["missing"] == []
    store.save(other.with_name("less.json"), {"gripper": calibration()["gripper"]})
    result = run("diff arm.json less.json")
    assert result.exit_code == 6
    assert "elbow_flex: missing" in result.stdout


def test_the_same_on_stdout_or_in_a_file(run, file, tmp_path):
    told = run("export arm.json").stdout
    assert json.loads(told)["gripper"]["id"] == 6
    assert run("export arm.json --out there.json").exit_code == 0
    assert (tmp_path / "work" / "there.json").read_text() == told


def test_a_calibration_of_lerobot_is_taken_over(run, file, data, tmp_path):
    run("export arm.json --lerobot me")
    result = run(f"import {lerobot.path_for('me')} --json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["file"] == str(data / "me.json")
    assert store.read(data / "me.json").calibration == calibration()
    assert run("import arm.json --file copy.json").exit_code == 0
    assert (tmp_path / "work" / "copy.json").exists()


def test_a_files_former_content_comes_back(run, file):
    store.save(file, calibration(10))
    assert run("restore arm.json").exit_code == 0
    assert store.read(file).calibration == calibration()
    result = run("restore arm.json --number 2 --json")
    assert json.loads(result.stdout)["calibration"]["gripper"]["range_max"] == 2510


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        ("show none.json", 6, "none.json"),
        ("restore none.json", 6, "calibrate the arm"),
        ("restore arm.json --number 77", 6, "no version 77"),
        ("export arm.json --lerobot a/b", 2, "plain name"),
        ("export arm.json --lerobot a --out b", 2, "either"),
        ("export none.json", 6, "none.json"),
        ("import none.json", 6, "none.json"),
        ("diff", 2, "FILE"),
        ("diff arm.json --port /dev/no-such-port", 3, "no such port"),
    ],
)
def test_a_mistake_with_files_is_a_sentence_and_an_exit_code(run, file, arguments, code, says):
    assert says in refused(run(arguments), code)


def test_what_would_be_saved_is_shown_and_nothing_is_written(run, file, tmp_path):
    store.save(file, calibration(10))
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    result = run("restore arm.json --dry-run")
    assert result.exit_code == 0, result.output
    assert "gripper: range_max 2510 -> 2500" in result.stderr
    told = json.loads(run("restore arm.json --dry-run --json").stdout)
    assert told["dry_run"] is True
    assert {(one["now"], one["then"]) for one in told["changes"]} == {(910, 900), (2510, 2500)}
    result = run("import arm.json --file copy.json --dry-run")
    assert "there is no usable file yet" in result.stderr
    result = run("import arm.json --file arm.json --dry-run")
    assert "the file is the same now" in result.stderr
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
