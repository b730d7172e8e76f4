"""Calculate the statistics that LeRobot keeps of each column.

Those of an episode are exact. Those of all episodes are combined as LeRobot does it: extremes of
extremes, means weighted by frames, the variance of all, and quantiles as the weighted mean of the
episodes' own. Source: ``aggregate_feature_stats`` of LeRobot 0.6.1.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable

import numpy as np

from so101_motion.common.geometry import Array

Statistics = dict[str, list[float]]
"""Numbers by LeRobot's names: ``min``, ``max``, ``mean``, ``std``, ``count``, ``q01`` ..."""

_QUANTILE = re.compile(r"q\d\d")


def of_episode(values: Array, names: Collection[str]) -> Statistics:
    """The statistics of the rows of an episode, shape (n, d).

    Args:
        values: The rows.
        names: Names of the statistics; unknown ones are left out.
    """
    found: Statistics = {}
    for name in names:
        if name == "count":
            found[name] = [len(values)]
        elif name in ("min", "max", "mean", "std"):
            found[name] = getattr(np, name)(values, axis=0).tolist()
        elif _QUANTILE.fullmatch(name):
            found[name] = np.quantile(values, int(name[1:]) / 100.0, axis=0).tolist()
    return found


def together(episodes: Iterable[Statistics], names: Collection[str]) -> Statistics:
    """Combine the statistics of several episodes, which have count, mean and std.

    Args:
        episodes: At least one.
        names: Names of the statistics; unknown ones are left out.
    """
    every = list(episodes)
    count = np.array([each["count"][0] for each in every], dtype=float)
    weight = (count / count.sum())[:, None]

    def column(name: str) -> Array:
        return np.array([each[name] for each in every], dtype=float)

    mean = (weight * column("mean")).sum(axis=0)
    found: Statistics = {}
    for name in names:
        if name == "count":
            found[name] = [int(count.sum())]
        elif name == "mean":
            found[name] = mean.tolist()
        elif name == "std":
            spread = np.square(column("std")) + np.square(column("mean") - mean)
            found[name] = np.sqrt((weight * spread).sum(axis=0)).tolist()
        elif name in ("min", "max"):
            found[name] = getattr(np, name)(column(name), axis=0).tolist()
        elif _QUANTILE.fullmatch(name):
            found[name] = (weight * column(name)).sum(axis=0).tolist()
    return found
