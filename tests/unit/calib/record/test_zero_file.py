import json
import re
from dataclasses import replace

import pytest

from so101_motion.calib.record import zero
from so101_motion.calib.record.record import JointCalibration
from so101_motion.calib.record.zero import Zero

ELBOW = JointCalibration(id=3, homing_offset=5, range_min=948, range_max=3146)
PAN = JointCalibration(id=1, homing_offset=-1470, range_min=758, range_max=3292)
BOTH = {"elbow_flex": ELBOW, "shoulder_pan": PAN}
ZEROS = {"elbow_flex": Zero(by="stops", angle=-0.1), "shoulder_pan": Zero(by="pose", angle=0.07)}


@pytest.fixture
def file(tmp_path):
    return tmp_path / "arm.zero.json"


def test_a_written_file_reads_back_the_same(file):
    file.write_bytes(zero.zeros_text((BOTH, ZEROS)))
    zeros, notes = zero.read_zeros(file, BOTH)

    assert {joint: zero.by for joint, zero in zeros.items()} == {
        "elbow_flex": "stops",
        "shoulder_pan": "pose",
    }
    assert zeros["elbow_flex"].angle == pytest.approx(-0.1, abs=1e-6)
    assert notes == ()


def test_no_file_knows_no_zeros(file):
    assert zero.read_zeros(file, BOTH) == ({}, ())


def test_nothing_known_is_no_file():
    assert zero.zeros_text((BOTH, {})) == b""


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
    new, new_zeros = (
        {"elbow_flex": replace(ELBOW, range_min=900)},
        {"elbow_flex": Zero(by="pose", angle=0.5)},
    )
    file.write_bytes(zero.zeros_text((BOTH, ZEROS), (new, new_zeros)))

    assert zero.read_zeros(file, BOTH)[0]["elbow_flex"].by == "stops"
    assert zero.read_zeros(file, new)[0]["elbow_flex"].by == "pose"


def test_a_new_zero_for_the_same_numbers_counts(file):
    file.write_bytes(
        zero.zeros_text((BOTH, ZEROS), (BOTH, {"elbow_flex": Zero(by="pose", angle=0)}))
    )

    assert zero.read_zeros(file, BOTH)[0]["elbow_flex"].by == "pose"


ENTRY = {"drive_mode": 0, "homing_offset": 5, "range_min": 948, "range_max": 3146}


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("{", "not JSON"),
        ([], 'no "joints"'),
        ({"joints": []}, 'no "joints"'),
        ({"joints": {"elbow_flex": 5}}, "elbow_flex: its zeros must be a list"),
        ({"joints": {"elbow_flex": [5]}}, "elbow_flex: its zeros must be a list"),
        (
            {"joints": {"elbow_flex": [ENTRY]}},
            'elbow_flex: "by" is stops or pose or middle or homing, not None',
        ),
        ({"joints": {"elbow_flex": [{**ENTRY, "by": "luck"}]}}, "not 'luck'"),
        (
            {"joints": {"elbow_flex": [{**ENTRY, "by": "stops"}]}},
            '"middle_deg": must be a number from -180 to 180',
        ),
        (
            {"joints": {"elbow_flex": [{**ENTRY, "by": "stops", "middle_deg": float("nan")}]}},
            '"middle_deg" = nan: must be a finite',
        ),
        (
            {"joints": {"elbow_flex": [{**ENTRY, "by": "stops", "middle_deg": 181}]}},
            '"middle_deg" = 181: out of range; must be a number from -180 to 180',
        ),
        (
            {"joints": {"elbow_flex": [{**ENTRY, "by": "stops", "middle_deg": 10**400}]}},
            '"middle_deg" = 1000.*must be a finite number from -180 to 180',
        ),
    ],
)
def test_a_spoiled_file_is_not_used_and_that_is_said(file, content, says):
    file.write_text(content if isinstance(content, str) else json.dumps(content))
    zeros, notes = zero.read_zeros(file, BOTH)

    assert zeros == {}
    assert len(notes) == 1
    assert re.search(says, notes[0])
    assert "middle of each travel" in notes[0]
