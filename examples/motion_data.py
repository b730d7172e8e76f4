"""Generate motions to learn from, which keep off a table.

    python examples/motion_data.py 100

Each is planned, timed and verified, from one random configuration to another. ``so101 sweep
plans`` makes a million of them in the same way.
"""

import sys
import tempfile
from pathlib import Path

from so101_motion.files.scene_file import read_scene
from so101_motion.tasks.sweeps import (
    PlansSweep,
    episodes,
    plans_summary,
    run_sweep,
    scene_text,
)

TABLE = Path(__file__).parent / "table.json"


def main() -> None:
    """Make the motions and print the first."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    with tempfile.TemporaryDirectory() as kept:
        motions = Path(kept) / "motions"
        run_sweep(PlansSweep(count=count, scenes=(scene_text(read_scene(TABLE)),)), motions)
        print(plans_summary(motions))
        first = next(iter(episodes(motions)))
        print(f"the first has {len(first.action)} setpoints: {first.action[0].round(1)}, ...")


if __name__ == "__main__":
    main()
