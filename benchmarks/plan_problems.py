"""The scenes and the problems that planners are measured on, made anew from seeds.

Four sets of 100 pairs of free configurations:

- ``empty``: the arm on its table, any two configurations.
- ``table``: three boxes on the table, any two configurations.
- ``opposite``: the same boxes, start and goal on opposite sides and low, the straight joint line
  blocked.
- ``shelf``: an open shelf of two storeys and two bays, each 15 cm wide and 14 cm high, in 8 mm
  boards; into a bay from outside, or from bay to bay.

Postures are free with a millimetre more than the margin that is planned with, so that no planner
fails over the last bit of an end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import MARGIN, Box, Obstacle, Scene
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel

COUNT = 100
"""Problems of each set."""

BOARD = 0.008
"""Thickness of the shelf's boards [m]."""

_ROOM = 0.001
"""What ends keep beyond the margin [m]."""

_BAY_Y = (-0.079, 0.079)
_BAY_Z = (0.10, 0.24)
_BAY_X = (0.24, 0.38)
_WITHIN = 0.045
"""How far from a bay's centre line the finger's tip may be [m]."""

_LOW = 0.25
"""Tips of the opposite set are below this [m]."""


class Problem(NamedTuple):
    """Two free configurations, shape (5,), [rad]."""

    start: Array
    goal: Array


def _box(name: str, size: tuple[float, ...], at: tuple[float, ...]) -> Obstacle:
    return Obstacle(
        name=name, shape=Box(size=np.array(size)), T_base_obstacle=SE3.from_translation(at)
    )


_TABLE = (
    _box("box ahead", (0.06, 0.10, 0.12), (0.27, 0.0, 0.056)),
    _box("box left", (0.08, 0.08, 0.22), (0.18, 0.21, 0.106)),
    _box("box right", (0.12, 0.06, 0.10), (0.22, -0.19, 0.046)),
)
_SHELF = (
    *(_box(f"board {k}", (0.24, 0.32, BOARD), (0.32, 0.0, 0.03 + 0.14 * k)) for k in range(3)),
    *(_box(f"wall {k}", (0.24, BOARD, 0.28), (0.32, 0.158 * (k - 1), 0.17)) for k in range(3)),
    _box("back", (BOARD, 0.32, 0.28), (0.44, 0.0, 0.17)),
)

SCENES: dict[str, Scene] = {
    "empty": Scene(),
    "table": Scene(obstacles=_TABLE),
    "opposite": Scene(obstacles=_TABLE),
    "shelf": Scene(obstacles=_SHELF),
}


class _Source:
    """Random free configurations in one scene."""

    def __init__(self, model: RobotModel, scene: Scene, seed: int) -> None:
        self.model = model
        self.random = np.random.default_rng(seed)
        self._ik = IkSolver(model)
        self._collision = CollisionModel(model, replace(scene, margin=MARGIN + _ROOM))

    def any(self) -> Array:
        """Any free configuration."""
        while True:
            q = self.random.uniform(self.model.lower, self.model.upper)
            if self._collision.is_free(q):
                return q

    def tip(self, q: Array) -> Array:
        """Where the finger's tip is, shape (3,), [m]."""
        return self.model.frame(q, "jaw_tip").p

    def low(self, side: float) -> Array:
        """The tip low, and on the left for a ``side`` of 1, on the right for -1."""
        while True:
            q = self.any()
            x, y, z = self.tip(q)
            if x > 0.1 and side * y > 0.08 and z < _LOW:
                return q

    def in_bay(self, k: int) -> Array:
        """The tip in bay ``k`` of the shelf, 0 to 3."""
        structure = self._ik.structure
        assert structure is not None
        while True:
            y, z = (
                centre + self.random.uniform(-_WITHIN, _WITHIN)
                for centre in (_BAY_Y[k % 2], _BAY_Z[k // 2])
            )
            x, pitch = self.random.uniform(*_BAY_X), self.random.uniform(-1.2, 1.2)
            roll = self.random.uniform(self.model.lower[4], self.model.upper[4])
            for configuration in structure.configurations((x, y, z), pitch, roll, "jaw_tip"):
                q = np.array(configuration.q)
                if self.model.outside(q) is None and self._collision.is_free(q):
                    return q

    def outside(self) -> Array:
        """The tool not in or before the shelf."""
        while True:
            q = self.any()
            x, y, _ = self.model.frame(q).p
            if x < 0.17 or abs(y) > 0.2:
                return q

    def is_straight(self, problem: Problem) -> bool:
        """Whether the straight joint line is free."""
        return self._collision.first_blocked(np.array(problem)) is None


def _opposite(source: _Source, k: int) -> Problem:
    side = 1.0 if k % 2 else -1.0
    while True:
        problem = Problem(source.low(side), source.low(-side))
        if not source.is_straight(problem):
            return problem


def _shelf(source: _Source, k: int) -> Problem:
    first, second = source.random.choice(4, 2, replace=False)
    goal = source.in_bay(int(second))
    return Problem(source.in_bay(int(first)) if k % 2 else source.outside(), goal)


_MAKERS: dict[str, tuple[int, Callable[[_Source, int], Problem]]] = {
    "empty": (11, lambda source, _: Problem(source.any(), source.any())),
    "table": (12, lambda source, _: Problem(source.any(), source.any())),
    "opposite": (15, _opposite),
    "shelf": (13, _shelf),
}


def problems(model: RobotModel, name: str, count: int = COUNT) -> list[Problem]:
    """The problems of a set, the same every time.

    Args:
        model: The arm.
        name: A key of ``SCENES``.
        count: How many.
    """
    seed, make = _MAKERS[name]
    source = _Source(model, SCENES[name], seed)
    return [make(source, k) for k in range(count)]
