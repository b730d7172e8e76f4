"""Time and memory to check and to convert an hour of a LeRobot data set.

Each run is a process of its own, imports included; the processor time of all its threads counts,
because on a shared machine the wall clock measures other programs too. The data set is made
up: 120 episodes of 30 s, actions and states of all six joints, one with a jump and one in which the
arm goes into the table; no videos, which are only copied.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common

_data: Any = _common.from_tests("harness.lerobot_data")

EPISODES, SECONDS = 120, 30.0


def made(folder: Path, fps: int, version: str) -> Path:
    """An hour in episodes."""
    n = round(SECONDS * fps)
    episodes = [_data.swing(n, fps, phase=0.1 * k) for k in range(EPISODES)]
    episodes[7][n // 2 :, 0] += 60.0
    episodes[11][:, 1:4] += np.hanning(n)[:, None] * [60.0, 20.0, 10.0]
    path: Path = _data.write_data_set(folder, episodes, version=version, fps=fps)
    return path


def run(*arguments: object) -> tuple[float, float, str]:
    """Call ``so101 dataset``: its processor time [s] and peak memory [byte], what it printed."""
    command = [sys.executable, "-m", "so101_motion.cli", "dataset", *map(str, arguments)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None
        printed = process.stdout.read()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 6):
        raise SystemExit(f"{' '.join(command)} ended with {process.returncode}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss * 1024.0, printed


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--times", type=int, default=3)
    asked = parser.parse_args()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name:
        for version, fps in (("v3.0", 30), ("v3.0", 60), ("v2.1", 30)):
            folder = Path(name) / f"{version}-{fps}"
            root = made(folder, fps, version)
            out, report = folder.with_name("new"), Path(name) / "report.html"
            units = ("--units", "model", "--json")
            verbs = {
                "check": ("check", root, *units),
                "check, with a report": ("check", root, *units, "--html", report),
                "convert": ("convert", root, out, *units, "--to", "old"),
            }
            for verb, arguments in verbs.items():
                took = []
                for _ in range(asked.times):
                    seconds, memory, printed = run(*arguments)
                    took.append(seconds)
                    if verb == "convert":
                        subprocess.run(["rm", "-r", str(out)], check=True)
                frames = json.loads(printed)["frames"]
                rows.append(
                    {
                        "what": f"{verb}, an hour of {version} at {fps} a second",
                        "frames": frames,
                        "median_s": float(np.median(took)),
                        "worst_s": max(took),
                        "bar_s": 10.0 if verb == "check" else None,
                        "peak_memory": memory,
                        "clock": "processor",
                    }
                )
    _common.write("bench_dataset", rows, peers=("pyarrow",))


if __name__ == "__main__":
    main()
