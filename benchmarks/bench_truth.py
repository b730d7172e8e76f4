"""Compare the emulated servo with a real one: ``python -m benchmarks.bench_truth PATH``.

PATH has recordings for ``benchmarks.servo_model.load``; none of them is part of this project. Each
recording is simulated whole, open loop, from its first measured position at rest, with the
parameters of the emulator's ``STS3215_12V``. ``--emulator`` drives the
emulated servo itself, through its registers, instead of the vectorised model; ``--datasheet`` does
the same with the servo that the datasheet describes.

Prints the error by motion, gain and mass; how far from its goal the servo rests, and how fast its
steps are, measured and modelled. The last line begins with the mean over all samples of
|measured - modelled| in radians; samples without torque count.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.emulated_pendulum import emulate
from benchmarks.fit_servo import by_group, draw
from benchmarks.servo_model import Array, Parameters, Recordings, load, simulate
from so101_motion.drivers.servo_types import ServoType

_REST = 40  # samples for which a goal must have stood still
_STILL = 0.003  # [rad], two ticks: scatter of a position at rest
_SHARES = {"5 %": 0.05, "50 %": 0.5, "95 %": 0.95}
_UP_AND_DOWN = "up_and_down"
_ARRIVALS = {
    1.0: "lifted", 2.0: "lifted slowly", -2.0: "lowered slowly", -1.0: "lowered", 0.0: "hanging",
}  # fmt: skip
_LEAST_STEP = 0.3  # [rad]


def stand_offs(recordings: Recordings, position: Array) -> Array:
    """Goal minus position wherever the servo rests: measured and modelled, shape (m, 4).

    Columns: P gain, which of ``_ARRIVALS``, measured, modelled [rad].
    """
    found = []
    for i in range(len(recordings)):
        if recordings.kind[i] == _UP_AND_DOWN:  # its goal is slow, but never still
            top = int(np.argmax(recordings.goal[i])) + 10
            for arrival, last in ((2.0, slice(top, top + 10)), (-2.0, slice(-10, None))):
                both = recordings.position[i], position[i]
                off = [np.mean(recordings.goal[i][last] - each[last]) for each in both]
                found.append([recordings.kp[i], arrival, *off])
        for start, end in _holds(recordings, i):
            last, measured = slice(end - 10, end), recordings.position[i]
            rests = np.ptp(measured[end - 20 : end]) < _STILL
            if rests and recordings.valid[i, end - 20 : end].all():
                goal = recordings.goal[i, end - 1]
                came_from = measured[start]
                upwards = np.sign((goal - came_from) * np.sign(np.sin(goal)))
                off = [goal - np.mean(each[last]) for each in (measured, position[i])]
                found.append([recordings.kp[i], upwards, *off])
    return np.array(found)


def step_times(recordings: Recordings, position: Array) -> dict[str, tuple[float, float]]:
    """Median time from a step of the goal to a share of the way: measured, modelled [s]."""
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in _SHARES}
    for i in range(len(recordings)):
        for start, end in _holds(recordings, i):
            measured = recordings.position[i, start:end]
            whole = measured[-1] - measured[0]
            if abs(whole) < _LEAST_STEP or not recordings.valid[i, start:end].all():
                continue
            t = recordings.t[i, start:end] - recordings.t[i, start]
            for name, share in _SHARES.items():
                ways = (_passing(t, each, share) for each in (measured, position[i, start:end]))
                found[name].append((next(ways), next(ways)))
    pairs = {name: np.nanmedian(np.array(rows), axis=0) for name, rows in found.items() if rows}
    return {name: (float(pair[0]), float(pair[1])) for name, pair in pairs.items()}


def _passing(t: Array, position: Array, share: float) -> float:
    moved = (position - position[0]) / (position[-1] - position[0] or np.nan)
    beyond = np.flatnonzero(moved >= share)
    if not len(beyond) or beyond[0] == 0:
        return float("nan")
    k = int(beyond[0])
    return float(np.interp(share, moved[k - 1 : k + 1], t[k - 1 : k + 1]))


def _holds(recordings: Recordings, i: int) -> list[tuple[int, int]]:
    """Spans of samples in which a driven servo's goal stands still."""
    goal, on = recordings.goal[i], recordings.torque_on[i]
    same = np.concatenate(([False], (np.diff(goal) == 0.0) & on[1:] & on[:-1], [False]))
    begins = np.flatnonzero(~same[:-1] & same[1:])
    ends = np.flatnonzero(same[:-1] & ~same[1:])
    return [(int(a), int(b) + 1) for a, b in zip(begins, ends, strict=True) if b - a >= _REST]


_DATASHEET = ServoType(
    name="STS3215-C018", volts=12.0, torque_per_volt=2.94 / 12.0, back_emf=12.0 / 5.05,
    resistance=12.0 / 2.7, armature=0.028, viscous=0.03, coulomb=0.05, load_external=0.0,
    load_motor=0.0, still_external=0.0, still_motor=0.0, stribeck_speed=1.0, speed_limit=1e9,
    goal_delay=0.0, loop_delay=0.0, duty_shape=1.0, max_voltage_raw=140,
)  # fmt: skip
"""As the datasheet has it (30 kg.cm, 2.7 A, 45 rpm without load), with the friction of the official
robot description and no delays."""


def main() -> None:
    """Simulate and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--emulator", action="store_true", help="drive the emulated servo itself")
    parser.add_argument("--datasheet", action="store_true", help="the datasheet's servo instead")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw one of each motion")
    asked = parser.parse_args()
    recordings = load(asked.recordings)
    if asked.datasheet:
        position = emulate(recordings, _DATASHEET)
    elif asked.emulator:
        position = emulate(recordings)
    else:
        position = simulate(recordings, Parameters())[0]
    if asked.plot:
        draw(recordings, position, asked.plot)
    spikes = int((~recordings.valid).sum())
    print(f"{asked.recordings}: {len(recordings)} recordings, {spikes} failed readings left out")
    for name, error in by_group(recordings, position).items():
        print(f"  {name:20s} {error:.4f}")
    rows = recordings.valid.all(axis=1)
    worst = np.abs(position - recordings.position)[rows].mean(axis=1).max()
    print(f"  {'worst recording':20s} {worst:.4f}")
    _print_rest(stand_offs(recordings, position))
    for name, (measured, modelled) in step_times(recordings, position).items():
        print(f"  {name} of a step after {measured * 1e3:.0f} ms, modelled {modelled * 1e3:.0f} ms")
    print(f"{float(recordings.error(position)):.5f} rad mean absolute error over all samples")


def _print_rest(found: Array) -> None:
    print("  at rest [deg]: P, arrival, how often; measured, modelled, mean and largest difference")
    for kp in np.unique(found[:, 0]):
        for arrival, name in _ARRIVALS.items():
            rows = np.degrees(found[(found[:, 0] == kp) & (found[:, 1] == arrival)][:, 2:])
            if len(rows):
                measured, modelled = np.abs(rows).mean(axis=0)
                off = np.abs(rows[:, 0] - rows[:, 1])
                print(
                    f"  P {kp:2.0f} {name:14s} {len(rows):4d}  {measured:5.2f} {modelled:5.2f}"
                    f"   {off.mean():.2f} {off.max():.2f}"
                )
    off = np.degrees(np.abs(found[:, 2] - found[:, 3]))
    print(f"  all: {off.mean():.2f} deg on average, {(off <= 1.0).mean():.0%} within 1 deg")


if __name__ == "__main__":
    main()
