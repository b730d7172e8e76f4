"""Bases for two arms that keep apart whenever each of them moves, the best pair first."""

import json

import numpy as np
import pytest

from so101_motion.common.errors import PlanningError
from so101_motion.files.cell_file import read_cell
from so101_motion.planning.collision.apart_at_any_timing import evenly, never_meet
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.tasks.program import files
from so101_motion.tasks.sweeps import PlaceSweep, Region, find_pairs, task_text, write_pairs
from so101_motion.tasks.sweeps.placement_task import task_from

DOWN = {"approach": [0, 0, -1], "approach_tolerance_deg": 15}


def work_at(y):
    poses = [
        {"name": name, "position_mm": [200, y + off, 60], **DOWN}
        for name, off in (("this", -20), ("that", 20))
    ]
    return task_text(task_from({"frame": "jaw_tip", "poses": poses}))


def at(*ys):
    return Region(x=(0.0, 0.0), y=(min(ys), max(ys)), turn=(0.0, 0.0), spacing=0.08)


LEFT = PlaceSweep(task=work_at(80), region=at(0.0, 0.16))
RIGHT = PlaceSweep(task=work_at(-80), region=at(-0.08))


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs") / "out"
    return find_pairs((LEFT, RIGHT), folder), folder


def test_the_arms_of_each_pair_keep_apart_wherever_they_are(found):
    pairs, _ = found
    bodies = bodies_of()
    assert pairs.best
    for pair in pairs.best:
        T = [
            sweep.region.base(base.lattice_index)
            for sweep, base in zip((LEFT, RIGHT), pair.bases, strict=True)
        ]
        at_poses = [
            evenly(bodies, np.column_stack([base.q, np.zeros(len(base.q))])) for base in pair.bases
        ]
        assert never_meet(bodies, bodies, T[0].inverse @ T[1], *at_poses)
        assert pair.time == max(base.time for base in pair.bases)
        assert pair.clearance == min(base.clearance for base in pair.bases)
    assert [pair.time for pair in pairs.best] == sorted(pair.time for pair in pairs.best)


def test_the_same_search_finds_the_same(found):
    pairs, folder = found
    assert find_pairs((LEFT, RIGHT), folder).sha256 == pairs.sha256


def test_each_pair_comes_with_its_programs_and_its_cell(found):
    pairs, folder = found
    write_pairs(pairs, (LEFT, RIGHT), folder, ("left", "right"))
    for name, base in zip(("left", "right"), pairs.best[0].bases, strict=True):
        program = files.read(folder / "best" / f"01-{name}.json")
        assert program.waypoints[0].q == pytest.approx(base.q[0], abs=1e-4)
        assert (folder / f"map-{name}.svg").is_file()
    cell = read_cell(folder / "best" / "01-cell.json")
    assert [each.name for each in cell.arms] == ["left", "right"]
    assert cell.arms[1].T_cell_base.p == pytest.approx([0.0, -0.08, 0.0])
    table = json.loads((folder / "placement.json").read_text())
    assert table["best"][0]["arms"]["right"]["y_mm"] == -80.0


def test_arms_that_would_meet_are_no_pair(tmp_path):
    near = PlaceSweep(task=work_at(40), region=at(0.04))
    with pytest.raises(PlanningError, match=r"none of \d+ pairs of bases keeps the arms 20 mm"):
        find_pairs((near, PlaceSweep(task=work_at(-25), region=at(-0.04))), tmp_path / "out")


def test_two_arms_cannot_go_to_the_same_place(tmp_path):
    with pytest.raises(PlanningError, match='"that" of the first task is 0 mm from "this"'):
        find_pairs((PlaceSweep(task=work_at(-120), region=at(0.0)), RIGHT), tmp_path / "out")
