"""Find the best places on a table for the bases of two arms, each with a task of its own.

    python examples/place_base.py

The tasks are left.json and right.json beside this file. The bases are tried on a coarse lattice
here, so that it takes seconds; ``so101 sweep place left.json right.json --out placed`` does the
same on a finer lattice with all processors.
"""

import tempfile
from pathlib import Path

import numpy as np

from so101_motion.tasks.sweeps import PlaceSweep, Region, find_pairs, read_task, task_text

HERE = Path(__file__).parent


def main() -> None:
    """Look for pairs of bases, and say where they are."""
    sweeps = tuple(
        PlaceSweep(
            task=task_text(read_task(HERE / f"{name}.json")),
            region=Region(x=(0.0, 0.08), y=y, turn=(0.0, 0.0), spacing=0.08),
        )
        for name, y in (("left", (0.12, 0.2)), ("right", (-0.2, -0.12)))
    )
    with tempfile.TemporaryDirectory() as folder:
        found = find_pairs((sweeps[0], sweeps[1]), Path(folder) / "placed")
    for pair in found.best:
        left, right = (
            f"({1e3 * base.x:.0f}, {1e3 * base.y:.0f}) mm, {np.degrees(base.turn):.0f} deg"
            for base in pair.bases
        )
        print(f"left at {left}; right at {right}: {pair.time:.2f} s once around")


if __name__ == "__main__":
    main()
