"""How soon a joint that hits a wall is stopped, and that motions without contact are not.

First one joint of an emulated arm after the other meets a wall, at different speeds, with nothing
and with 0.2 kg in the hand: from the contact, as the emulator knows it, until the first setpoint
that no longer moves the joint on. Then arms whose servos differ (spread 0.2), with an unannounced
load of 0 to 0.2 kg in the hand, move through random waypoints at 10 to 180
deg/s, an hour on the simulated clock in all: none of those motions may end as a contact does.

The servos are emulated: fitted on recordings of one real servo, see ``docs/emulator.md``.
"""

from __future__ import annotations

import argparse
import itertools
import math
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common
from so101_motion.common.errors import FollowingError, ServoAlarm
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS

SPEEDS = (10.0, 15.0, 30.0, 90.0)
HELD_KG = (0.0, 0.2)
LOADS_KG = (0.0, 0.1, 0.2)
PACES = ((10.0, 100.0), (20.0, 100.0), (50.0, 100.0), (90.0, 300.0), (180.0, 500.0))
TOUCH = math.radians(0.05)
"""A joint this near to the wall counts as touching it [rad]."""

GOALS = (50.0, -40.0, -70.0, -60.0, 90.0)
"""Where each joint is sent from zero and back, clear of the table [deg]."""

PRESSES = 500
"""A motor with more drive than this presses: half of its drive [1/1000]; chosen."""

FELT, SHORT, UNFELT = "felt", "stopped before it", "not felt"
"""The outcomes for a joint that is sent into a wall."""

_following: Any = _common.from_tests("harness.path_following")
_harness: Any = _common.from_tests("harness.emulated_rig")
_referee: Any = _common.from_tests("referee.official")


Contact = tuple[str, str, str, float, float]
"""A joint, its direction, the outcome, how long it was moved on after it had met the wall, and how
long after that its motor still pressed [s]; 0 without contact."""


def contacts(seed: int, speed: float, held_kg: float) -> list[Contact]:
    """Send each joint of an arm into a wall, on its way from zero and on its way back."""
    found: list[Contact] = []
    with (
        _referee.refereed(("motion",)),
        tempfile.TemporaryDirectory() as folder,
        _harness.hardware_bench(
            Path(folder), reply_timeout=2.0, spread=0.2, seed=seed, held_kg=held_kg
        ) as bench,
    ):
        rig = bench.open()
        bench.advance(1.0)
        rng = np.random.default_rng(seed)
        for i, joint in enumerate(ARM_JOINTS):
            goal = np.zeros(5)
            goal[i] = GOALS[i]
            for way, begin, end in (("out", np.zeros(5), goal), ("back", goal, np.zeros(5))):
                rig.arm.set_speed(math.radians(50.0))
                rig.arm.set_acceleration(math.radians(100.0))
                try:
                    bench.finish(bench.go(rig, *begin), at_most=60.0)
                except ServoAlarm as alarm:  # it pressed on for that long
                    print(f"after a contact at {speed:g} deg/s: {alarm}")
                    bench.finish(bench.go(rig, *begin), at_most=60.0)
                bench.advance(0.5)
                rig.arm.set_speed(math.radians(speed))
                rig.arm.set_acceleration(math.radians(500.0))
                share = rng.uniform(0.4, 0.8)
                found.append((joint, way, *_contact(bench, rig, i, end, share)))
    return found


def _contact(bench: Any, rig: Any, i: int, goal: Array, share: float) -> tuple[str, float, float]:
    """Send joint ``i`` to ``goal`` [deg], a wall on its way; what came of it, as in ``Contact``."""
    joint, q = ARM_JOINTS[i], bench.world.q[i]
    wall = q + share * (math.radians(goal[i]) - rig.arm.state.q[i])
    side = math.copysign(1.0, wall - q)
    bench.world.put_wall(joint, *((-math.inf, wall) if side > 0.0 else (wall, math.inf)))
    motion, touched, halted = bench.go(rig, *goal), math.nan, math.nan
    while not motion.future.done():
        bench.advance(0.002)
        if math.isnan(touched) and side * (bench.world.q[i] - wall) >= -TOUCH:
            touched = bench.clock.now()
        state = rig.arm.state
        if math.isnan(halted) and state.qd_ref[i] == 0.0 and state.mode is Mode.STOPPING:
            halted = bench.clock.now()
    drive, eased = bench.world.servo(joint).drive, halted
    for _ in range(150):  # its servo's set-point is beyond the wall, and must come back first
        if abs(drive.demand) > PRESSES:
            eased = bench.clock.now()
        bench.advance(0.01)
    bench.world.put_wall(joint, -math.inf, math.inf)
    bench.advance(0.5)
    try:
        bench.finish(motion)
    except FollowingError as error:
        halted = bench.clock.now() if math.isnan(halted) else halted
        if error.joint != joint or not touched <= halted:
            print(f"without contact: {error}")
            return SHORT, 0.0, 0.0
        return FELT, halted - touched, max(eased - halted, 0.0)
    return UNFELT, 0.0, 0.0


def undisturbed(seed: int, seconds: float) -> tuple[float, int, int]:
    """Seconds of motion, motions, and how many of them ended as if they had met something."""
    moved, motions, alarms = 0.0, 0, 0
    load = LOADS_KG[seed % len(LOADS_KG)]
    with (
        _referee.refereed(("motion",)),
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
                bench.finish(rig.arm.move(plan, wait=False), at_most=60.0)
            except FollowingError as error:
                alarms += 1
                print(f"arm {seed}, motion {motions}, {speed:g} deg/s: {error}")
            moved, motions = moved + bench.clock.now() - begin, motions + 1
    return moved, motions, alarms


def contact_rows(arms: int) -> list[dict[str, Any]]:
    """Each joint into walls at each speed, so many arms with each load."""
    rows: list[dict[str, Any]] = []
    for speed, held in itertools.product(SPEEDS, HELD_KG):
        pieces = {
            f"{speed:g} deg/s, {held:g} kg: {k}": partial(contacts, k, speed, held)
            for k in range(arms)
        }
        seen = [each for arm in _common.in_pieces("bench_contact", pieces) for each in arm]
        for joint, way in itertools.product(ARM_JOINTS, ("out", "back")):
            ends = [each[2:] for each in seen if tuple(each[:2]) == (joint, way)]
            times = [t for what, t, _ in ends if what == FELT]
            rows.append(
                {
                    "what": f"{joint} {way} at {speed:g} deg/s with {held:g} kg",
                    "contacts": len(ends),
                    "median [s]": float(np.median(times)) if times else None,
                    "worst [s]": max(times, default=None),
                    "over 0.1 s": sum(t > 0.1 for t in times),
                    "over half of the drive after that, worst [s]": max(t for _, _, t in ends),
                    SHORT: sum(what == SHORT for what, _, _ in ends),
                    UNFELT: sum(what == UNFELT for what, _, _ in ends),
                }
            )
    return rows


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arms", type=int, default=6)
    parser.add_argument("--minutes", type=float, default=60.0)
    asked = parser.parse_args()
    rows = contact_rows(asked.arms)
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
