"""Scenes and problems for the planning benchmarks, made from seeds.

Eight sets of 100 pairs of free configurations:

- ``empty``: the arm on its table, any two configurations.
- ``table``: three boxes on the table, any two configurations.
- ``opposite``: the same boxes, start and goal on opposite sides and low, the straight joint line
  blocked.
- ``shelf``: an open shelf of two storeys and two bays, each 15 cm wide and 14 cm high, in 8 mm
  boards; into a bay from outside, or from bay to bay.
- ``slot``: a wall with an upright slot of 80 mm; from beside the arm through it.
- ``cage``: 60 small boxes all around, any two configurations.
- ``bins``: two open bins, from low in one to low in the other.
- ``bookshelf``: the shelf as a cloud of 50,000 points in cubes of 5 mm.

In the last four the straight joint line is blocked in all problems.

Ends keep a millimetre more than the planning margin, so that no planner fails over rounding at an
end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import MARGIN, Box, Obstacle, PointCloud, Scene
from so101_motion.planning.kinematics.arm_geometry import JOINT_SLACK, ArmStructure
from so101_motion.planning.kinematics.batch_ik import configurations, facing, hands
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel

COUNT = 100
"""Problems of each set."""

BOARD = 0.008
"""Thickness of the shelf's boards [m]."""

_ROOM = 0.001
"""Distance of starts and goals from obstacles beyond the margin [m]."""

_BAY_Y = (-0.079, 0.079)
_BAY_Z = (0.10, 0.24)
_BAY_X = (0.24, 0.38)
_WITHIN = 0.045
"""How far from a bay's centre line the finger's tip may be [m]."""

_LOW = 0.25
"""Tips of the opposite set are below this [m]."""


def at_pitch(
    structure: ArmStructure, p_base: ArrayLike, pitch: float, roll: float, frame: str = "jaw_tip"
) -> Array:
    """The configurations (n, 5) [rad] of a frame at a point [m] with a pitch and a roll [rad]."""
    rolls = np.full((1, 1, 1), roll)
    hand = hands(structure, frame, rolls)
    target = facing(structure, np.asarray(p_base)[None], hand.lateral)
    grid = configurations(structure, target, hand, np.full((1, 1, 1), pitch), rolls)
    return grid.q[grid.excess <= JOINT_SLACK]


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

_SLOT = (
    _box("left of the slot", (BOARD, 0.30, 0.50), (0.24, 0.19, 0.25)),
    _box("right of the slot", (BOARD, 0.30, 0.50), (0.24, -0.19, 0.25)),
)


def _cage() -> tuple[Obstacle, ...]:
    """Boxes of 2 to 6 cm, none nearer than 12 cm to the pan's axis or in the middle of the air."""
    random = np.random.default_rng(60)
    boxes: list[Obstacle] = []
    while len(boxes) < 60:
        x, y, z = random.uniform((-0.25, -0.4, 0.0), (0.45, 0.4, 0.5))
        if np.hypot(x - 0.04, y) > 0.12 and 0.26 < np.linalg.norm((x - 0.04, y, z - 0.12)) < 0.5:
            size = random.uniform(0.02, 0.06, 3)
            boxes.append(_box(f"box {len(boxes)}", tuple(size), (x, y, z)))
    return tuple(boxes)


def _bin(side: str, y: float) -> tuple[Obstacle, ...]:
    x, deep, wide, high = 0.24, 0.16, 0.16, 0.10
    return (
        _box(f"{side} bottom", (deep, wide, BOARD), (x, y, 0.006)),
        *(
            _box(f"{side} wall {k}", (BOARD, wide, high), (x + k * deep / 2, y, high / 2))
            for k in (-1, 1)
        ),
        *(
            _box(f"{side} end {k}", (deep, BOARD, high), (x, y + k * wide / 2, high / 2))
            for k in (-1, 1)
        ),
    )


def _seen(boxes: tuple[Obstacle, ...], count: int, resolution: float) -> Obstacle:
    """Points on the surfaces of boxes, as a camera that sees all sides would see them."""
    random = np.random.default_rng(50)
    sizes = np.array([box.shape.size for box in boxes if isinstance(box.shape, Box)])
    areas = sizes[:, [1, 2, 0]] * sizes[:, [2, 0, 1]]
    at = random.choice(areas.size, count, p=areas.ravel() / areas.sum())
    points = random.uniform(-0.5, 0.5, (count, 3))
    points[np.arange(count), at % 3] = random.choice((-0.5, 0.5), count)
    middles = np.array([box.T_base_obstacle.p for box in boxes])
    cloud = PointCloud(points=points * sizes[at // 3] + middles[at // 3], resolution=resolution)
    return Obstacle(name="cloud", shape=cloud, T_base_obstacle=SE3.identity())


SCENES: dict[str, Scene] = {
    "empty": Scene(),
    "table": Scene(obstacles=_TABLE),
    "opposite": Scene(obstacles=_TABLE),
    "shelf": Scene(obstacles=_SHELF),
    "slot": Scene(obstacles=_SLOT),
    "cage": Scene(obstacles=_cage()),
    "bins": Scene(obstacles=(*_bin("left", 0.15), *_bin("right", -0.15))),
    "bookshelf": Scene(obstacles=(_seen(_SHELF, 50_000, 0.005),)),
}


def _thousand_boxes() -> Scene:
    random, boxes = np.random.default_rng(70), list[Obstacle]()
    while len(boxes) < 1000:
        at = random.uniform((-0.45, -0.45, 0.0), (0.5, 0.45, 0.5))
        if np.hypot(at[0] - 0.04, at[1]) > 0.2:
            boxes.append(_box(f"box {len(boxes)}", tuple(random.uniform(0.01, 0.03, 3)), tuple(at)))
    return Scene(obstacles=tuple(boxes))


def _million_points() -> Scene:
    around = (
        _box("table", (0.4, 1.0, 0.002), (0.4, 0.0, 0.001)),
        _box("wall", (0.002, 1.0, 0.5), (0.38, 0.0, 0.25)),
    )
    return Scene(obstacles=(_seen(around, 1_000_000, 0.002),))


CROWDED: dict[str, Callable[[], Scene]] = {
    "1,000 boxes": _thousand_boxes,
    "a million points in cubes of 2 mm": _million_points,
}
"""Scenes for checks alone."""


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
        while True:
            y, z = (
                centre + self.random.uniform(-_WITHIN, _WITHIN)
                for centre in (_BAY_Y[k % 2], _BAY_Z[k // 2])
            )
            x, pitch = self.random.uniform(*_BAY_X), self.random.uniform(-1.2, 1.2)
            roll = self.random.uniform(self.model.lower[4], self.model.upper[4])
            for q in at_pitch(structure, (x, y, z), pitch, roll):
                if self.model.outside(q) is None and self._collision.is_free(q):
                    return np.asarray(q)

    def within(self, lower: tuple[float, ...], upper: tuple[float, ...]) -> Array:
        """The tip in a box of the air."""
        structure = self._ik.structure
        while True:
            at = self.random.uniform(lower, upper)
            pitch = self.random.uniform(-1.57, 1.57)
            roll = self.random.uniform(self.model.lower[4], self.model.upper[4])
            for q in at_pitch(structure, at, pitch, roll):
                if self.model.outside(q) is None and self._collision.is_free(q):
                    return np.asarray(q)

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


def _slot(source: _Source, k: int) -> Problem:
    side = 1.0 if k % 2 else -1.0
    while True:
        goal = source.within((0.27, -0.03, 0.08), (0.38, 0.03, 0.3))
        problem = Problem(source.low(side), goal)
        if source.tip(problem.start)[0] < 0.22 and not source.is_straight(problem):
            return problem


def _any_blocked(source: _Source, k: int) -> Problem:
    while True:
        problem = Problem(source.any(), source.any())
        if not source.is_straight(problem):
            return problem


def _bin_to_bin(source: _Source, k: int) -> Problem:
    side = 1.0 if k % 2 else -1.0
    while True:
        first, second = (
            source.within((0.19, y - 0.05, 0.02), (0.29, y + 0.05, 0.07))
            for y in (0.15 * side, -0.15 * side)
        )
        if not source.is_straight(Problem(first, second)):
            return Problem(first, second)


def _shelf_blocked(source: _Source, k: int) -> Problem:
    while True:
        problem = _shelf(source, k)
        if not source.is_straight(problem):
            return problem


_MAKERS: dict[str, tuple[int, Callable[[_Source, int], Problem]]] = {
    "empty": (11, lambda source, _: Problem(source.any(), source.any())),
    "table": (12, lambda source, _: Problem(source.any(), source.any())),
    "opposite": (15, _opposite),
    "shelf": (13, _shelf),
    "slot": (16, _slot),
    "cage": (17, _any_blocked),
    "bins": (18, _bin_to_bin),
    "bookshelf": (19, _shelf_blocked),
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
