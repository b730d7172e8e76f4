"""The guarded follower of targets: hostile targets, processor time, and latency.

*Hostile targets.* Ten thousand of every kind (60 deg jumps, what is no number, out of range, into
the table, into the arm itself, two places in turn, ending in motion) for an emulated arm on
simulated time, with the real driver under the referee: contacts as commanded and as the joints
truly are, objections, and whether it ends.

*What the guard costs.* Two followings of the same targets, one without a guard: a person's motion,
and hostile places that keep the arm near the table and itself. Processor time of the thread.

*From the target to the setpoint.* In real time, on an arm that is simulated in this process:
from ``aim`` until a goal that has taken it up is written to the driver. The targets come at random
moments of the control cycle.

``--targets`` says how many hostile targets, ``--seconds`` how long the last part takes; ``--cost``
prints what the guard costs and writes nothing.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common
from so101_motion.arm.open_ended_motions import GUARDED_STOP
from so101_motion.common.clock import MonotonicClock
from so101_motion.common.geometry import Array
from so101_motion.control.executor import Channel, Executor
from so101_motion.control.following import Following
from so101_motion.drivers.simulated import SimArm
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.differential.guard import Guard
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.torque import Load, Strength
from so101_motion.rig.rig import HARD_STOP, TICK
from so101_motion.tasks.teleop.pilot import Pace

_targets: Any = _common.from_tests("campaign.targets")
_referee: Any = _common.from_tests("referee.official")
_bench: Any = _common.from_tests("harness.emulated_pair")

READY = np.radians([0.0, -45.0, 45.0, 60.0, 0.0])


def hostile(count: int, seed: int, *, fast: bool) -> dict[str, Any]:
    """Targets of every kind, under the referee, which raises if it objects.

    At the highest caps that can be configured it only counts how often a joint truly changed its
    speed faster than it would allow: that is the servo, stopped from 180 deg/s.
    """
    excused = ("motion",) if fast else ()
    with tempfile.TemporaryDirectory() as folder, _referee.refereed(excused) as referee:
        outcome = _targets.attack(Path(folder), seed=seed, count=count, fast=fast)
    for text in (*outcome.contacts, *outcome.broken):
        print(text)
    return {
        "what": "hostile targets, fast" if fast else "hostile targets",
        "seed": seed,
        "targets": sum(outcome.sent.values()),
        "refused": outcome.refused,
        "contacts": len(outcome.contacts),
        "objections": len(referee.findings),
        "other laws broken": len(outcome.broken),
        "nearest, as commanded [mm]": 1e3 * outcome.nearest,
        "travelled [deg]": outcome.travelled,
        "simulated [s]": outcome.seconds,
    }


def costing() -> list[dict[str, Any]]:
    """Processor time of a cycle, and what the guard adds to it."""
    model, rows = RobotModel.load(), []
    rng = np.random.default_rng(1)
    person = np.radians(_bench.human_motion(60.0, 1)[:, :5])
    places = np.repeat(rng.uniform(model.lower, model.upper, (200, 5)), 30, axis=0)
    ways = (("a person", person, False), ("a person, acceleration told", person, True))
    for name, way, told in (*ways, ("hostile places", places, False)):
        bare, guarded = (_timed(model, way, guarded=each, told=told) for each in (False, True))
        for how, times in (("a cycle", bare), ("a guarded cycle", guarded)):
            rows.append({"what": f"{how}, {name}", **_common.summary(times)})
        added = {
            f"{share:g}th percentile [s]": float(
                np.percentile(guarded, share) - np.percentile(bare, 50.0)
            )
            for share in (50.0, 99.0)
        }
        rows.append({"what": f"the guard adds, {name}", **added})
    return rows


def _timed(model: RobotModel, way: Array, *, guarded: bool, told: bool) -> Array:
    rates = np.gradient(way, TICK, axis=0)
    changes = np.gradient(rates, TICK, axis=0)
    load = Load.of(model, Strength.of_servos(7.4), READY, None)
    guard = Guard(CollisionModel(model), lambda: 0.3, load, acceleration=GUARDED_STOP.acceleration)
    following = Following(
        q_start=READY, lower=model.lower, upper=model.upper, limits=Pace().full,
        stop_limits=GUARDED_STOP if guarded else HARD_STOP, dt=TICK,
        guard=guard if guarded else None,
    )  # fmt: skip
    times = []
    for k, q in enumerate(way):
        _ = following.aim(q, rates[k], changes[k]) if told else following.aim(q)
        begin = time.thread_time()
        following.sample(k)
        times.append(time.thread_time() - begin)
    return np.array(times)


class _Watched(SimArm):
    """A simulated arm that notes when its goals change."""

    def __init__(self, clock: MonotonicClock) -> None:
        super().__init__(clock, q=READY)
        self.changed: list[float] = []
        self._last = np.zeros(5)

    def write(
        self,
        q_cmd: Array,
        q_jaw_cmd: float,
        qd_cmd: Array | None = None,
        qdd_cmd: Array | None = None,
        follows_target: bool = False,
        room: float = 0.0,
    ) -> None:
        super().write(q_cmd, q_jaw_cmd, qd_cmd, qdd_cmd, follows_target, room)
        if not np.array_equal(q_cmd, self._last):
            self._last = np.array(q_cmd)
            self.changed.append(time.perf_counter())


def responding(seconds: float) -> dict[str, Any]:
    """In real time: each target is given to an arm that rests, at a random moment."""
    clock = MonotonicClock()
    arm, model = _Watched(clock), RobotModel.load()
    executor = Executor(arm, clock, dt=TICK, stop_limits=HARD_STOP)
    rng, found = np.random.default_rng(2), []
    executor.start()
    guard = Guard(CollisionModel(model), lambda: 0.3, acceleration=HARD_STOP.acceleration)
    following = Following(
        q_start=executor.state.q_ref, lower=model.lower, upper=model.upper, limits=Pace().full,
        stop_limits=executor.stop_limits(Channel.ARM), dt=TICK, guard=guard, stale_after=None,
    )  # fmt: skip
    executor.play(following)
    end, k = time.perf_counter() + seconds, 0
    while time.perf_counter() < end:
        time.sleep(0.25 + rng.uniform(0.0, TICK))
        k += 1
        arm.changed.clear()
        begin = time.perf_counter()
        following.aim(READY + np.radians([4.0 if k % 2 else 0.0, 0.0, 0.0, 0.0, 0.0]))
        time.sleep(0.2)
        found.append(arm.changed[0] - begin)
    following.close().result(5.0)
    late = executor.state.late_ticks
    executor.close()
    return {"what": "from aim to the goal", **_common.summary(found), "late ticks": late}


def main() -> None:
    """Do all of it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--targets", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--cost", action="store_true", help="what the guard costs, nothing else")
    asked = parser.parse_args()
    if asked.cost:
        for row in costing():
            print(row)
        return
    rows = [responding(asked.seconds), *costing()]
    rows += [hostile(asked.targets, asked.seed, fast=fast) for fast in (False, True)]
    _common.write("bench_following", [*rows, BARS])


BARS = {
    "what": "bar",
    "median": 0.01,
    "p99": 0.02,
    "99th percentile [s]": 0.0005,
    "contacts": 0,
    "objections": 0,
}


if __name__ == "__main__":
    main()
