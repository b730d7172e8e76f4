"""Find the best places on a table for the base of an arm that has a task.

    python examples/place_base.py

The task is task.json beside this file. The bases are tried on a coarse lattice here, so that it
takes seconds; ``so101 sweep place task.json --out placed`` does the same on a finer lattice with
all processors.
"""

import tempfile
from pathlib import Path

import numpy as np

from so101_motion.tasks.sweeps import PlaceSweep, Region, find_bases, read_task, task_text

TASK = Path(__file__).parent / "task.json"


def main() -> None:
    """Look for bases, and say where they are."""
    region = Region(x=(0.0, 0.08), y=(0.12, 0.2), turn=(0.0, 0.0), spacing=0.08)
    sweep = PlaceSweep(task=task_text(read_task(TASK)), region=region)
    with tempfile.TemporaryDirectory() as folder:
        found = find_bases(sweep, Path(folder) / "placed")
    for base in found.best:
        print(
            f"({1e3 * base.x:.0f}, {1e3 * base.y:.0f}) mm, {np.degrees(base.turn):.0f} deg:"
            f" {base.time:.2f} s once around"
        )


if __name__ == "__main__":
    main()
