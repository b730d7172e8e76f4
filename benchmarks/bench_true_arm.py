"""Following and resting of emulated arms that differ, with a load that the driver does not know.

Every arm has servos of its own (spread 0.2: friction, play, torque, dead time, zero), holds 0 to
0.3 kg and moves through random waypoints. Rig, driver and bus are the real ones, on one clock that
drives all. Angles are the joints' true ones; nothing is taken out of them, no lag either.

The servos are emulated: fitted on recordings of one real servo, see ``docs/emulator.md``.
"""

from __future__ import annotations

import argparse
import importlib
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common
from so101_motion.planning.kinematics.model import RobotModel

CAPS = ((90.0, 300.0), (180.0, 500.0))
LOADS_KG = (0.0, 0.1, 0.2, 0.3)
BAR = {
    "what": "bar", "moving at 90, worst [deg]": 2.0, "moving at 180, worst [deg]": 3.5,
    "after 0.5 s, worst [deg]": 0.5, "moved later, worst [deg]": 0.09,
    "tool point, p95 [mm]": 4.0, "tool point, worst [mm]": 6.0,
}  # fmt: skip

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
_following: Any = importlib.import_module("harness.path_following")
_harness: Any = importlib.import_module("harness.emulated_rig")
_referee: Any = importlib.import_module("referee")


def seen(seed: int, plans: int) -> dict[str, list[float]]:
    """What one arm was seen to do."""
    found: dict[str, list[float]] = {"90": [], "180": [], "rest": [], "later": [], "tool": []}
    model = RobotModel.load()
    options = {"spread": 0.2, "seed": seed, "held_kg": LOADS_KG[seed % len(LOADS_KG)]}
    with (
        _referee.refereed(("motion",)) as referee,
        tempfile.TemporaryDirectory() as folder,
        _harness.hardware_bench(Path(folder), reply_timeout=2.0, **options) as bench,
    ):
        rig = bench.open()
        bench.advance(1.0)
        for speed, acceleration in CAPS:
            rig.arm.set_speed(math.radians(speed))
            rig.arm.set_acceleration(math.radians(acceleration))
            for k in range(plans):
                plan, _ = _following.random_plan(rig, 100 * seed + k)
                motion, off = rig.arm.start_execute(plan), 0.0
                while not motion.future.done():
                    bench.advance(0.01)
                    q_ref = np.degrees(rig.arm.state.q_ref)
                    off = max(off, float(np.abs(bench.arm_deg(rig) - q_ref).max()))
                motion.result(timeout=0.0)
                found[f"{speed:g}"].append(off)
                bench.advance(0.5)
                q_ref, q = rig.arm.state.q_ref, bench.arm_deg(rig)
                found["rest"].append(float(np.abs(q - np.degrees(q_ref)).max()))
                tips = [model.frame(each, "jaw_tip").p for each in (q_ref, np.radians(q))]
                found["tool"].append(1000.0 * float(np.linalg.norm(tips[1] - tips[0])))
                bench.advance(2.0)
                found["later"].append(float(np.abs(bench.arm_deg(rig) - q).max()))
    found["hard"] = [float(len(referee.findings))]
    return found


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arms", type=int, default=20)
    parser.add_argument("--plans", type=int, default=5, help="per arm and speed")
    asked = parser.parse_args()
    arms = [seen(seed, asked.plans) for seed in range(asked.arms)]
    found = {name: [x for arm in arms for x in arm[name]] for name in arms[0]}
    row = {
        "what": f"{asked.arms} arms, {asked.plans} paths each at 90 and at 180 deg/s",
        "moving at 90, worst [deg]": max(found["90"]),
        "moving at 180, worst [deg]": max(found["180"]),
        "moving at 90, p95 [deg]": float(np.percentile(found["90"], 95.0)),
        "moving at 180, p95 [deg]": float(np.percentile(found["180"], 95.0)),
        "after 0.5 s, worst [deg]": max(found["rest"]),
        "moved later, worst [deg]": max(found["later"]),
        "tool point, p95 [mm]": float(np.percentile(found["tool"], 95.0)),
        "tool point, worst [mm]": max(found["tool"]),
        "moments of more acceleration than the referee allows": sum(found["hard"]),
    }
    _common.write("bench_true_arm", [row, BAR])


if __name__ == "__main__":
    main()
