"""How well the emulated arm follows planned paths: random paths through four waypoints.

Planner, executor, driver and bus are the real ones, the servos are emulated, with the arm's weight,
friction and play. One clock drives all, so the machine's speed does not matter and a run can be
repeated to the last bit, as long as the emulator answers within two seconds.

Angles are the joints' true ones. A joint's distance from its path is measured after
the lag of the whole motion, one figure for all joints that fits best, has been removed.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common

SPEEDS = ((50, 100), (90, 300), (120, 500), (180, 500))
"""Caps of speed and acceleration [deg/s], [deg/s^2]; the first is the default."""

PLANS = 50

_following: Any = _common.from_tests("harness.path_following")
_harness: Any = _common.from_tests("harness.emulated_rig")
_referee: Any = _common.from_tests("referee.official")


def followed(speed: float, acceleration: float) -> list[Any]:
    """Plan and follow random paths at these caps."""
    with (
        _referee.refereed(),
        tempfile.TemporaryDirectory() as folder,
        _harness.hardware_bench(Path(folder), reply_timeout=2.0) as bench,
    ):
        rig = bench.open()
        bench.advance(1.0)
        rig.arm.set_speed(math.radians(speed))
        rig.arm.set_acceleration(math.radians(acceleration))
        return [
            _following.follow(bench, rig, *_following.random_plan(rig, seed))
            for seed in range(PLANS)
        ]


def main() -> None:
    """Measure, print and write the results."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    _common.single_thread()
    rows: list[dict[str, Any]] = []
    for speed, acceleration in SPEEDS:
        results = followed(speed, acceleration)
        row: dict[str, Any] = {
            "what": f"{speed} deg/s, {acceleration} deg/s^2",
            "n": len(results),
            "lag [s]": float(np.median([one.lag for one in results])),
        }
        for name, title in (
            ("error", "off the way"),
            ("missed", "off a waypoint"),
            ("final", "off the end"),
        ):
            values = [getattr(one, name) for one in results]
            row[f"{title}, median [deg]"] = float(np.median(values))
            row[f"{title}, worst [deg]"] = max(values)
        rows.append(row)
    rows.append(
        {
            "what": "bar",
            "off the way, worst [deg]": 3.0,
            "off a waypoint, worst [deg]": 3.0,
            "off the end, worst [deg]": 0.3,
        }
    )
    _common.write("bench_follow", rows)


if __name__ == "__main__":
    main()
