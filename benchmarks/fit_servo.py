"""Fit the servo model to recordings of a real STS3215: ``python -m benchmarks.fit_servo PATH``.

PATH is an ``.npz`` file or a folder of them; ``servo_model.load`` says what is in one. The fit
minimises the mean absolute error over all samples by Gauss-Newton with weights 1 / |error|
(iteratively reweighted least squares), from the parameters in ``servo_model.Parameters``.

Prints the parameters with the spread over bootstraps (recordings drawn with replacement), the error
by motion, gain and mass, and on request what each term is worth (``--without-each-term``), the
cross-validation (``--cross-validate``: one gain or one mass left out, the rest fitted), and a
picture of measured against modelled motion (``--plot FILE``).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.servo_model import Array, Parameters, Recordings, load, simulate, varied

FITTED = tuple(Parameters.names())
WITHOUT: Mapping[str, Mapping[str, float]] = {
    "speed limit of the set-point": {"speed_limit": 1e3},
    "delay of the goal": {"goal_delay": 0.0},
    "delay in the loop": {"loop_delay": 0.0},
    "load friction": {
        "load_external": 0.0, "load_motor": 0.0, "still_external": 0.0, "still_motor": 0.0,
    },
    "additional friction at rest": {"still_external": 0.0, "still_motor": 0.0},
    "viscous damping": {"viscous": 0.0},
    "shape of the duty": {"duty_shape": 1.0},
}  # fmt: skip
"""Parts of the model to leave out, to see how much each improves the fit."""

_SMALLEST_ERROR = 0.002  # [rad], one and a half ticks: smaller errors weigh no more
_ABSOLUTE_STEP = {"goal_delay": 1e-3, "loop_delay": 1e-3}
_DAMPING = (0.0, 1e-3, 1e-2, 0.1, 1.0)


def fit(
    recordings: Recordings,
    start: Parameters,
    names: Collection[str] = FITTED,
    *,
    dt: float,
    rounds: int,
) -> tuple[Parameters, float]:
    """The best parameters found and their mean absolute error [rad]."""
    steps = [
        (name, _ABSOLUTE_STEP.get(name, max(abs(getattr(start, name)) * 0.02, 1e-3)))
        for name in names
    ]
    best, error = start, np.inf
    for _ in range(rounds):
        found = simulate(recordings, varied(best, steps), dt=dt)
        error = float(recordings.error(found[0]))
        off = (found[0] - recordings.position)[recordings.valid]
        slopes = np.stack(
            [
                (found[i] - found[0])[recordings.valid] / step
                for i, (_, step) in enumerate(steps, start=1)
            ],
            axis=1,
        )
        trials = [best, *(_moved(best, steps, change) for change in _changes(off, slopes))]
        stacked = Parameters(
            **{name: np.array([getattr(t, name) for t in trials]) for name in Parameters.names()}
        )
        errors = recordings.error(simulate(recordings, stacked, dt=dt))
        winner = int(np.nanargmin(errors))
        gained = error - float(errors[winner])
        best, error = trials[winner], float(errors[winner])
        if gained < 2e-6:
            break
    return best, error


def _changes(off: Array, slopes: Array) -> Iterator[Array]:
    """Gauss-Newton steps, less and less daring."""
    weights = 1.0 / np.maximum(np.abs(off), _SMALLEST_ERROR)
    curvature = slopes.T @ (slopes * weights[:, None])
    gradient = slopes.T @ (weights * off)
    scale = np.sqrt(np.diag(curvature)) + 1e-9
    shape = curvature / np.outer(scale, scale)
    for damping in _DAMPING:
        eye = (damping + 1e-9) * np.eye(len(scale))
        change = -np.linalg.solve(shape + eye, gradient / scale) / scale
        yield change
        yield 0.5 * change


def _moved(at: Parameters, steps: list[tuple[str, float]], change: Array) -> Parameters:
    moved = {
        name: max(float(getattr(at, name) + by), 0.0)
        for (name, _), by in zip(steps, change, strict=True)
    }
    return replace(at, **moved)


def by_group(recordings: Recordings, position: Array) -> dict[str, float]:
    """Mean absolute error by motion, by gain and by mass [rad]."""
    found = {}
    for title, values in (
        ("", recordings.kind), ("kp ", recordings.kp), ("kg ", recordings.mass),
    ):  # fmt: skip
        for value in np.unique(values):
            rows = values == value
            found[f"{title}{value}"] = float(recordings[rows].error(position[rows]))
    return found


def cross_validated(recordings: Recordings, start: Parameters, *, dt: float) -> dict[str, float]:
    """Error on what was left out, by what it was [rad]; and the means over gains and masses."""
    found = {}
    for title, values in (("kp", recordings.kp), ("mass", recordings.mass)):
        errors = []
        for value in np.unique(values):
            kept, left = recordings[values != value], recordings[values == value]
            best, _ = fit(kept, start, dt=dt, rounds=6)
            error = float(left.error(simulate(left, best)[0]))
            found[f"without {title} {value:g}, on it"] = error
            errors.append((error, left.valid.sum()))
        sizes = np.array([size for _, size in errors])
        found[f"leave one {title} out"] = float(np.array([e for e, _ in errors]) @ sizes) / float(
            sizes.sum()
        )
    return found


def spread(recordings: Recordings, best: Parameters, *, rounds: int, dt: float) -> dict[str, float]:
    """Standard deviation of each parameter over bootstraps."""
    random = np.random.default_rng(7)
    found: dict[str, list[float]] = {name: [] for name in FITTED}
    for _ in range(rounds):
        drawn = recordings[random.integers(len(recordings), size=len(recordings))]
        again, _ = fit(drawn, best, dt=dt, rounds=3)
        for name in FITTED:
            found[name].append(float(getattr(again, name)))
    return {name: float(np.std(values)) for name, values in found.items()}


def draw(recordings: Recordings, position: Array, file: Path) -> None:
    """Draw measured against modelled: of each motion the recording with the median error."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    off = np.where(recordings.valid, np.abs(position - recordings.position), 0.0).mean(axis=1)
    kinds = np.unique(recordings.kind)
    figure, axes = pyplot.subplots((len(kinds) + 1) // 2, 2, figsize=(10, 6.5), squeeze=False)
    for place, kind in zip(axes.flat, kinds, strict=False):
        of_kind = np.flatnonzero(recordings.kind == kind)
        i = of_kind[np.argsort(off[of_kind])[len(of_kind) // 2]]
        shown = np.where(recordings.valid[i], recordings.position[i], np.nan)
        place.plot(recordings.t[i], recordings.goal[i], ":", color="0.6", label="goal")
        place.plot(recordings.t[i], shown, color="black", label="measured")
        place.plot(recordings.t[i], position[i], color="tab:orange", lw=1.0, label="emulated")
        weight = (
            f"P {recordings.kp[i]:g}, {recordings.mass[i]:.2f} kg at {recordings.length[i]:g} m"
        )
        place.set_title(f"{kind}, {weight}: {off[i]:.4f} rad off", fontsize=8)
        place.set_ylabel("rad", fontsize=8)
        place.tick_params(labelsize=7)
    for place in axes.flat[len(kinds) :]:
        place.axis("off")
    handles, labels = axes[0][0].get_legend_handles_labels()
    axes.flat[-1].legend(handles, labels, loc="center", fontsize=9)
    figure.tight_layout()
    figure.savefig(file, dpi=75)


def _print(title: str, values: Mapping[str, Any]) -> None:
    print(f"\n{title}")
    for name, value in values.items():
        print(f"  {name:34s} {value}")


def main() -> None:
    """Fit, and say how good it is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--rounds", type=int, default=12)
    parser.add_argument("--bootstraps", type=int, default=0)
    parser.add_argument("--cross-validate", action="store_true")
    parser.add_argument("--without-each-term", action="store_true")
    parser.add_argument("--plot", type=Path)
    asked = parser.parse_args()
    begin = time.monotonic()
    recordings = load(asked.recordings)
    spikes = int((~recordings.valid).sum())
    print(f"{asked.recordings}: {len(recordings)} recordings, {spikes} failed readings left out")
    best, _ = fit(recordings[::3], Parameters(), dt=2e-3, rounds=asked.rounds)
    best, error = fit(recordings, best, dt=1e-3, rounds=asked.rounds)
    wide = spread(recordings, best, rounds=asked.bootstraps, dt=2e-3) if asked.bootstraps else {}
    _print(
        "parameters",
        {
            name: f"{getattr(best, name):.5g}" + (f" +- {wide[name]:.2g}" if wide else "")
            for name in FITTED
        },
    )
    position = simulate(recordings, best)[0]
    _print(
        "mean absolute error [rad]",
        {name: f"{value:.4f}" for name, value in by_group(recordings, position).items()},
    )
    if asked.without_each_term:
        worth = {}
        for title, off in WITHOUT.items():
            names = [name for name in FITTED if name not in off]
            without, _ = fit(recordings, replace(best, **off), names, dt=2e-3, rounds=6)
            worth[title] = f"{float(recordings.error(simulate(recordings, without)[0])):.4f}"
        _print("refitted without", worth)
    if asked.cross_validate:
        checked = cross_validated(recordings, best, dt=2e-3)
        _print("cross-validated", {name: f"{value:.4f}" for name, value in checked.items()})
    if asked.plot:
        draw(recordings, position, asked.plot)
    print(f"\n{time.monotonic() - begin:.0f} s")
    print(f"{error:.5f} rad mean absolute error over all samples")


if __name__ == "__main__":
    main()
