"""Print a map of where the arm reaches at one height, with 100 g and the tool pointing down.

    python examples/reach_map.py 20

Makes a small atlas of the reach (a few seconds) and asks it: ``.`` is out of reach, a digit says
how many tenths of what a servo may hold are left.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from so101_motion.tasks.sweeps import Atlas, ReachSweep, run_sweep

SPACING = 0.02


def main() -> None:
    """Make the atlas, and draw it."""
    height = float(sys.argv[1]) / 1000.0 if len(sys.argv) > 1 else 0.02
    with tempfile.TemporaryDirectory() as folder:
        sweep = ReachSweep(spacing=SPACING, frame="jaw_tip", approach=(0.0, 0.0, -1.0), payload=0.1)
        run_sweep(sweep, Path(folder) / "atlas")
        atlas = Atlas.read(Path(folder) / "atlas")
    print(f"100 g, from above, jaw tip {height * 1000:.0f} mm over the base; the arm looks up")
    for x in np.arange(0.36, -0.2, -SPACING).tolist():
        row = [atlas.at(x, y, height) for y in np.arange(0.36, -0.37, -SPACING).tolist()]
        print("".join(str(int(10 * r.torque_left)) if r.reachable else "." for r in row))


if __name__ == "__main__":
    main()
