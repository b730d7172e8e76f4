"""Joints that meet something: how soon they are stopped, and that nothing else stops them.

First one joint of an emulated arm after the other meets a wall, at different speeds: from the
contact until the command no longer leads it on. Then arms whose servos differ (spread 0.2), with 0
to 0.2 kg in the hand that nobody has told them of, move through random waypoints at 10 to 180
deg/s, an hour on the pretended clock in all: none of those motions may end as a contact does.

The servos are emulated: fitted on recordings of one real servo, see ``docs/emulator.md``.
"""

from __future__ import annotations

import argparse
import importlib
import math
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common
from benchmarks.direct_ports import direct_ports
from so101_motion.common.errors import FollowingError
from so101_motion.common.state import ARM_JOINTS

SPEEDS = (10.0, 20.0, 30.0, 50.0, 90.0, 180.0)
LOADS_KG = (0.0, 0.1, 0.2)
PACES = ((10.0, 100.0), (20.0, 100.0), (50.0, 100.0), (90.0, 300.0), (180.0, 500.0))
TOUCH = math.radians(0.05)
"""So near to the wall a joint touches it: one that its weight leads there leans on it [rad]."""

GOALS = (50.0, -40.0, -70.0, -60.0, 90.0)
"""Where each joint is sent from zero, clear of the table [deg]."""

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
_following: Any = importlib.import_module("harness.path_following")
_harness: Any = importlib.import_module("harness.emulated_rig")
_referee: Any = importlib.import_module("referee")


def contacts(seed: int, speed: float) -> list[float]:
    """How long each joint of an arm was led on after it had met a wall [s]."""
    found = []
    load = LOADS_KG[seed % len(LOADS_KG)]
    with (
        _referee.refereed(("motion",)),
        direct_ports(),
        tempfile.TemporaryDirectory() as folder,
        _harness.hardware_bench(
            Path(folder), reply_timeout=2.0, spread=0.2, seed=seed, held_kg=load
        ) as bench,
    ):
        rig = bench.open()
        bench.advance(1.0)
        rig.arm.set_speed(math.radians(speed))
        rig.arm.set_acceleration(math.radians(500.0))
        for i, joint in enumerate(ARM_JOINTS):
            bench.finish(bench.go(rig, 0, 0, 0, 0, 0), at_most=60.0)
            goal = np.zeros(5)
            goal[i] = GOALS[i]
            side = math.copysign(1.0, goal[i])
            wall = bench.world.q[i] + math.radians(0.6 * goal[i])
            ends = (-math.inf, wall) if side > 0.0 else (wall, math.inf)
            bench.world.put_wall(joint, *ends)
            motion, touched = bench.go(rig, *goal), math.nan
            while not motion.future.done():
                bench.advance(0.002)
                if math.isnan(touched) and side * (bench.world.q[i] - wall) >= -TOUCH:
                    touched = bench.clock.now()
                if touched == touched and rig.arm.state.qd_ref[i] == 0.0:
                    found.append(bench.clock.now() - touched)
                    break
            try:
                bench.finish(motion)
            except FollowingError:
                pass
            else:
                found.append(math.inf)
            bench.world.put_wall(joint, -math.inf, math.inf)
            bench.advance(0.5)
    return found


def undisturbed(seed: int, seconds: float) -> tuple[float, int, int]:
    """Seconds of motion, motions, and how many of them ended as if they had met something."""
    moved, motions, alarms = 0.0, 0, 0
    load = LOADS_KG[seed % len(LOADS_KG)]
    with (
        _referee.refereed(("motion",)),
        direct_ports(),
        tempfile.TemporaryDirectory() as folder,
        _harness.hardware_bench(
            Path(folder), reply_timeout=2.0, spread=0.2, seed=seed, held_kg=load
        ) as bench,
    ):
        rig = bench.open()
        bench.advance(1.0)
        while moved < seconds:
            speed, acceleration = PACES[motions % len(PACES)]
            rig.arm.set_speed(math.radians(speed))
            rig.arm.set_acceleration(math.radians(acceleration))
            plan, _ = _following.random_plan(rig, 1000 * seed + motions)
            begin = bench.clock.now()
            try:
                bench.finish(rig.arm.start_execute(plan), at_most=60.0)
            except FollowingError as error:
                alarms += 1
                print(f"arm {seed}, motion {motions}, {speed:g} deg/s: {error}")
            moved, motions = moved + bench.clock.now() - begin, motions + 1
    return moved, motions, alarms


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arms", type=int, default=6)
    parser.add_argument("--minutes", type=float, default=60.0)
    asked = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for speed in SPEEDS:
        pieces = {f"{speed:g} deg/s: {k}": partial(contacts, k, speed) for k in range(asked.arms)}
        times = [each for arm in _common.in_pieces("bench_contact", pieces) for each in arm]
        rows.append(
            {
                "what": f"contact at {speed:g} deg/s, {len(times)} of them, until led on no more",
                "median [s]": float(np.median(times)),
                "worst [s]": max(times),
            }
        )
        print(rows[-1])
    each_for = 60.0 * asked.minutes / asked.arms
    ways = {f"{each_for:g} s: {k}": partial(undisturbed, k, each_for) for k in range(asked.arms)}
    seen = _common.in_pieces("bench_contact", ways)
    rows.append(
        {
            "what": f"random motion of {asked.arms} arms without contact, with up to 0.2 kg",
            "minutes of motion": sum(each[0] for each in seen) / 60.0,
            "motions": sum(each[1] for each in seen),
            "taken for a contact": sum(each[2] for each in seen),
        }
    )
    _common.write("bench_contact", rows)


if __name__ == "__main__":
    main()
