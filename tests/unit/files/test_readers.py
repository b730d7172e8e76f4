"""What the readers of our files refuse: format, wrong value, sentence.

Calibrations are tried in ``tests/unit/calib/record/test_hostile_files.py``, data sets beside their
reader; the campaign tries many more.
"""

import json
import os

import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.files.cell_file import read_cell
from so101_motion.files.saved_poses import SavedPoses
from so101_motion.files.scene_file import read_scene
from so101_motion.files.user_storage import LARGEST
from so101_motion.tasks.guided import files as guided_files
from so101_motion.tasks.program import files as program_files

JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
REST = [0] * 5

FORMATS = {
    "scene": (read_scene, {}),
    "cell": (read_cell, {"arms": [{"name": "a"}]}),
    "guided path": (
        guided_files.read,
        {
            "schema": "so101/guided-path/1",
            "joints": JOINTS,
            "time_s": [0.0, 0.5, 1.25],
            "q_deg": [REST, [10, *REST[1:]], REST],
            "aperture_percent": [25, 50, 100],
        },
    ),
    "program": (
        program_files.read,
        {
            "schema": "so101/program/1",
            "waypoints": [{"name": "a", "q_deg": REST}, {"name": "b", "q_deg": [9, *REST[1:]]}],
        },
    ),
    "steps": (
        program_files.read,
        {"schema": "so101/program/3", "steps": [{"left": {"q_deg": REST}}]},
    ),
    "steps of a cell": (
        program_files.read,
        {"schema": "so101/cell-program/1", "steps": [{"left": {"q_deg": REST}}]},
    ),
    "poses": (lambda path: SavedPoses(path).own(), {"schema": "so101/poses/1", "poses": []}),
}
"""The reader, and what it reads."""


def thing(**entry):
    return {"obstacles": [{"name": "a", **entry}]}


def held(**entry):
    return {"attached": [{"name": "a", "box_mm": [1, 1, 1], **entry}]}


def stop_at(**entry):
    return {"waypoints": [{"name": "a", "q_deg": REST, **entry}]}


def pose(**entry):
    return {"poses": [{"name": "a", "q_deg": REST, **entry}]}


HUGE = 10**400
HUGE_FILE = "huge"
NAN = float("nan")
TRIANGLE = {"vertices_mm": [[0, 0, 0]], "triangles": [[0, 0, 9]]}

TABLE = [
    ("scene", {"obstacle": []}, 'did you mean "obstacles"'),
    ("scene", {"obstacles": {}}, "must be a list"),
    ("scene", {"obstacles": ["mug"]}, r"obstacles\[0\]"),
    ("scene", thing(box=[1, 1, 1]), 'of "a"'),
    ("scene", thing(), "exactly one form"),
    ("scene", thing(box_mm=[1, 2, 3], sphere_radius_mm=3), "one form"),
    ("scene", thing(box_mm=[10, -1, 10]), '"box_mm"'),
    ("scene", thing(sphere_radius_mm=-1), '"sphere_radius_mm"'),
    ("scene", thing(box_mm=[10, NAN, 10]), "finite"),
    ("scene", thing(box_mm=[10, 10]), "three numbers"),
    ("scene", {"obstacles": [{"box_mm": [10, 10, 10]}]}, "needs a name"),
    ("scene", {"obstacles": [{"name": "floor", "box_mm": [10, 10, 10]}]}, "there twice"),
    ("scene", thing(sphere_radius_mm=10, position_mm=[1e9, 0, 0]), "a"),
    ("scene", thing(capsule_radius_mm=10), "capsule_length_mm"),
    ("scene", thing(capsule_radius_mm=10, capsule_length_mm=5), "twice its radius, 20 mm"),
    ("scene", thing(points_mm=[[1, 2]]), "triples"),
    ("scene", thing(points_mm=[[HUGE, 0, 0]]), "points_mm"),
    ("scene", thing(mesh_file="not-there.stl"), r"not-there\.stl"),
    ("scene", thing(**TRIANGLE), "1"),
    ("scene", thing(**TRIANGLE | {"triangles": [[0, 0, 0.5]]}), "numbers of vertices"),
    ("scene", thing(**TRIANGLE | {"triangles": [[HUGE, 0, 0]]}), "triangles"),
    ("scene", held(mass_kg=-1), "mass_kg"),
    ("scene", held(mass_kg=9), "mass_kg"),
    ("scene", {"may_touch": [["a"]]}, "list of pairs"),
    ("scene", {"floor_z_mm": "low"}, "must be a number"),
    ("scene", {"margin_mm": 0}, '"margin_mm"'),
    ("cell", {"arms": []}, "at least one arm"),
    ("cell", {"arms": [{"port": "/dev/x"}]}, "needs a name"),
    ("cell", {"arms": [{"name": "a"}, {"name": "a"}]}, "twice"),
    ("cell", {"arms": [{"name": "a", "port": "p"}, {"name": "b", "port": "p"}]}, "twice"),
    ("cell", {"arms": [{"name": "a", "prot": "p"}]}, "port"),
    ("cell", {"arms": [{"name": "a", "position_mm": [1, 2]}]}, "position_mm"),
    ("cell", {"scenes": {}}, "scene"),
    ("cell", {"scene": held(box_mm=[20, 20, 20])}, "held by an arm"),
    ("guided path", {"schema": "so101/guided-path/3"}, "which this version cannot read"),
    ("guided path", {"schema": "so101/scene/1"}, "is not a guided path file"),
    ("guided path", {"joints": ["shoulder_pan"]}, "in this order"),
    ("guided path", {"time_s": [0.0, 0.5]}, "2 times, 3 configurations"),
    ("guided path", {"time_s": [0.0, 0.5, 0.5]}, "increase"),
    ("guided path", {"q_deg": [REST, [0]]}, "q_deg"),
    ("guided path", {"q_deg": [[*REST[1:], NAN]] * 3}, "finite"),
    ("guided path", {"aperture_percent": [0, 0, 200]}, "aperture"),
    ("guided path", {"aperture_percent": "open"}, "aperture_percent"),
    ("program", {"steps": []}, "are the same; leave one out"),
    ("program", {"schema": "so101/program/9"}, "this version cannot read"),
    ("program", {"rounds": 0}, "rounds"),
    ("program", {"rounds": True}, "whole number"),
    ("program", {"rounds": "forever"}, '"endless"'),
    ("program", {"rounds": 2.5}, "whole number"),
    ("program", {"laps": 3}, "unknown entry of a program"),
    ("program", {"loops": 3}, "must be a list such as"),
    ("program", {"loops": [3]}, 'loop 1.*must be {"from"'),
    ("program", {"loops": [{"from": 1, "to": 2}]}, "loop 1: times"),
    ("program", {"loops": [{"from": 0, "to": 2, "times": 2}]}, "loop 1: from"),
    ("program", {"loops": [{"from": 1, "to": 3, "times": 2}]}, "within the program's 2 steps"),
    ("program", {"waypoints": {}}, "must be a list"),
    ("program", stop_at(q_deg=[0] * 4), "waypoint 1: q_deg"),
    ("program", stop_at(q_deg=[HUGE] * 5), "joint angles"),
    ("program", stop_at(pause_s=-1), "waypoint 1: pause"),
    ("program", stop_at(pause_s="1"), "must be a number"),
    ("program", stop_at(pause=1), '"pause_s"'),
    ("program", stop_at(**{"pass": 1}), "1: pass.*true or false"),
    (
        "program",
        stop_at(**{"pass": True, "pause_s": 1}),
        "waypoint 1: pass.*a pause, for which the arm has to stop; leave one out",
    ),
    ("program", stop_at(aperture_percent=120), "waypoint 1: aperture"),
    *(
        (schema, {"steps": steps}, says)
        for schema in ("steps", "steps of a cell")
        for steps, says in (
            ({}, "must be a list of steps"),
            ([{}], "names no arm"),
            ([["left"]], "step 1"),
            ([{"left": {"q_deg": [1, 2]}}], "step 1: left: q_deg"),
            ([{"left": {"q_deg": REST, "pass": True}, "right": {"q_deg": REST}}], "be passed"),
        )
    ),
    ("poses", {"schema": "so101/poses/3"}, "this version cannot read"),
    ("poses", {"poses": None}, "must be a list"),
    ("poses", {"poses": [3]}, "pose 1"),
    ("poses", pose(q_deg=[1]), "five joint"),
    ("poses", pose(name=""), "type a name first"),
]


def refused(read, path, content, says):
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    if content == HUGE_FILE:
        os.truncate(path, 100 * LARGEST)  # holes, which take no time to write
    with pytest.raises(ConfigError, match=says) as caught:
        read(path)
    assert len(str(caught.value)) < 800


@pytest.mark.parametrize("name", FORMATS)
def test_each_reader_reads_what_the_wrong_values_are_put_into(tmp_path, name):
    read, good = FORMATS[name]
    (tmp_path / "it.json").write_text(json.dumps(good))
    read(tmp_path / "it.json")


@pytest.mark.parametrize(("name", "change", "says"), TABLE)
def test_a_wrong_value_is_refused_with_a_sentence(tmp_path, name, change, says):
    read, good = FORMATS[name]
    refused(read, tmp_path / "it.json", good | change, says)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "is not JSON"),
        ("[]", "must be an object|schema"),
        ("version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        ("[" * 100_000, "is not JSON"),
        (HUGE_FILE, "more than|larger than"),
    ],
    ids=["cut off", "a list", "a pointer", "nested", "large"],
)
def test_what_is_no_file_of_ours_at_all_is_refused_with_a_sentence(tmp_path, name, text, says):
    refused(FORMATS[name][0], tmp_path / "it.json", text, says)


@pytest.mark.parametrize("name", ["scene", "cell"])
def test_a_file_that_is_not_there_is_named(tmp_path, name):
    with pytest.raises(ConfigError, match=r"it\.json.*cannot be read"):
        FORMATS[name][0](tmp_path / "it.json")
