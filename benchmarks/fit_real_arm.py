"""Fit the friction of the emulated arm on one half of a real arm's recordings, test on the other.

``python -m benchmarks.fit_real_arm FILE.npz`` prints the error on both halves with the committed
``STS3215_7V4``, and after ``_FITTED`` was fitted on one half alone: Gauss-Newton with weights
1 / |error|, one unknown constant a joint. Halves: every second motion in the order of the names.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.bench_real_arm import zeros
from benchmarks.emulated_arm import ARMS, Array, Recording, emulate, load

_FITTED = ("armature", "coulomb", "load_external", "load_motor", "still_external", "play")
_STEP, _ROUNDS, _LEAST = 0.1, 3, 1e-3
"""Change of a figure for its derivative, as a share; steps; error below which weights are equal."""


def errors(recordings: Sequence[Recording], logs: Array) -> Array:
    """Emulated minus measured angles with figures changed by ``exp(logs)``, shape (k, 5), [rad]."""
    arm, kind = ARMS["7.4"], ARMS["7.4"].kind
    changed = {
        name: getattr(kind, name) * float(np.exp(log))
        for name, log in zip(_FITTED, logs, strict=True)
    }
    positions = emulate(recordings, replace(arm, kind=replace(kind, **changed)))
    pairs = zip(recordings, positions, strict=True)
    off = np.concatenate([found[:, :5] - each["position"][:, :5] for each, found in pairs])
    return np.asarray(off - zeros(list(recordings), positions))


def fit(recordings: Sequence[Recording]) -> Array:
    """How the figures differ from the committed ones, as logarithms."""
    logs = np.zeros(len(_FITTED))
    best = errors(recordings, logs)
    for _ in range(_ROUNDS):
        slopes = [
            (errors(recordings, logs + _STEP * unit) - best).ravel() / _STEP
            for unit in np.eye(len(_FITTED))
        ]
        jacobian, off = np.column_stack(slopes), best.ravel()
        weighted = jacobian.T / np.maximum(np.abs(off), _LEAST)
        step = np.linalg.lstsq(weighted @ jacobian, -weighted @ off, rcond=None)[0]
        tried = logs + np.clip(step, -0.3, 0.3)
        now = errors(recordings, tried)
        if np.abs(now).mean() >= np.abs(best).mean():
            break
        logs, best = tried, now
    return logs


def main() -> None:
    """Fit and test both ways."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("recordings", type=Path)
    every = list(load(parser.parse_args().recordings).values())
    halves, as_committed = (every[0::2], every[1::2]), np.zeros(len(_FITTED))
    for fitted, tested in (halves, halves[::-1]):
        logs = fit(fitted)
        for name, found in (("committed", as_committed), ("fitted", logs)):
            means = [np.abs(errors(half, found)).mean() for half in (fitted, tested)]
            print(f"{name}: {means[0]:.5f} rad on this half, {means[1]:.5f} on the other")
        factors = zip(_FITTED, np.exp(logs), strict=True)
        print(*(f"{name} x {factor:.2f}" for name, factor in factors), flush=True)


if __name__ == "__main__":
    main()
