"""Find where two arms can be so that one holds a thing and the other takes hold of it.

The place of the giver's tool and that of the taker's belong together: the thing is in between.
Five joints each must meet six conditions, so there are many such places, and none is given. Random
configurations of both are compared, the pairs that nearly belong together are drawn to each other
by least squares, and what comes out within the joint limits is a meeting.

Source: K. Levenberg, A method for the solution of certain non-linear problems in least squares,
Quarterly of Applied Mathematics 1944.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import SE3, Array, rotation_vector
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.model import RobotModel

LEVER = 0.1
"""What one radian counts against metres [m/rad]; chosen, about from wrist to jaw."""

GIVERS, TAKERS = 64, 400
"""So many configurations of either arm are compared; chosen."""

TRIED = 24
"""So many pairs are drawn to each other; chosen."""

_STEPS, _LONGEST, _DAMPING = 12, 0.4, 1e-5
_MET = 1e-7
"""Two places that are nearer than this are one [m]; chosen, far below what can be measured."""


class Meeting(NamedTuple):
    """Two configurations that belong together.

    Attributes:
        q_giver: Of the arm that holds the thing, shape (5,), [rad].
        q_taker: Of the one that takes it, shape (5,), [rad].
        which: Which of the ways to take it that is.
    """

    q_giver: Array
    q_taker: Array
    which: int


class Meetings:
    """Finds meetings of two arms with these limits. Belongs to one thread.

    Args:
        giver: The arm that holds the thing.
        taker: The one that takes it.
        T_giver_taker: Where its base is in that of the giver.
    """

    def __init__(self, giver: RobotModel, taker: RobotModel, T_giver_taker: SE3) -> None:
        self._giver, self._taker, self._T = giver, taker, T_giver_taker

    def find(self, ways: Sequence[SE3], seed: int) -> Iterator[Meeting]:
        """Meetings, those that were nearly there already first.

        Args:
            ways: Where the taker's tool has to be in the frame of the giver's, for each way to
                take the thing.
            seed: Of the random configurations.
        """
        q_giver, T_tools = _samples(self._giver, GIVERS, seed)
        q_taker, T_theirs = _samples(self._taker, TAKERS, seed + 1)
        known = _features(T_theirs[:, :3, :3], T_theirs[:, :3, 3])
        squares, T_taker_giver = (known**2).sum(axis=1), self._T.inverse.matrix
        found: list[tuple[float, int, int, int]] = []
        for which, way in enumerate(ways):
            wanted = T_taker_giver @ T_tools @ way.matrix
            rows = _features(wanted[:, :3, :3], wanted[:, :3, 3])
            # Not by BLAS, whose threads would take the processor from who needs it.
            nearest = np.argmin(squares - 2.0 * np.einsum("ik,jk->ij", rows, known), axis=1)
            off = np.linalg.norm(rows - known[nearest], axis=1)
            best = np.argsort(off)[:TRIED]
            found += [(float(off[i]), int(i), int(nearest[i]), which) for i in best]
        for _, i, k, which in sorted(found)[:TRIED]:
            met = self._drawn(q_giver[i], q_taker[k], ways[which])
            if met is not None:
                yield Meeting(*met, which)

    def _drawn(self, q_giver: Array, q_taker: Array, way: SE3) -> tuple[Array, Array] | None:
        """The nearest configurations that belong together; None if limits are in the way."""
        lower = np.concatenate([self._giver.lower, self._taker.lower])
        upper = np.concatenate([self._giver.upper, self._taker.upper])
        q = np.concatenate([q_giver, q_taker])
        for _ in range(_STEPS):
            error, J = self._apart(q, way)
            if float(np.linalg.norm(error)) < _MET:
                return q[:5].copy(), q[5:].copy()
            step = J.T @ np.linalg.solve(J @ J.T + _DAMPING * np.eye(6), error)
            step *= min(1.0, _LONGEST / float(np.abs(step).max()))
            q = np.clip(q + step, lower, upper)
        return None

    def _apart(self, q: Array, way: SE3) -> tuple[Array, Array]:
        """What is missing (6,) [m], and how the joints of both make up for it, shape (6, 10)."""
        R, p = self._giver.rotation_and_position(q[:5])
        R_wanted, away = R @ way.R, R @ way.p
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
    """Random configurations (n, 5) [rad], and where the tool is, shape (n, 4, 4)."""
    q = np.random.default_rng(seed).uniform(model.lower, model.upper, (count, 5))
    chain, T = ArmChain(model), np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = chain.rotations(q), chain.positions(q)
    return q, T


def _features(R: Array, p: Array) -> Array:
    """Numbers whose distance says how far poses are apart [m], shape (n, 12)."""
    return np.concatenate([p, (LEVER / np.sqrt(2.0)) * R.reshape(-1, 9)], axis=1)
