"""Compare the best base that the placement search finds with the best of 100 times as much work.

The comparison draws bases of the same fine lattice at random and plans from each, until it has used
a hundred times the search's processor time: 45 minutes of one core for all three tasks. A run with
``--seconds`` ends earlier, the next one resumes it, and the rows say how far it came; ``--only
"pick and place"`` looks at one task, so that two cores have something to do.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import _common
from so101_motion.tasks.sweeps import PlaceSweep, Region, find_bases
from so101_motion.tasks.sweeps.place import COARSE, LatticeIndex

TIMES = 100.0
DRAWN = 64
KEPT = Path(tempfile.gettempdir()) / "so101-bench-place"
"""Kept results of a run that was ended early."""


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


def drawn(random: np.random.Generator) -> tuple[LatticeIndex, ...]:
    """Random bases of the fine lattice."""
    last = np.array(list(REGION.first_round())).max(axis=0)
    assert last.max() >= COARSE
    indices = random.integers(0, last + 1, (DRAWN, 4)).tolist()
    return tuple((x, y, z, turn) for x, y, z, turn in indices)


class RandomSearch:
    """Plans from random bases for a task, batch by batch; the state is kept in a file.

    Args:
        name: The task.
        folder: Where the file is.
    """

    def __init__(self, name: str, folder: Path) -> None:
        self._name, self._sweep = name, sweep_of(name)
        self._file = folder / f"{name}.json"
        if self._file.exists():
            self.known = json.loads(self._file.read_text())
        else:
            self.known = {"batches": 0, "spent": 0.0, "best": float("inf"), **self._found()}
            self._keep()

    @property
    def is_over(self) -> bool:
        """Whether it has used a hundred times the search's processor time."""
        return bool(self.known["spent"] >= TIMES * self.known["search"])

    def batch(self) -> None:
        """Look at one more batch of random bases of the fine lattice."""
        random = np.random.default_rng(self.known["batches"])
        begin = time.process_time()
        batch = replace(self._sweep, indices=drawn(random), planned=True)
        judge = batch.open()
        best = min(float(judge(shard)["time"].min()) for shard in range(batch.shards))
        self.known["best"] = min(self.known["best"], best)
        self.known["batches"] += 1
        self.known["spent"] += time.process_time() - begin
        self._keep()

    def row(self) -> _common.Row:
        """The row of the results."""
        known = self.known
        return {
            "what": self._name,
            "n": DRAWN * known["batches"],
            "screened in the first round": known["screened"],
            "planned": known["planned"],
            "processor time [s]": known["search"],
            "found, cycle time [s]": known["found"],
            "times as much": known["spent"] / known["search"],
            "best of that [s]": known["best"],
            "found / best": known["found"] / known["best"],
        }

    def _found(self) -> dict[str, float]:
        with tempfile.TemporaryDirectory() as folder:
            begin = time.process_time()
            placement = find_bases(self._sweep, Path(folder) / "out")
            spent = time.process_time() - begin
        return {
            "search": spent,
            "found": placement.best[0].time,
            "screened": len(placement.screened),
            "planned": placement.planned,
        }

    def _keep(self) -> None:
        self._file.write_text(json.dumps(self.known))


def main() -> None:
    """Run everything, or what an earlier run left of it, and write the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of processor time")
    parser.add_argument("--only", choices=TASKS, action="append", help="a task, again for more")
    wanted = parser.parse_args()
    _common.single_thread()
    KEPT.mkdir(exist_ok=True)
    searches = [RandomSearch(name, KEPT) for name in wanted.only or TASKS]
    while time.process_time() < wanted.seconds and not all(each.is_over for each in searches):
        # The one that is furthest from its end goes on, so that all are useful at any time.
        min(searches, key=lambda each: each.known["spent"] / each.known["search"]).batch()
    _common.update("bench_place", [each.row() for each in searches])


if __name__ == "__main__":
    main()
