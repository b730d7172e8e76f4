"""Problems without a path, and solvable ones with gaps hardly wider than what must pass.

An obstacle is *fitted* to a path: moved along a line towards the arm until that would come nearer
than the margin and ``ROOM`` on its way. So a gap between two of them is 2 mm wider than what passes
it, with its margins, and the path is a solution.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import SE3, Array, rot_z
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import MARGIN, Box, Obstacle, Scene
from so101_motion.planning.kinematics.model import RobotModel

ROOM = 0.001
"""Distance of fitted obstacles beyond the margin [m]."""

FAR, EXACT = 0.4, 1e-4
"""Where an obstacle is moved from, and how exactly it is fitted [m]."""

PAN = np.array([0.0388, 0.0, 0.0])
"""A point of the pan axis [m]."""


class Problem(NamedTuple):
    """A scene, and a path in it, shape (m, 5), [rad]; only its ends if there is none."""

    scene: Scene
    path: Array


class _Fitter:
    """Fits boxes to a path (m, 5) [rad]."""

    def __init__(self, model: RobotModel, path: Array) -> None:
        self._model, self._path = model, path
        self.boxes: list[Obstacle] = []

    def add(self, name: str, size: Sequence[float], T: SE3, way: Array) -> None:
        """Move a box along ``way``, of length 1, from ``FAR`` before a pose up to the path."""
        free, blocked = -FAR, FAR
        if not self._is_free(box := _box(name, size, T, free * way)):
            return
        while blocked - free > EXACT:
            middle = 0.5 * (free + blocked)
            if self._is_free(tried := _box(name, size, T, middle * way)):
                free, box = middle, tried
            else:
                blocked = middle
        self.boxes.append(box)

    def _is_free(self, box: Obstacle) -> bool:
        scene = Scene(obstacles=(box,), margin=MARGIN + ROOM)
        return CollisionModel(self._model, scene).first_blocked(self._path) is None

    def problem(self) -> Problem:
        """What there is now."""
        return Problem(Scene(obstacles=tuple(self.boxes)), self._path)


def _box(name: str, size: Sequence[float], T: SE3, moved: Array) -> Obstacle:
    return Obstacle(
        name=name, shape=Box(size=np.array(size)), T_base_obstacle=SE3(T.R, T.p + moved)
    )


def _along(direction: Array, up: Array) -> Array:
    """A rotation with its first axis along a direction, the third as near to ``up`` as can be."""
    first = direction / np.linalg.norm(direction)
    second = np.cross(up, first)
    second /= np.linalg.norm(second)
    return np.column_stack([first, second, np.cross(first, second)])


def tube(model: RobotModel, seed: int) -> Problem:
    """A path of two random lines between 20 to 60 boards at random angles, all fitted to it."""
    random = np.random.default_rng(seed)
    empty, path = CollisionModel(model, Scene(margin=MARGIN + ROOM)), list[Array]()
    step = random.choice([0.15, 0.3, 0.5])
    while len(path) < 3:
        q = random.uniform(model.lower, model.upper)
        if path:
            q = path[-1] + np.clip(q - path[-1], -step, step)
        if empty.first_blocked(np.array([*path[-1:], q])) is None:
            path.append(q)
    fitter = _Fitter(model, np.array(path))
    for k in range(random.choice([20, 40, 60])):
        a, b = path[(i := random.integers(2))], path[i + 1]
        at = model.frame(a + random.uniform() * (b - a), "jaw_tip").p * random.uniform(0.3, 1.0)
        R = _along(random.standard_normal(3), random.standard_normal(3))
        size = (0.008, *random.uniform(0.05, 0.4, 2))
        fitter.add(f"board {k}", size, SE3(R, at), R[:, 0])
    return fitter.problem()


def slot(model: RobotModel, seed: int) -> Problem:
    """A wall with an upright slot, every fourth time a window, and an arm that reaches through."""
    random = np.random.default_rng(seed)
    empty = CollisionModel(model, Scene(margin=MARGIN + ROOM))
    while True:
        pan, roll = random.uniform(model.lower[[0, 4]], model.upper[[0, 4]])
        path = np.array([[pan, *random.uniform(-1.2, 1.2, 3), roll] for _ in range(2)])
        here, there = (model.frame(q, "jaw_tip").p * (1, 1, 0) - PAN for q in path)
        far = np.linalg.norm(there) > 0.24 > 0.17 > np.linalg.norm(here)
        if far and empty.first_blocked(path) is None:
            break
    R = rot_z(random.uniform(-0.4, 0.4) if seed % 3 == 0 else 0.0) @ _along(
        there, np.array([0, 0, 1])
    )
    fitter, at = _Fitter(model, path), PAN + 0.22 * R[:, 0] + (0.0, 0.0, 0.3)
    for name, way in (("left", R[:, 1]), ("right", -R[:, 1])):
        fitter.add(name, (0.008, 0.6, 0.6), SE3(R, at + 0.3 * way), -way)
    for name, way in (("above", R[:, 2]), ("below", -R[:, 2])) if seed % 4 == 0 else ():
        fitter.add(name, (0.008, 0.6, 0.6), SE3(R, at + 0.3 * way), -way)
    return fitter.problem()


def shut_in(model: RobotModel, seed: int) -> Problem:
    """A goal with the lower arm in a window that is fitted to it; the gripper cannot pass."""
    random = np.random.default_rng(seed)
    empty = CollisionModel(model)
    while True:
        q = random.uniform(0.7 * model.lower, 0.7 * model.upper)
        elbow, wrist = (model.frame(q, name).p for name in ("lower_arm_link", "wrist_link"))
        if not (empty.is_free(q) and wrist[2] > 0.12 and np.hypot(*wrist[:2]) > 0.2):
            continue
        R, at = _along(wrist - elbow, np.array([0.0, 0.0, 1.0])), 0.45 * elbow + 0.55 * wrist
        fitter = _Fitter(model, np.array([q, q]))
        for name, way, size in (
            ("left", R[:, 1], (0.008, 0.3, 0.7)),
            ("right", -R[:, 1], (0.008, 0.3, 0.7)),
            ("above", R[:, 2], (0.008, 0.7, 0.3)),
            ("below", -R[:, 2], (0.008, 0.7, 0.3)),
        ):
            fitter.add(name, size, SE3(R, at + 0.15 * way), -way)
        scene = fitter.problem().scene
        free = CollisionModel(model, scene)
        for start in random.uniform(model.lower, model.upper, (300, 5)):
            if len(fitter.boxes) == 4 and free.is_free(start) and np.abs(start - q).max() > 0.5:
                return Problem(scene, np.array([start, q]))


def cut_off(model: RobotModel, seed: int) -> Problem:
    """A goal between two high walls that begin at the arm's axis, and a start beyond them."""
    random = np.random.default_rng(seed)
    while True:
        middle, half = random.uniform(-1.0, 1.0), random.uniform(0.25, 0.7)
        walls = []
        for side, angle in (("left", middle + half), ("right", middle - half)):
            T = SE3(rot_z(angle), PAN)
            walls.append(_box(side, (0.5, 0.006, 0.6), T, T.R @ (0.34, 0.0, 0.3)))
            walls.append(_box(f"inner {side}", (0.1, 0.006, 0.4), T, T.R @ (0.08, 0.0, 0.38)))
        scene = Scene(obstacles=tuple(walls))
        free, ends = CollisionModel(model, scene), dict[bool, Array]()
        for q in random.uniform(model.lower, model.upper, (1000, 5)):
            x, y, _ = model.frame(q, "jaw_tip").p - PAN
            inside = abs((np.arctan2(y, x) - middle + np.pi) % (2.0 * np.pi) - np.pi) < half
            if np.hypot(x, y) > 0.15 and free.is_free(q):
                ends[bool(inside)] = q
        if len(ends) == 2:
            return Problem(scene, np.array([ends[False], ends[True]]))
