"""Hold foam, wood, or nothing for ten minutes: how steady the grip is, and how warm it gets.

A jaw of an emulated arm whose servos differ (spread 0.2) closes in a room of 30 degC and holds for
ten minutes on the simulated clock. The torque is what the thing presses back with, by the emulator;
once a second it is written down, from a second after the grab on.

The heat of a servo is modelled coarsely, see ``electric.py``: the loss in the winding warms one
mass with one time constant. Its figures come from one published endurance test and from reports of
users; a winding that gets warm has the same resistance, so heat does not change the force. The
stiffness of foam and wood was chosen, too: no thing was measured.
"""

from __future__ import annotations

import argparse
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common
from so101_motion.drivers.emulator.hand import jaw_angle_for_gap
from so101_motion.drivers.feetech.servo_judgement import HOT_C, WARM_C

ROOM_C = 30.0
WIDTH = 0.03
"""Width of the object [m]."""

SECONDS = 600.0
THINGS = {"nothing": 0.0, "foam": 5.0, "wood": 600.0}
"""What is held, and how stiff it is [N m/rad at the jaw]; chosen."""

_harness: Any = _common.from_tests("harness.emulated_rig")
_referee: Any = _common.from_tests("referee.official")


def held(seed: int, stiffness: float) -> tuple[list[float], float, float, bool]:
    """Grip and hold; torques [N m], the highest temperature [degC], duty, and if it still holds."""
    with (
        _referee.refereed(("motion",)),
        tempfile.TemporaryDirectory() as folder,
        _harness.hardware_bench(Path(folder), reply_timeout=2.0, spread=0.2, seed=seed) as bench,
    ):
        rig = bench.open()
        bench.advance(0.5)
        bench.finish(rig.gripper.move(0.8, wait=False))
        for servo in bench.world.servos:
            servo.drive.motor.ambient = servo.drive.motor.temperature = ROOM_C
        if stiffness:
            bench.world.put_object(WIDTH, stiffness)
        bench.finish(rig.gripper.grab(wait=False))
        bench.advance(1.0)
        torques: list[float] = []
        jaw = bench.world.servo("gripper").drive
        while len(torques) < SECONDS:
            bench.advance(1.0)
            depth = max(jaw_angle_for_gap(WIDTH) - bench.world.q[5], 0.0)
            torques.append(float(stiffness * depth))
        return torques, jaw.motor.temperature, abs(jaw.duty), rig.gripper.is_holding


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arms", type=int, default=4)
    arms = range(parser.parse_args().arms)
    rows: list[dict[str, Any]] = []
    for thing, stiffness in THINGS.items():
        pieces = {f"{thing}: {seed}": partial(held, seed, stiffness) for seed in arms}
        found = _common.in_pieces("bench_grip", pieces)
        torques = np.array([each[0] for each in found])
        drift = torques[:, -60:].mean(axis=1) - torques[:, :60].mean(axis=1)
        rows.append(
            {
                "what": f"{thing}, {len(found)} jaws, {SECONDS / 60.0:g} min, {ROOM_C:g} degC room",
                "torque [N m]": f"{torques.min():.2f} to {torques.max():.2f}",
                "largest deviation of one [N m]": float(torques.std(axis=1).max()),
                "largest drift of one [N m]": float(np.abs(drift).max()),
                "largest drive": max(each[2] for each in found),
                "warmest at the end [degC]": max(each[1] for each in found),
                "said to be warm, hot from [degC]": f"{WARM_C}, {HOT_C}",
                "still holding": sum(each[3] for each in found),
            }
        )
        print(rows[-1])
    _common.write("bench_grip", rows)


if __name__ == "__main__":
    main()
