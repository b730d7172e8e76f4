"""Generate motions to learn from, and find those that would hit a table.

    python examples/motion_data.py 100

Each is planned, timed and verified, from one random configuration to another. ``so101 sweep
plans`` makes a million of them in the same way.
"""

import sys
import tempfile
from pathlib import Path

from so101_motion.files.scene_file import read_scene
from so101_motion.tasks.sweeps import (
    CheckSweep,
    PlansSweep,
    check_summary,
    episodes,
    plans_summary,
    run_sweep,
    scene_text,
)

TABLE = Path(__file__).parent / "table.json"


def main() -> None:
    """Make the motions, print the first, check all."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    with tempfile.TemporaryDirectory() as kept:
        motions, checked = Path(kept) / "motions", Path(kept) / "checked"
        run_sweep(PlansSweep(count=count), motions)
        print(plans_summary(motions))
        first = next(iter(episodes(motions)))
        print(f"the first has {len(first.action)} setpoints: {first.action[0].round(1)}, ...")
        run_sweep(CheckSweep.of(motions, scene_text(read_scene(TABLE))), checked)
        figures, _which = check_summary(checked)
        print(figures)


if __name__ == "__main__":
    main()
