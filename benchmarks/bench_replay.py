"""Send an emulated arm what a real arm was commanded.

``python -m benchmarks.bench_replay FILE.npz``, recordings as for ``bench_real_arm``. The
recorded goals, 50 a second, are the targets of a following, through the predictor of the
teleoperation, the real driver and bus, to an emulated arm with 7.4 V servos; the referee watches
the wire. Once with wide caps and without a guard, once with those an arm is opened with and with
the guard. Prints how far joints are from the newest command: those of the recorded arm, which was
sent the bare goals, after one constant a joint is removed; those of ours as they are.
"""

from __future__ import annotations

import argparse
from collections import Counter
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common
from benchmarks.emulated_arm import Array, Recording, load
from benchmarks.emulated_followings import EmulatedArm, opened
from so101_motion.common.clock import ManualClock
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_rad
from so101_motion.drivers.servo_types import STS3215_7V4
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.tasks.teleop.pilot import FULL_JERK, HORIZON
from so101_motion.tasks.teleop.predictor import Predictor

_CAPS = {"caps 180 deg/s, no guard": (180.0, 500.0), "caps 50 deg/s, guard": (50.0, 100.0)}
_BEFORE = 3.0
"""How long the first goal is aimed at before the motion begins [s]; chosen."""

_referee: Any = _common.from_tests("referee.official")


def replayed(
    recording: Recording, speed: float, acceleration: float, longest: float
) -> dict[str, Any]:
    """Follow one recording's goals, the first ``longest`` seconds of them.

    Returns:
        Sums over the periods of |command - position| by joint, real and ours [rad]; the constants
        removed; the referee's objections.
    """
    clock, predictor = ManualClock(), Predictor()
    caps = MotionLimits.uniform(
        velocity=to_rad(speed), acceleration=to_rad(acceleration), jerk=FULL_JERK
    )
    goals, times = recording["command"], recording["t_cmd_s"] - recording["t_cmd_s"][0]
    objections: Counter[str] = Counter()
    with ExitStack() as stack:
        referee = stack.enter_context(_referee.refereed(_referee.RULES))
        referee.report = lambda rule, *_: objections.update([rule])
        arm = EmulatedArm("replay", clock, goals[0, :5], caps, STS3215_7V4)
        stack.callback(arm.close)
        clock.advance(1.0)
        settings = {} if acceleration < 200.0 else {"guard": None}
        following, rows = opened(arm, clock, caps, **settings), []
        begin, k = clock.now() + _BEFORE, -1
        heard = np.ones(6, dtype=bool)
        following.aim(goals[0, :5])
        while k < len(times) - 1 and clock.now() < begin + longest:
            while k < len(times) - 1 and begin + times[k + 1] <= clock.now():
                k += 1
                predictor.take(clock.now(), goals[k], heard)
            ahead = predictor.at(clock.now() + HORIZON) if k >= 0 else None
            if ahead is not None:
                following.aim(*(each[:5] for each in ahead))
            clock.advance(0.01)
            if k >= 0:
                rows.append((clock.now() - begin, *arm.q[:5]))
        following.close()
        clock.advance(1.0)
    ours = np.array(rows)
    held = np.searchsorted(times, ours[:, 0], side="right") - 1
    command = goals[held, :5]
    t = recording["t_s"] - recording["t_cmd_s"][0]
    real = np.column_stack(
        [np.interp(ours[:, 0], t, recording["position"][:, j]) for j in range(5)]
    )
    return {
        "real": (command - real)[::5].round(6).tolist(),
        "ours": (command - ours[:, 1:])[::5].round(6).tolist(),
        "objections": sum(objections.values()),
        **{f"objections: {rule}": count for rule, count in objections.items()},
    }


def row(name: str, pieces: list[dict[str, Any]]) -> dict[str, Any]:
    """One row of the table: the mean over all samples, by joint [deg]."""
    real, ours = (np.concatenate([np.array(p[key]) for p in pieces]) for key in ("real", "ours"))
    means: tuple[Array, Array] = (
        np.degrees(np.abs(real - np.median(real, axis=0)).mean(axis=0)),
        np.degrees(np.abs(ours).mean(axis=0)),
    )
    found: dict[str, Any] = {"what": name, "samples": len(ours)}
    for joint, theirs, own in zip(ARM_JOINTS, *means, strict=True):
        found[f"{joint}, recorded arm [deg]"], found[f"{joint}, ours emulated [deg]"] = theirs, own
    found["objections of the referee"] = sum(p["objections"] for p in pieces)
    rules = Counter({k: v for p in pieces for k, v in p.items() if k.startswith("objections: ")})
    return {**found, **rules}


def main() -> None:
    """Replay, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--motions", type=int, help="only so many")
    parser.add_argument("--longest", type=float, default=60.0, help="of each only so long [s]")
    asked = parser.parse_args()
    every = list(load(asked.recordings).items())[: asked.motions]
    rows: list[dict[str, Any]] = []
    for what, caps in _CAPS.items():
        pieces = {
            f"{what}: {name}": partial(replayed, each, *caps, asked.longest) for name, each in every
        }
        rows.append(row(what, _common.in_pieces("bench_replay", pieces)))
    _common.write("bench_replay", rows)


if __name__ == "__main__":
    main()
