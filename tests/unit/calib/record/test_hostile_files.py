"""Hostile calibration files are refused with a sentence; the campaign tries many more."""

import json
import os
import re

import pytest

from so101_motion.calib.record import store
from so101_motion.common.errors import CalibrationError
from so101_motion.files.json_file import LARGEST

PAN = {"id": 1, "drive_mode": 0, "homing_offset": -5, "range_min": 758, "range_max": 3292}
ENTRY = json.dumps(PAN)
ONE = json.dumps({"shoulder_pan": PAN})


def refused(file, data):
    file.write_bytes(data if isinstance(data, bytes) else data.encode())
    with pytest.raises(CalibrationError) as caught:
        store.read(file)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 600
    assert str(file) in message
    return message


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "is not JSON"),
        (b"\xff\xfe{\x00", "is not JSON"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0", "LFS pointer.*git lfs pull"),
        (f'{{"shoulder_pan": {ENTRY}}} and more', "is not JSON"),
        ("null", "not None"),
        ("[" * 900 + "]" * 900, "not \\[\\["),
        ("[" * 20_000, "nested deeper|is not JSON"),  # how deep Python reads differs
        ('{"shoulder_pan":' * 4_000, "nested deeper|is not JSON"),
        (" " * LARGEST + "{}", "larger than a calibration can be"),
        (f'{{"shoulder_pan": {ENTRY}, "shoulder_pan": {ENTRY}}}', "shoulder_pan: is in it twice"),
        ('{"shoulder_pan": {"id": 1, "id": 1}}', "shoulder_pan: id is given twice"),
        ('{"shoulder_pan": {"range_min": 1, "id": 1, "range_min": 2}}', "range_min is given twice"),
        (ONE.replace("758", "NaN"), "range_min must be .* nan"),
        (ONE.replace("758", "1e999"), "range_min must be .* inf"),
        (ONE.replace("758", "7" * 5000), "is not JSON"),
        (ONE.replace("758", "7" * 4000), "which is impossible"),
        (ONE.replace("758", '"\\ud800\\u202e"'), "range_min must"),
        (ONE.replace("758", json.dumps("x" * 9999)), "range_min"),
        ('{"motor_names": ["elbow_flex"], "homing_offset": [5]}', "of before June 2025"),
    ],
)
def test_files_of_all_kinds_are_refused_with_a_sentence(tmp_path, data, says):
    assert re.search(says, refused(tmp_path / "arm.json", data))


@pytest.mark.parametrize(
    "data",
    [
        b"\xef\xbb\xbf" + f'{{\r\n"shoulder_pan": {ENTRY}\r\n}}'.encode(),
        ONE.encode("utf-16"),
        json.dumps({"shoulder_pan": {name: float(v) for name, v in PAN.items()}}).encode(),
    ],
    ids=["a Windows editor", "UTF-16", "numbers as Viam writes them"],
)
def test_what_editors_and_viam_make_of_a_file_is_read(tmp_path, data):
    (tmp_path / "arm.json").write_bytes(data)
    assert store.read(tmp_path / "arm.json").calibration["shoulder_pan"].range_min == 758


@pytest.mark.parametrize("what", ["folder", "pipe", "nothing", "forbidden"])
def test_folders_pipes_and_unreadable_files_are_refused(tmp_path, what):
    path = tmp_path / "arm.json"
    if what == "folder":
        path.mkdir()
    elif what == "pipe":
        os.mkfifo(path)  # to open it would wait for ever
    elif what == "forbidden":
        path.write_text("{}")
        path.chmod(0)
        if os.access(path, os.R_OK):
            pytest.skip("nothing is forbidden to root")
    with pytest.raises(CalibrationError, match=r"arm\.json (is not a file|cannot be read)"):
        store.read(path)
