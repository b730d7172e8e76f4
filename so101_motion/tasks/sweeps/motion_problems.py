"""Read motion problems from a file, and scatter the obstacles of scenes.

A file of problems has starts and goals in degrees::

    {
     "schema": "so101/problems/1",
     "problems": [{"start_deg": [0, -30, 30, 45, 0], "goal_deg": [40, -20, 20, 60, 0]}]
    }
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.common.attributes import Attributes
from so101_motion.common.errors import ConfigError
from so101_motion.common.units import to_mm, to_rad
from so101_motion.files import user_storage

SCHEMA = "so101/problems/1"

MOST_GIVEN = 10_000
"""Most problems of a file: all of them are sent with every shard. Chosen."""

_SCATTER = 1
"""Keeps the random numbers of scenes different from those of problems."""

Problem = tuple[tuple[float, ...], tuple[float, ...]]
"""Five joint angles at the start and at the goal [rad]."""


def read_problems(path: Path) -> tuple[Problem, ...]:
    """Read the problems in a file.

    Raises:
        ConfigError: It cannot be read, or something in it is not valid; the message names it.
    """
    content = Attributes(
        user_storage.read(path, schema=SCHEMA), ("schema", "problems"), kind="entry of problems"
    )
    problems = content.objects("problems")
    if not problems:
        raise ConfigError("problems", [], "must have at least one problem")
    return tuple(_problem(number, each) for number, each in enumerate(problems))


def _problem(number: int, entry: Mapping[str, object]) -> Problem:
    given = Attributes(entry, ("start_deg", "goal_deg"), kind=f"entry of problem {number}")
    ends = []
    for key in ("start_deg", "goal_deg"):
        angles = given.numbers(key, count=5, lower=-360.0, upper=360.0)
        if len(angles) != 5:
            raise ConfigError(f"problem {number}: {key}", list(angles), "must be five angles [deg]")
        ends.append(tuple(to_rad(np.array(angles)).tolist()))
    return ends[0], ends[1]


def scene_of_shard(
    scenes: Sequence[Mapping[str, Any]], scatter: float, seed: int, shard: int
) -> Mapping[str, Any]:
    """The scene of a shard, as JSON values.

    Args:
        scenes: Shards take them in turn.
        scatter: How far each obstacle is moved at most along x and y, differently in each shard
            [m].
        seed: The sweep's seed.
        shard: The shard's number.
    """
    scene = scenes[shard % len(scenes)]
    if scatter == 0.0:
        return scene
    random = np.random.default_rng((seed, shard, _SCATTER))
    obstacles = []
    for each in scene.get("obstacles", ()):
        x, y, z = each.get("position_mm", (0.0, 0.0, 0.0))
        dx, dy = to_mm(random.uniform(-scatter, scatter, 2)).tolist()
        obstacles.append({**each, "position_mm": [x + dx, y + dy, z]})
    return {**scene, "obstacles": obstacles}
