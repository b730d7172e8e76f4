"""Shade what the gripper reaches at the height of the target, while the target is dragged."""

from __future__ import annotations

from itertools import product

import numpy as np
import viser

from so101_motion.common.geometry import Array
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.model import RobotModel

_SAMPLES = (40, 40, 24)
"""Angles of lift, elbow and wrist that are tried; chosen: takes some hundredths of a second."""

_BAND, _CELL, _GAP = 0.012, 0.01, 0.04
"""How near in height a sample must be, the least width of a ring, and the least gap between two of
them [m]. Chosen: the edge of the shade is within 15 mm of the true one."""

_COLOR, _OPACITY = (47, 158, 68), 0.22
_SECTORS = 72


class Reach:
    """How far a frame reaches, whatever the obstacles and the gripper's direction.

    Attributes:
        pan: The least and the largest angle about the base [rad].
        axis: Where the base turns, shape (2,), [m].
    """

    def __init__(self, model: RobotModel, frame: str) -> None:
        lower, upper = model.lower, model.upper
        self.pan = (float(lower[0]), float(upper[0]))
        grids = [np.linspace(lower[k + 1], upper[k + 1], n) for k, n in enumerate(_SAMPLES)]
        q = np.zeros((int(np.prod(_SAMPLES)), 5))
        q[:, 1:4] = np.stack(np.meshgrid(*grids, indexing="ij"), axis=-1).reshape(-1, 3)
        p = ArmChain(model, frame).positions(q)
        self.axis = model.link_placements(np.zeros(5), 0.0)["shoulder_link"].p[:2]
        p = p[p[:, 0] >= self.axis[0]]  # else it reaches back over the base
        self._away = np.hypot(*(p[:, :2] - self.axis).T)
        self._height = p[:, 2]

    def rings(self, height: float) -> list[tuple[float, float]]:
        """The inner and outer radius of each ring that is within reach at a height [m]."""
        away = np.sort(self._away[np.abs(self._height - height) < _BAND])
        if len(away) == 0:
            return []
        begins = np.flatnonzero(np.diff(away, prepend=-np.inf) > _GAP)
        ends = np.append(begins[1:], len(away)) - 1
        found = zip(away[begins], away[ends], strict=True)
        return [(float(a), float(b)) for a, b in found if b - a > _CELL]


class ReachView:
    """A shade at the height of a target."""

    def __init__(self, scene: viser.SceneApi, model: RobotModel) -> None:
        self._scene, self._model = scene, model
        self._known: dict[str, Reach] = {}
        self._node: viser.SceneNodeHandle | None = None
        self._shown: tuple[str, int] | None = None

    def show(self, frame: str, height: float) -> None:
        """Shade what ``frame`` reaches at ``height`` [m]."""
        step = round(height / _CELL)
        if self._shown == (frame, step):
            return
        self.hide()
        self._shown = frame, step
        if frame not in self._known:
            self._known[frame] = Reach(self._model, frame)
        reach = self._known[frame]
        rings = reach.rings(step * _CELL)
        if rings:
            vertices, faces = mesh(reach, rings, step * _CELL)
            self._node = self._scene.add_mesh_simple(
                "/reach",
                vertices,
                faces,
                color=_COLOR,
                opacity=_OPACITY,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )

    def hide(self) -> None:
        if self._node is not None:
            self._node.remove()
        self._node = self._shown = None


def mesh(reach: Reach, rings: list[tuple[float, float]], height: float) -> tuple[Array, Array]:
    """Rings as triangles: vertices, shape (n, 3), [m], and faces, shape (m, 3)."""
    angles = np.linspace(*reach.pan, _SECTORS + 1)
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rows = [reach.axis + radius * around for ring in rings for radius in ring]
    flat = np.concatenate(rows)
    vertices = np.column_stack([flat, np.full(len(flat), height)])
    faces = []
    for ring, k in product(range(len(rings)), range(_SECTORS)):
        inner = 2 * ring * (_SECTORS + 1) + k
        outer = inner + _SECTORS + 1
        faces += [(inner, outer, outer + 1), (inner, outer + 1, inner + 1)]
    return vertices, np.array(faces)
