"""Broken and hostile calibration files are refused with a sentence."""

import json
import os
import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from so101_motion.calib.record import store, zero
from so101_motion.calib.record.record import FIELDS, JOINTS, check
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
        (b"\x80\x04\x95\x00", "is not JSON"),
        ("{'shoulder_pan': 1}", "is not JSON"),
        (f'{{"shoulder_pan": {ENTRY}', "is not JSON"),
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
        (ONE.replace("758", "-Infinity"), "range_min must be"),
        (ONE.replace("758", "1e999"), "range_min must be .* inf"),
        (ONE.replace("758", "7" * 5000), "is not JSON"),
        (ONE.replace("758", "7" * 4000), "which is impossible"),
        (ONE.replace("758", '"\\ud800\\u202e"'), "range_min must"),
        (ONE.replace("758", json.dumps("x" * 9999)), "range_min"),
        ('{"motor_names": 5, "homing_offset": 5}', "motor_names must be a list"),
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


values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.integers(-10, 4100)
    | st.floats()
    | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(FIELDS) | st.text(max_size=3), inner, max_size=7)
    ),
    max_leaves=12,
)
entries = st.fixed_dictionaries(
    {name: st.integers(-10, 4100) | values for name in FIELDS[1:5]} | {"id": st.integers(0, 7)}
)
contents = (
    values
    | st.dictionaries(st.sampled_from(JOINTS), entries | values, max_size=6)
    | st.fixed_dictionaries(
        {
            name: st.lists(st.integers(-5000, 5000) | values, max_size=6) | values
            for name in ("homing_offset", "drive_mode", "start_pos", "end_pos", "calib_mode")
        }
        | {"motor_names": st.lists(st.sampled_from(JOINTS), max_size=6) | values}
    )
)


def outcome(file):
    try:
        return store.read(file), None
    except CalibrationError as error:
        return None, error


def read_or_refused(file):
    """A file is read into what can be true, or refused with words; never anything else."""
    found, refusal = outcome(file)
    if refusal is not None:
        assert refusal.next_step
        assert str(refusal).isprintable()
    else:
        check(found.calibration)
        assert set(found.zeros) <= set(found.calibration)


@given(contents)
@example({"shoulder_pan": {**PAN, "range_min": float("nan")}})
def test_any_json_is_read_or_refused_with_words(tmp_path_factory, content):
    file = tmp_path_factory.getbasetemp() / "any.json"
    file.write_text(json.dumps(content))

    read_or_refused(file)


@given(st.data())
def test_a_calibration_with_some_bytes_changed_or_lost_is_read_or_refused(tmp_path_factory, data):
    file = tmp_path_factory.getbasetemp() / "spoiled.json"
    text = bytearray(json.dumps({"shoulder_pan": PAN, "gripper": {**PAN, "id": 6}}).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(text) - 1))
        text[place : place + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=2))
    file.write_bytes(text)

    read_or_refused(file)


@given(contents)
def test_any_json_beside_a_calibration_is_read_or_noted(tmp_path_factory, content):
    file = tmp_path_factory.getbasetemp() / "any.zero.json"
    file.write_text(json.dumps({"joints": content}))
    calibration = {"shoulder_pan": store.record.parse({"shoulder_pan": PAN})["shoulder_pan"]}
    zeros, notes = zero.read_zeros(file, calibration)

    assert not (zeros and notes)
    assert all(note.isprintable() for note in notes)
