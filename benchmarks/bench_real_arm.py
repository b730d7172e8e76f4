"""Compare the emulated arm with a recorded one: ``python -m benchmarks.bench_real_arm FILE.npz``.

Each motion is simulated whole, from its first measured position at rest and the goals that were
sent. ``--arm`` is the rated voltage of the emulated servos; 7.4 V by default, which the recordings
in ``docs/emulator.md`` call for. The format is that of ``benchmarks/emulated_arm.py``; files of
``so101 report-arm`` and, with ``--lerobot``, data sets of LeRobot are read as well.

Prints, for each joint and for each motion, the mean of |emulated - measured| after one constant a
joint is removed, because a calibrated zero is known to some degrees only; how long steps take, how
far smooth motions lag, and how far joints stand from goals at rest, measured and emulated. The last
line begins with the mean over all samples of the five arm joints [rad].
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from benchmarks import _common
from benchmarks.emulated_arm import ARMS, Array, Recording, arm_of, emulate, load, load_lerobot
from so101_motion.common.state import ARM_JOINTS

_N = len(ARM_JOINTS)
_RATE = 100.0
"""Commands and positions are compared at so many samples a second; chosen, twice the recorder's."""

_STILL = 1.5
"""A joint rests when its goal has stood still for so long [s]."""

_STEP, _HOLD = np.radians(8.0), 0.5
"""A step is a goal that jumps by so much [rad] and stays for this long before and after it [s]."""

_SHARES = (0.05, 0.5, 0.95)
_MOST_LAG = 0.4
"""Longest lag that is looked for [s]."""

Row = Mapping[str, object]


class Motion:
    """One motion on a common grid of time, joints as columns.

    Attributes:
        command: Goals, shape (k, 5), [rad].
        real: Measured, shape (k, 5), [rad].
        emulated: Emulated, shape (k, 5), [rad].
    """

    def __init__(self, recording: Recording, position: Array, zero: Array) -> None:
        t_cmd, t = recording["t_cmd_s"], recording["t_s"]
        self.t = np.arange(max(t[0], t_cmd[0]), min(t[-1], t_cmd[-1]), 1.0 / _RATE)
        held = np.searchsorted(t_cmd, self.t, side="right") - 1
        self.command = recording["command"][held, :_N]
        self.real, self.emulated = (
            np.column_stack([np.interp(self.t, t, each[:, j]) for j in range(_N)])
            for each in (recording["position"] + np.append(zero, 0.0), position)
        )

    def steps(self, joint: int) -> Iterator[tuple[Array, Array]]:
        """Times to ``_SHARES`` of the way of each step [s]: measured, emulated."""
        goal, hold = self.command[:, joint], round(_HOLD * _RATE)
        jumps = np.flatnonzero(np.abs(np.diff(goal)) > _STEP)
        for k in jumps:
            after = slice(k + 1, k + 1 + hold)
            before = goal[max(k - hold, 0) : k + 1]
            if k + 1 + hold < len(goal) and np.ptp(goal[after]) == 0.0 == np.ptp(before):
                ways = [each[k : k + hold, joint] for each in (self.real, self.emulated)]
                yield _arrivals(ways[0]), _arrivals(ways[1])

    def lag(self, joint: int) -> tuple[float, float] | None:
        """By how much the joint follows later than its goal [s]: measured, emulated.

        None for a goal that rests or jumps.
        """
        goal = self.command[:, joint]
        moves = np.abs(np.diff(goal))
        if np.ptp(goal) < np.radians(5.0) or moves.max() > np.radians(2.0) or len(goal) < 500:
            return None
        if np.mean(moves > 0.0) < 0.2:
            return None
        return _lag(goal, self.real[:, joint]), _lag(goal, self.emulated[:, joint])

    def at_rest(self, joint: int) -> Array:
        """Goal minus position wherever the goal has stood for ``_STILL``, shape (2, n), [rad]."""
        goal, still = self.command[:, joint], round(_STILL * _RATE)
        changed = np.flatnonzero(np.diff(goal, prepend=np.nan) != 0.0)
        since = (
            np.arange(len(goal))
            - changed[np.searchsorted(changed, np.arange(len(goal)), side="right") - 1]
        )
        rests = since >= still
        both = np.array([self.real[rests, joint], self.emulated[rests, joint]])
        return np.asarray(goal[rests] - both)


def _arrivals(way: Array) -> Array:
    share = (way - way[0]) / (way[-1] - way[0] or np.nan)
    found = []
    for part in _SHARES:
        k = int(np.argmax(share >= part))  # 0 if it never arrives
        before = share[k - 1 : k + 1]
        found.append((k - 1 + np.interp(part, before, (0.0, 1.0))) / _RATE if k else np.nan)
    return np.array(found)


def _lag(goal: Array, position: Array) -> float:
    n = round(_MOST_LAG * _RATE)
    centred = position[n:] - position[n:].mean()
    off = [
        np.sum(
            np.square(centred - (goal[n - k : len(goal) - k] - goal[n - k : len(goal) - k].mean()))
        )
        for k in range(n)
    ]
    return float(np.argmin(off)) / _RATE


def zeros(recordings: list[Recording], positions: list[Array]) -> Array:
    """What to add to measured angles to agree with the emulated ones, shape (5,), [rad]."""
    pairs = zip(recordings, positions, strict=True)
    off = np.concatenate([position[:, :_N] - each["position"][:, :_N] for each, position in pairs])
    return np.asarray(np.median(off, axis=0))


def figures(
    recordings: Mapping[str, Recording], positions: list[Array], zero: Array
) -> Iterator[Row]:
    """The rows of the table."""
    raws = list(recordings.values())
    errors = [
        np.abs(position[:, :_N] - each["position"][:, :_N] - zero)
        for each, position in zip(raws, positions, strict=True)
    ]
    all_of_them = np.concatenate(errors)
    yield {
        "what": "error [rad]",
        **dict(zip(ARM_JOINTS, all_of_them.mean(axis=0), strict=True)),
        "arm": all_of_them.mean(),
    }
    yield {"what": "constant removed [deg]", **dict(zip(ARM_JOINTS, np.degrees(zero), strict=True))}
    for name, error in zip(recordings, errors, strict=True):
        yield {
            "what": f"error, {name} [rad]",
            **dict(zip(ARM_JOINTS, error.mean(axis=0), strict=True)),
            "arm": error.mean(),
        }
    motions = [Motion(each, position, zero) for each, position in zip(raws, positions, strict=True)]
    for k, whose in enumerate(("measured", "emulated")):
        for i, share in enumerate(_SHARES):
            times = {
                joint: [pair[k][i] for motion in motions for pair in motion.steps(j)]
                for j, joint in enumerate(ARM_JOINTS)
            }
            yield {"what": f"steps, {share:.0%} after [s], {whose}", **_medians(times)}
        lags = {
            joint: [lag[k] for motion in motions if (lag := motion.lag(j)) is not None]
            for j, joint in enumerate(ARM_JOINTS)
        }
        yield {"what": f"lag of smooth motions [s], {whose}", **_medians(lags)}
        stand = {
            joint: np.degrees(np.abs(np.concatenate([each.at_rest(j)[k] for each in motions])))
            for j, joint in enumerate(ARM_JOINTS)
        }
        rests = {joint: float(each.mean()) for joint, each in stand.items() if len(each)}
        yield {"what": f"from the goal at rest [deg], {whose}", **rests}


def _medians(values: Mapping[str, list[float]]) -> dict[str, float]:
    return {joint: float(np.nanmedian(each)) for joint, each in values.items() if each}


_SHOWN = (
    ("static_holding", 1, None, 1.5, "a step"),
    ("oscillation_med_freq", 1, 20.0, 12.0, "a slow sine"),
    ("static_holding", 2, 20.0, 12.0, "at rest under its weight"),
)
"""What is drawn: motion, joint, begin [s] (None for its largest step), length [s], words."""


def draw(motions: Mapping[str, Motion], file: Path) -> None:
    """Draw goal, measured and emulated angles of ``_SHOWN``."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(_SHOWN), figsize=(10, 3))
    for place, (name, joint, begin, length, words) in zip(axes, _SHOWN, strict=True):
        motion = motions[name]
        t, goal = motion.t - motion.t[0], np.degrees(motion.command[:, joint])
        start = t[int(np.argmax(np.abs(np.diff(goal))))] - 0.2 if begin is None else begin
        shown = (t >= start) & (t <= start + length)
        for angles, style in (
            (motion.command, {"color": "0.6", "ls": ":", "label": "goal"}),
            (motion.real, {"color": "black", "label": "measured"}),
            (motion.emulated, {"color": "tab:orange", "lw": 1.0, "label": "emulated"}),
        ):
            place.plot(t[shown] - start, np.degrees(angles[shown, joint]), **style)
        place.set_title(f"{ARM_JOINTS[joint]}, {words}", fontsize=8)
        place.tick_params(labelsize=7)
        place.set_xlabel("s", fontsize=8)
    axes[0].set_ylabel("deg", fontsize=8)
    axes[0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(file, dpi=75)


def main() -> None:
    """Simulate and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", type=Path, nargs="?", help="npz, or from so101 report-arm")
    parser.add_argument("--lerobot", type=Path, metavar="PATH", help="a LeRobot data set instead")
    parser.add_argument("--arm", choices=sorted(ARMS), help="rated volts; as reported, else 7.4")
    parser.add_argument("--save", metavar="WORDS", help="whose recordings; writes the figures")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw a step, a sine and a rest")
    asked = parser.parse_args()
    path = asked.lerobot or asked.recordings
    if path is None:
        parser.error("give a file of recordings, or --lerobot and a data set")
    recordings = load_lerobot(path) if asked.lerobot else load(path)
    arm = ARMS[asked.arm] if asked.arm else arm_of(path) or ARMS["7.4"]
    positions = emulate(list(recordings.values()), arm)
    zero = zeros(list(recordings.values()), positions)
    rows = list(figures(recordings, positions, zero))
    if asked.plot:
        pairs = zip(recordings.items(), positions, strict=True)
        draw({name: Motion(each, found, zero) for (name, each), found in pairs}, asked.plot)
    if asked.save:
        counts = {"what": f"recordings: {asked.save}", "n": len(recordings)}
        _common.write("bench_real_arm", [counts, *rows])
    else:
        _common.print_table("bench_real_arm", rows)
    print(f"{rows[0]['arm']:.5f} rad mean absolute error over the five arm joints")


if __name__ == "__main__":
    main()
