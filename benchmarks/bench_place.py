"""Placement: the best base that a search finds, beside the best of a hundred times as much work.

The long way knows no bounds: it draws bases of the same fine lattice at random and plans from each,
until it has used a hundred times the search's processor time.
"""

from __future__ import annotations

import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import _common
from so101_motion.tasks.sweeps import PlaceSweep, Region, find_bases
from so101_motion.tasks.sweeps.mounting import COARSE, Cell

TIMES = 100.0
DRAWN = 256


def _pose(name: str, x: float, y: float, z: float, **rest: object) -> dict[str, object]:
    return {"name": name, "position_mm": [x, y, z], **rest}


DOWN = {"approach": [0, 0, -1], "approach_tolerance_deg": 15}
TASKS = {
    "pick and place": [
        _pose("over", 200, 100, 100, **DOWN),
        _pose("pick", 200, 100, 40, aperture_percent=0, **DOWN),
        _pose("over box", 200, -120, 100, **DOWN),
        _pose("drop", 200, -120, 50, aperture_percent=50, **DOWN),
    ],
    "three around a wall": [
        _pose("left", 220, 120, 80, **DOWN),
        _pose("far", 290, 0, 120),
        _pose("right", 220, -120, 80, **DOWN),
    ],
    "along a shelf": [
        _pose(f"bin {k}", 250, y, 140, approach=[1, 0, -0.3], approach_tolerance_deg=20)
        for k, y in enumerate((-120, 0, 120), 1)
    ],
}
WALL = {"name": "wall", "box_mm": [120, 20, 80], "position_mm": [240, 60, 40]}
SCENES = {
    "pick and place": [],
    "three around a wall": [WALL],
    "along a shelf": [{"name": "board", "box_mm": [120, 400, 10], "position_mm": [320, 0, 100]}],
}
REGION = Region(x=(-0.1, 0.1), y=(-0.12, 0.12), turn=(-1.1, 1.1), spacing=0.04, turn_step=0.55)


def sweep_of(name: str) -> PlaceSweep:
    """One of the tasks, as a sweep."""
    task = {"schema": "so101/task/1", "frame": "jaw_tip", "poses": TASKS[name]}
    scene = json.dumps({"obstacles": SCENES[name]})
    return PlaceSweep(task=json.dumps(task), region=REGION, scene=scene)


def drawn(random: np.random.Generator) -> tuple[Cell, ...]:
    """Random bases of the fine lattice."""
    last = np.array(list(REGION.cells())).max(axis=0)
    assert last.max() >= COARSE
    cells = random.integers(0, last + 1, (DRAWN, 4)).tolist()
    return tuple((x, y, z, turn) for x, y, z, turn in cells)


def long_way(sweep: PlaceSweep, seconds: float) -> tuple[float, int]:
    """The best time [s] of so many seconds of processor time, and how many bases that were."""
    random, best, looked = np.random.default_rng(0), np.inf, 0
    begin = time.process_time()
    while time.process_time() - begin < seconds:
        batch = replace(sweep, cells=drawn(random), planned=True)
        judge = batch.open()
        for shard in range(batch.shards):
            best = min(best, float(judge(shard)["time"].min()))
        looked += DRAWN
    return best, looked


def main() -> None:
    """Run everything and write the result."""
    _common.single_thread()
    rows: list[_common.Row] = []
    for name in TASKS:
        sweep = sweep_of(name)
        with tempfile.TemporaryDirectory() as folder:
            begin = time.process_time()
            placement = find_bases(sweep, Path(folder) / "out")
            spent = time.process_time() - begin
        found = placement.best[0].time
        best, looked = long_way(sweep, TIMES * spent)
        row: _common.Row = {
            "what": name,
            "n": looked,
            "screened in the first round": len(placement.screened),
            "planned": placement.planned,
            "processor time [s]": spent,
            "found, cycle time [s]": found,
            "best of 100 times as much [s]": best,
            "found / best": found / best,
        }
        print(row)
        rows.append(row)
    _common.write("bench_place", rows)


if __name__ == "__main__":
    main()
