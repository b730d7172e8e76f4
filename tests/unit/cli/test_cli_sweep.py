"""``so101 sweep``: what it prints, and that it resumes."""

import json

import pytest
from harness.command_line import refused


@pytest.fixture
def sweep(so101):
    return lambda *words: so101("sweep", *words)


def test_reach_ends_with_the_sha256_and_is_not_computed_twice(sweep, tmp_path):
    asked = ("reach", "--spacing-mm", "100", "--out", str(tmp_path / "atlas"), "--workers", "1")
    first = sweep(*asked)
    assert first.exit_code == 0, first.output
    assert "reachable volume" in first.stdout
    name, value = first.stdout.splitlines()[-1].split()
    assert (name, len(value)) == ("sha256", 64)
    second = json.loads(sweep(*asked, "--json").stdout)
    assert (second["computed"], second["sha256"]) == (0, value)
    assert "its payload is 0.0, and 0.1 is asked for" in refused(
        sweep(*asked, "--payload-g", "100")
    )


def test_workers_and_dask_exclude_each_other(sweep, tmp_path):
    assert "not both" in refused(
        sweep("reach", "--out", str(tmp_path), "--workers", "1", "--dask", "tcp://x:1")
    )


POSE = {"approach": [0, 0, -1], "approach_tolerance_deg": 15}
POSES = [
    {"name": name, "position_mm": [210, y, 60], **POSE}
    for name, y in (("left", 40), ("right", -40))
]
SMALL = ("--x-mm", "-40:0", "--y-mm", "0", "--turn-deg", "0")


def test_place_keeps_the_best_bases_with_their_programs(sweep, tmp_path):
    task, out = tmp_path / "task.json", tmp_path / "placed"
    task.write_text(json.dumps({"schema": "so101/task/1", "frame": "jaw_tip", "poses": POSES}))
    asked = ("place", str(task), *SMALL, "--out", str(out), "--workers", "1")
    done = sweep(*asked)
    assert done.exit_code == 0, done.output
    assert "2 of 2 bases reach every pose" in done.stderr
    assert done.stdout.splitlines()[-1].startswith("sha256 ")
    assert (out / "best" / "01.json").is_file()
    assert (out / "map.svg").is_file()


@pytest.mark.parametrize("given", ["a:b", "3:1", "1:2:3", "nan", "9e9"])
def test_an_invalid_region_is_refused(sweep, tmp_path, given):
    (tmp_path / "task.json").write_text("{}")
    assert "--x-mm" in refused(
        sweep("place", str(tmp_path / "task.json"), "--x-mm", given, "--out", str(tmp_path))
    )


def test_an_arm_that_is_not_in_the_cell_is_refused_with_those_that_are(sweep, tmp_path):
    task, cell = tmp_path / "task.json", tmp_path / "cell.json"
    task.write_text(json.dumps({"schema": "so101/task/1", "frame": "jaw_tip", "poses": POSES}))
    cell.write_text(json.dumps({"arms": [{"name": "left"}, {"name": "right"}]}))
    asked = ("place", str(task), "--cell", str(cell), "--out", str(tmp_path / "out"))
    wrong = sweep(*asked, "--arm", "middle")
    assert (wrong.exit_code, "left, right" in wrong.output) == (2, True)
    both = sweep(*asked, "--scene", str(cell))
    assert (both.exit_code, "not both" in both.output) == (2, True)
