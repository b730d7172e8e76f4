"""Compare the emulated servo with a real one: ``python -m benchmarks.bench_truth PATH``.

PATH has recordings for ``benchmarks.servo_model.load``; none of them is part of this project. Each
recording is simulated whole, open loop, from its first measured position at rest, with the
parameters of the emulator's ``STS3215_12V``. ``--emulator`` drives the
emulated servo itself, through its registers, instead of the vectorised model; ``--datasheet`` does
the same with the servo that the datasheet describes. ``--save WORDS`` compares all three and writes
the figures, and nothing of the recordings but what WORDS say of them, to ``results/``.

Prints the error by motion, gain and mass; how far from its goal the servo rests, and how fast its
steps are, measured and modelled. The last line begins with the mean over all samples of
|measured - modelled| in radians; samples without torque count.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common
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

    Columns: which recording, which of ``_ARRIVALS``, measured, modelled [rad].
    """
    found = []
    for i in range(len(recordings)):
        if recordings.kind[i] == _UP_AND_DOWN:  # its goal is slow, but never still
            top = int(np.argmax(recordings.goal[i])) + 10
            for arrival, last in ((2.0, slice(top, top + 10)), (-2.0, slice(-10, None))):
                both = recordings.position[i], position[i]
                off = [np.mean(recordings.goal[i][last] - each[last]) for each in both]
                found.append([i, arrival, *off])
        for start, end in _holds(recordings, i):
            last, measured = slice(end - 10, end), recordings.position[i]
            rests = np.ptp(measured[end - 20 : end]) < _STILL
            if rests and recordings.valid[i, end - 20 : end].all():
                goal = recordings.goal[i, end - 1]
                came_from = measured[start]
                upwards = np.sign((goal - came_from) * np.sign(np.sin(goal)))
                off = [goal - np.mean(each[last]) for each in (measured, position[i])]
                found.append([i, upwards, *off])
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


FORMS: Mapping[str, Callable[[Recordings], Array]] = {
    "model": lambda recordings: simulate(recordings, Parameters())[0],
    "emulator": emulate,
    "datasheet": lambda recordings: emulate(recordings, _DATASHEET),
}
"""The servo in its forms: the continuous model, the emulated servo through its registers, and an
emulated servo as the datasheet has it."""

Row = dict[str, Any]


def figures(recordings: Recordings, positions: Mapping[str, Array]) -> Iterator[Row]:
    """One row a figure, with a column for each form of the servo."""
    yield {
        "what": "error, all samples [rad]",
        **{form: float(recordings.error(position)) for form, position in positions.items()},
    }
    errors = {form: by_group(recordings, position) for form, position in positions.items()}
    for name in next(iter(errors.values())):
        row = {form: by_name[name] for form, by_name in errors.items()}
        yield {"what": f"error, {name} [rad]", **row}
    whole = recordings.valid.all(axis=1)
    worst = {
        form: float(np.abs(position - recordings.position)[whole].mean(axis=1).max())
        for form, position in positions.items()
    }
    yield {"what": "error, worst recording [rad]", **worst}
    yield from _at_rest(recordings, positions)
    steps = {form: step_times(recordings, position) for form, position in positions.items()}
    for share, (measured, _) in next(iter(steps.values())).items():
        row = {form: times[share][1] for form, times in steps.items()}
        yield {"what": f"{share} of a step after [s]", "measured": measured, **row}


def _at_rest(recordings: Recordings, positions: Mapping[str, Array]) -> Iterator[Row]:
    found = {form: stand_offs(recordings, position) for form, position in positions.items()}
    of, arrivals, measured, _ = next(iter(found.values())).T
    measured, of = np.degrees(measured), of.astype(int)
    modelled = {form: np.degrees(rows[:, 3]) for form, rows in found.items()}
    off = {form: np.abs(each - measured) for form, each in modelled.items()}
    for kp in np.unique(recordings.kp):
        for arrival, name in _ARRIVALS.items():
            rows = (recordings.kp[of] == kp) & (arrivals == arrival)
            if not rows.any():
                continue
            what = f"at rest, P {kp:g}, {name}"
            means = {form: float(np.abs(each[rows]).mean()) for form, each in modelled.items()}
            is_at = float(np.abs(measured[rows]).mean())
            yield {"what": f"{what} [deg]", "n": int(rows.sum()), "measured": is_at, **means}
            yield {"what": f"{what}, off by at most [deg]", **_each(off, rows, np.max)}
    for title, values in (("P", recordings.kp), ("kg", recordings.mass), ("m", recordings.length)):
        for value in np.unique(values):
            rows = values[of] == value
            beyond = _each(off, rows, lambda each: np.sum(each > 1.0))
            what = f"at rest, {title} {value:g}, more than 1 deg off [cases]"
            yield {"what": what, "n": int(rows.sum()), **beyond}
    for what, reduce in (
        ("off, mean [deg]", np.mean), ("off by at most [deg]", np.max),
        ("within 1 deg [share]", lambda each: np.mean(each <= 1.0)),
    ):  # fmt: skip
        row = _each(off, np.ones(len(of), bool), reduce)
        yield {"what": f"at rest, all, {what}", "n": len(of), **row}


def _each(off: Mapping[str, Array], rows: Array, reduce: Callable[[Array], Any]) -> Row:
    return {form: float(reduce(each[rows])) for form, each in off.items()}


def main() -> None:
    """Simulate and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--emulator", action="store_true", help="drive the emulated servo itself")
    parser.add_argument("--datasheet", action="store_true", help="the datasheet's servo instead")
    parser.add_argument("--save", metavar="WORDS", help="whose recordings; writes all figures")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw one of each motion")
    asked = parser.parse_args()
    recordings = load(asked.recordings)
    form = "datasheet" if asked.datasheet else "emulator" if asked.emulator else "model"
    forms = [form, *(each for each in FORMS if each != form)] if asked.save else [form]
    if np.isfinite(recordings.inertia).any() and forms != ["model"]:
        parser.error("these are an arm's recordings; the emulated servo is only put on a pendulum")
    positions = {each: FORMS[each](recordings) for each in forms}
    if asked.plot:
        draw(recordings, positions[form], asked.plot)
    spikes = int((~recordings.valid).sum())
    print(f"{asked.recordings}: {len(recordings)} recordings, {spikes} failed readings left out")
    rows = list(figures(recordings, positions))
    if asked.save:
        counts = {
            f"recordings: {asked.save}": len(recordings), "failed readings, left out": spikes,
        }  # fmt: skip
        _common.write("bench_truth", [*({"what": k, "n": n} for k, n in counts.items()), *rows])
    else:
        _common.print_table("bench_truth", rows)
    error = recordings.error(positions[form])
    print(f"{float(error):.5f} rad mean absolute error over all samples")


if __name__ == "__main__":
    main()
