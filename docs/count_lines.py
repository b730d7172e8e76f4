"""Count the lines of Python of each feature, for the table in architecture.md.

    python docs/count_lines.py [REVISION ...]

A column for each revision of git, by default the working tree's own commit. A file belongs to the
first feature with a pattern that its path matches; nothing is left out.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

PRODUCT = ("so101_motion", "viewer", "lerobot_robot_so101_motion")

FEATURES = {
    "pick and place": r"/pick|/things\.py",
    "several arms": r"cell|team|handover|together|bimanual|/among|/pace",
    "programs and guided paths": r"program|guid|viewer/teach/|requests/guided",
    "from the box to a calibrated arm": r"/calib|/setup|motor_|motors|doctor|torque_limit",
    "teleoperation": r"teleop|leader|leading",
    "data sets": r"dataset|/datasets/",
    "LeRobot plugin": r"^lerobot_robot",
    "sweeps and places of a base": r"/sweeps/|sweep|atlas|place",
    "emulator": r"emulat",
    "remote machine": r"viam/client/",
    "Viam": r"/viam/",
    "planning": r"/planning/",
    "servos, bus, rig": r"/drivers/|/rig/",
    "moving: arm and control": r"/arm/|/control/",
    "the page": r"^viewer/",
    "the command line": r"/cli/",
    "files and common": r"",
}


def lines_of(revision: str) -> tuple[Counter[str], Counter[str]]:
    """The lines and the files of each feature."""
    found = subprocess.run(
        ["git", "grep", "-c", "", revision, "--", *(f"{each}/*.py" for each in PRODUCT)],
        cwd=Path(__file__).parent.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    lines, files = Counter[str](), Counter[str]()
    for row in found.stdout.splitlines():
        path, _, count = row.removeprefix(f"{revision}:").rpartition(":")
        feature = next(name for name, pattern in FEATURES.items() if re.search(pattern, path))
        lines[feature] += int(count)
        files[feature] += 1
    return lines, files


def table(revisions: list[str]) -> str:
    """The table in Markdown: lines and, in brackets, files."""
    counted = [lines_of(each) for each in revisions]
    rows = [f"| feature | {' | '.join(revisions)} |", f"|---|{'---|' * len(revisions)}"]
    for name in sorted(FEATURES, key=lambda name: -counted[-1][0][name]):
        cells = (f"{lines[name]:,} ({files[name]})" for lines, files in counted)
        rows.append(f"| {name} | {' | '.join(cells)} |")
    sums = (f"{sum(lines.values()):,} ({sum(files.values())})" for lines, files in counted)
    return "\n".join([*rows, f"| all | {' | '.join(sums)} |"])


if __name__ == "__main__":
    print(table(sys.argv[1:] or ["HEAD"]))
