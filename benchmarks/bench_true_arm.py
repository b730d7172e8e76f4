"""How well emulated arms that differ, with an unknown load, follow their setpoints and rest.

Every arm has servos of its own (spread 0.2: friction, play, torque, dead time, zero), holds 0 to
0.3 kg and moves through random waypoints. Rig, driver and bus are the real ones, on one clock that
drives all. Angles are the joints' true ones, lag included. The same is measured without
compensation, where the goals are the setpoints themselves. Each arm is a piece: an interrupted run
is resumed. Constants were chosen on the arms 0 to 19 and 40 to 89, which are not among these.

The servos are emulated: those of 12 V are fitted on recordings of a pendulum, those of 7.4 V on
recordings of an arm, see ``docs/emulator.md``. The driver takes the type from the supply. So each
is measured at the other's supply as well, where it is taken for the other, and once more with a
driver that knows better.
Motions may be slower than 90 or 180 deg/s, where the driver knows that servos lack the drive.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from benchmarks import _common
from so101_motion.drivers.feetech import servo_setup
from so101_motion.drivers.feetech.goal_compensation import GoalCompensation
from so101_motion.drivers.servo_types import STS3215_7V4, STS3215_12V, ServoType
from so101_motion.planning.kinematics.model import RobotModel

CAPS = ((90.0, 300.0), (180.0, 500.0))
FIRST = 20
"""The first arm's seed."""

ARM_LIKE_12V = replace(STS3215_7V4, max_voltage_raw=STS3215_12V.max_voltage_raw)
"""What was fitted on an arm, allowed to run at 12 V."""

LOADS_KG = (0.0, 0.1, 0.2, 0.3)
BAR = {
    "what": "bar", "moving at 90, worst [deg]": 1.7, "moving at 180, worst [deg]": 3.5,
    "after 0.5 s, worst [deg]": 0.5, "moved later, worst [deg]": 0.09,
    "past the goal, worst [deg]": 0.5,
    "tool point, p95 [mm]": 4.0, "tool point, worst [mm]": 6.0,
}  # fmt: skip

_LAST = 40
"""Samples, 10 ms each, in which a joint can be seen to go past its goal."""

_following: Any = _common.from_tests("harness.path_following")
_harness: Any = _common.from_tests("harness.emulated_rig")
_referee: Any = _common.from_tests("referee.official")


@contextmanager
def without_compensation() -> Iterator[None]:
    """Goals are the commands, nothing is added to them."""
    begin = GoalCompensation.__init__

    def bare(compensation: Any, *given: Any, **options: Any) -> None:
        begin(compensation, *given, **options | {"compensates": False})

    with mock.patch.object(GoalCompensation, "__init__", bare):
        yield


def taken_for(kind: ServoType | None) -> Any:
    """While it lasts, the driver takes servos for this type, whatever their supply."""
    if kind is None:
        return nullcontext()
    return mock.patch.object(servo_setup, "type_of", return_value=kind)


def seen(
    seed: int, plans: int, kind: ServoType, volts: float | None, known: ServoType | None
) -> dict[str, list[float]]:
    """Measurements of one arm on random plans; at another supply than its own at 90 deg/s only."""
    found: dict[str, list[float]] = {"90": [], "180": [], "rest": [], "later": [], "tool": []}
    found |= {"errors": [], "over": [], "slower": []}
    model = RobotModel.load()
    options = {"kind": kind, "spread": 0.2, "seed": seed, "held_kg": LOADS_KG[seed % len(LOADS_KG)]}
    options["volts"] = volts
    with (
        taken_for(known),
        _referee.refereed(("motion",)) as referee,
        tempfile.TemporaryDirectory() as folder,
        _harness.hardware_bench(Path(folder), reply_timeout=2.0, **options) as bench,
    ):
        rig = bench.open()
        bench.advance(1.0)
        for speed, acceleration in CAPS if volts is None else CAPS[:1]:
            rig.arm.set_speed(math.radians(speed))
            rig.arm.set_acceleration(math.radians(acceleration))
            for k in range(plans):
                plan, _ = _following.random_plan(rig, 100 * seed + k)
                found["slower"].append(float(bool(plan.report.short_of_drive)))
                motion, seen_at = rig.arm.move(plan, wait=False), []
                while not motion.future.done():
                    bench.advance(0.01)
                    seen_at.append((np.degrees(rig.arm.state.q_ref), bench.arm_deg(rig)))
                wanted, true = (np.array(each) for each in zip(*seen_at, strict=True))
                off = float(np.abs(true - wanted).max())
                way = np.sign(wanted[-1] - wanted[-_LAST])
                found["over"].append(float((way * (true[-_LAST:] - wanted[-1])).max()))
                found["errors"].append(float(motion.future.exception() is not None))
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
    what = f"{asked.arms} arms, {asked.plans} paths each at 90 and at 180 deg/s"
    rows = [measured(what, STS3215_12V, asked.arms, asked.plans)]
    few = max(asked.arms // 4, 1)
    rows.append(measured(f"7.4 V servos, {what}", STS3215_7V4, asked.arms, asked.plans))
    short = max(asked.plans // 2, 1)  # it is the first motion that tells
    for kind, other, volts in ((STS3215_12V, STS3215_7V4, 7.4), (ARM_LIKE_12V, STS3215_12V, 12.0)):
        name = "12 V servos" if kind is STS3215_12V else "7.4 V servos that bear 12 V"
        for known in (other, kind):
            text = f"{name} at {volts:g} V, {'taken for the others' if known is other else 'known'}"
            text += f", {asked.arms} arms, {short} paths each at 90 deg/s"
            rows.append(measured(text, kind, asked.arms, short, volts, known))
    with without_compensation():
        rows.append(measured(f"{few} arms without compensation", STS3215_12V, few, asked.plans))
    _common.write("bench_true_arm", [rows[0], BAR, *rows[1:]])


def measured(
    what: str,
    kind: ServoType,
    count: int,
    plans: int,
    volts: float | None = None,
    known: ServoType | None = None,
) -> dict[str, Any]:
    """A row of the results; ``volts`` and ``known`` as in :func:`seen` and :func:`taken_for`."""
    pieces = {
        f"{what}: {seed}": partial(seen, seed, plans, kind, volts, known)
        for seed in range(FIRST, FIRST + count)
    }
    arms = _common.in_pieces("bench_true_arm", pieces)
    found = {name: [x for arm in arms for x in arm[name]] for name in arms[0]}
    fast = {
        "moving at 180, worst [deg]": max(found["180"]),
        "moving at 180, p95 [deg]": float(np.percentile(found["180"], 95.0)),
    } if found["180"] else {}  # fmt: skip
    return {
        "what": what,
        "moving at 90, worst [deg]": max(found["90"]),
        "moving at 90, p95 [deg]": float(np.percentile(found["90"], 95.0)),
        **fast,
        "after 0.5 s, worst [deg]": max(found["rest"]),
        "moved later, worst [deg]": max(found["later"]),
        "past the goal, worst [deg]": max(found["over"]),
        "tool point, p95 [mm]": float(np.percentile(found["tool"], 95.0)),
        "tool point, worst [mm]": max(found["tool"]),
        "motions that ended in an error": sum(found["errors"]),
        "motions planned slower than their caps": sum(found["slower"]),
        "moments of more acceleration than the referee allows": sum(found["hard"]),
    }


if __name__ == "__main__":
    main()
