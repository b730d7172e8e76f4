"""Find configurations of two arms in which one holds an object and the other grasps it.

The object fixes the pose of the taker's tool relative to the giver's. That is six conditions on ten
joints, so there are many solutions. Random configurations of both arms are compared, the pairs that
nearly fit are brought together by least squares, and those that end within the joint limits are
meetings.

Source: K. Levenberg, A method for the solution of certain non-linear problems in least squares,
Quarterly of Applied Mathematics 1944.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import SE3, Array, rotation_vector
from so101_motion.planning.collision.coal_shapes import held_shape
from so101_motion.planning.collision.scene import Shape, ShapeFile
from so101_motion.planning.collision.shape_files import read_shape
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.model import RobotModel

THICKEST = 0.06  # thickest object that is grasped [m]; chosen: the jaws open to 90 mm
DEEP = 0.015  # largest distance from the object's edge to the middle of the grip [m]; chosen
FROM_END = 0.012  # distance of a grasp from the object's end [m]; chosen: jaws are 20 mm wide


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grasp:
    """A grasp of an object."""

    # the middle of the grip in the object's frame: z along the approach, x across the jaws
    T_object_grip: SE3
    thickness: float  # the object's thickness there [m]


def grasps_of(shape: Shape | ShapeFile) -> Iterator[Grasp]:
    """The grasps of an object by the box around it; none if it is too thick everywhere.

    The jaws close along one axis of the box, from any other side, near its middle or near an end.
    """
    _, points = held_shape(read_shape(shape))
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    for across, along, aside in permutations(range(3)):
        if 2.0 * half[across] > THICKEST:
            continue
        reach = half[along] - min(DEEP, half[along])
        end = half[aside] - FROM_END
        offsets = (0.0, end, -end) if end > FROM_END else (0.0,)
        for sign, flip, offset in product((1.0, -1.0), (1.0, -1.0), offsets):
            p = middle.copy()
            p[along] += sign * reach
            p[aside] += offset
            x, z = flip * _unit(across), -sign * _unit(along)
            R = np.column_stack([x, np.cross(z, x), z])
            yield Grasp(T_object_grip=SE3(R, p), thickness=2.0 * float(half[across]))


def _unit(axis: int) -> Array:
    return np.asarray(np.eye(3)[axis])


LEVER = 0.1  # weight of a radian against metres [m/rad]; chosen, from wrist to jaw
GIVERS, TAKERS = 64, 400  # number of configurations of giver and taker that are compared; chosen
TRIED = 24  # number of pairs that are brought together; chosen
_STEPS, _LONGEST, _DAMPING = 12, 0.4, 1e-5
_MET = 1e-7  # largest remaining error of a meeting [m]; chosen, far below what can be measured


class Meeting(NamedTuple):
    """Configurations of giver and taker for one grasp."""

    q_giver: Array  # of the arm that holds the object, shape (5,), [rad]
    q_taker: Array  # of the arm that takes it, shape (5,), [rad]
    which: int  # index of the grasp


class Meetings:
    """Finds meetings of two arms within their joint limits. Belongs to one thread."""

    def __init__(self, giver: RobotModel, taker: RobotModel, T_giver_taker: SE3) -> None:
        self._giver, self._taker, self._T = giver, taker, T_giver_taker

    def find(self, T_tools: Sequence[SE3], seed: int) -> Iterator[Meeting]:
        """Meetings, those of the best random pairs first.

        ``T_tools``: the taker's tool in the giver's tool frame, for each grasp.
        """
        q_giver, T_giver_tools = _samples(self._giver, GIVERS, seed)
        q_taker, T_theirs = _samples(self._taker, TAKERS, seed + 1)
        known = _features(T_theirs[:, :3, :3], T_theirs[:, :3, 3])
        squares, T_taker_giver = (known**2).sum(axis=1), self._T.inverse.matrix
        found: list[tuple[float, int, int, int]] = []
        for which, T in enumerate(T_tools):
            wanted = T_taker_giver @ T_giver_tools @ T.matrix
            rows = _features(wanted[:, :3, :3], wanted[:, :3, 3])
            # Not by BLAS, whose threads would take the processor from the control loop.
            nearest = np.argmin(squares - 2.0 * np.einsum("ik,jk->ij", rows, known), axis=1)
            off = np.linalg.norm(rows - known[nearest], axis=1)
            best = np.argsort(off)[:TRIED]
            found += [(float(off[i]), int(i), int(nearest[i]), which) for i in best]
        for _, i, k, which in sorted(found)[:TRIED]:
            met = self._joined(q_giver[i], q_taker[k], T_tools[which])
            if met is not None:
                yield Meeting(*met, which)

    def _joined(self, q_giver: Array, q_taker: Array, T_tools: SE3) -> tuple[Array, Array] | None:
        """The nearest configurations that meet; None if the joint limits prevent it."""
        lower = np.concatenate([self._giver.lower, self._taker.lower])
        upper = np.concatenate([self._giver.upper, self._taker.upper])
        q = np.concatenate([q_giver, q_taker])
        for _ in range(_STEPS):
            error, J = self._error(q, T_tools)
            if float(np.linalg.norm(error)) < _MET:
                return q[:5].copy(), q[5:].copy()
            step = J.T @ np.linalg.solve(J @ J.T + _DAMPING * np.eye(6), error)
            step *= min(1.0, _LONGEST / float(np.abs(step).max()))
            q = np.clip(q + step, lower, upper)
        return None

    def _error(self, q: Array, T_tools: SE3) -> tuple[Array, Array]:
        """The error of the taker's pose (6,) [m], and its Jacobian, negated, shape (6, 10)."""
        R, p = self._giver.rotation_and_position(q[:5])
        R_wanted, away = R @ T_tools.R, R @ T_tools.p
        p_wanted = p + away
        R, p = self._taker.rotation_and_position(q[5:])
        turn = rotation_vector(self._T.R @ R @ R_wanted.T)
        error = np.concatenate([self._T.R @ p + self._T.p - p_wanted, LEVER * turn])
        J = np.empty((6, 10))
        J[:, :5] = self._giver.frame_jacobian(q[:5])
        x, y, z = away
        J[:3, :5] += np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]) @ J[3:, :5]
        theirs = self._taker.frame_jacobian(q[5:])
        J[:3, 5:], J[3:, 5:] = -self._T.R @ theirs[:3], -self._T.R @ theirs[3:]
        J[3:] *= LEVER
        return error, J


@lru_cache(maxsize=8)
def _samples(model: RobotModel, count: int, seed: int) -> tuple[Array, Array]:
    """Random configurations (n, 5) [rad], and their tool poses, shape (n, 4, 4)."""
    q = np.random.default_rng(seed).uniform(model.lower, model.upper, (count, 5))
    chain, T = ArmChain(model), np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = chain.rotations(q), chain.positions(q)
    return q, T


def _features(R: Array, p: Array) -> Array:
    """Feature vectors whose distance measures how far poses are apart [m], shape (n, 12)."""
    return np.concatenate([p, (LEVER / np.sqrt(2.0)) * R.reshape(-1, 9)], axis=1)
