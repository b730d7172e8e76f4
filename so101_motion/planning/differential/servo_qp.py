"""Solve the quadratic program of a servo step with OSQP, on one workspace that is reused.

Minimise ``(v - s w)^T M (v - s w) + mu (1 - s)^2`` over joint velocities ``v`` and the granted
share ``s`` of the task velocity ``w``, with bounds on both and rows ``g v >= b``. The share keeps a
tool on its line: if one joint can only give half, all give half, unless a detour costs less than
the speed is worth by ``mu``. ``M`` weighs deviations of the tool, and slightly those of the joints.

OSQP through qpsolvers would be set up anew at each call, which takes ten times as long as solving
(0.5 ms against 0.05 ms measured). So the workspace is OSQP's own: set up once with room for a fixed
number of rows, then only numbers change, and each solution starts from the one before. It is used
through OSQP's extension module: the class around it spends twice the time of a solution on unused
reports. The tests state the same program with qpsolvers and compare the two. OSQP stops near the
solution: bounds are restored by clipping, and ``servo.py`` proves that the result is safe.

Source: B. Stellato et al., OSQP: an operator splitting solver for quadratic programs, 2020.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from so101_motion.common.geometry import Array

ROWS = 8  # most rows ``g v >= b``; chosen: seldom are more than five pairs near
WORTH = 0.02  # of the full velocity against its direction; chosen: it slides at a slant

_WEIGHTS = np.array([25.0, 25.0, 25.0, 0.05, 0.05, 0.05])
"""Weights of deviations of the tool [s^2/m^2], [s^2/rad^2]: about one for a full speed of each."""

_OWN_WEIGHT = 0.05 * np.eye(5)  # weights of deviations of the joints [s^2/rad^2]
_NO_BOUND = 1e30  # oSQP's infinity
_ACCURACY = 1e-4
_ITERATIONS = 150
_CHECK_EVERY = 10
_JOINTS, _ALL = 5, 6
_UPPER = tuple((i, j) for j in range(_ALL) for i in range(j + 1))


class ServoQp:
    """Solves one program after another; belongs to one thread."""

    def __init__(self) -> None:
        self._osqp = _workspace()
        self._upper_half = np.array([i * _ALL + j for i, j in _UPPER])
        self._P, self._q = np.zeros((_ALL, _ALL)), np.zeros(_ALL)
        self._q[_JOINTS] = -WORTH  # all is in units of what the task velocity is worth
        self._used = ROWS  # how many rows the last program had
        self._Ax = np.ones(_JOINTS * (1 + ROWS) + 1)
        self._A = self._Ax[:-1].reshape(_JOINTS, 1 + ROWS)  # a view: the rows of each joint
        self._lower, self._upper = np.zeros(_ALL + ROWS), np.full(_ALL + ROWS, _NO_BOUND)
        self._upper[_JOINTS] = 1.0

    def solve(
        self, J: Array, w: Array, lower: Array, upper: Array, G: Array, b: Array
    ) -> tuple[Array, float]:
        """Solve for the velocities and the granted share.

        J (6, 5) is the Jacobian of the moved frame, w (5,) the task velocity, not all zero, in the
        unit of ``lower`` and ``upper``, which are velocities; rows G (k, 5), k <= ``ROWS``, have
        the bounds b.
        """
        per_size = 1.0 / float(np.abs(w).max())
        M = (J.T * _WEIGHTS) @ J
        M += _OWN_WEIGHT
        Mw = M @ w
        worth = float(w @ Mw) * per_size**2
        P, k = self._P, len(G)
        P[:_JOINTS, :_JOINTS] = M
        np.multiply(Mw, -per_size, out=P[:_JOINTS, _JOINTS])
        P[_JOINTS, _JOINTS] = worth * (1.0 + WORTH)
        np.multiply(lower, per_size, out=self._lower[:_JOINTS])
        np.multiply(upper, per_size, out=self._upper[:_JOINTS])
        if k or self._used:
            self._A[:, 1 : 1 + k] = G.T
            self._A[:, 1 + k :] = 0.0
            self._lower[_ALL : _ALL + k] = per_size * b
            self._lower[_ALL + k :] = -_NO_BOUND
        self._used = k
        osqp = self._osqp
        osqp.update_data_vec(q=self._q, l=self._lower, u=self._upper)
        entries = P.take(self._upper_half) / worth
        osqp.update_data_mat(P_x=entries, P_i=None, A_x=self._Ax, A_i=None)
        osqp.solve()
        x = osqp.solution.x
        qd = np.minimum(np.maximum(x[:_JOINTS] / per_size, lower), upper)
        return qd, min(1.0, max(0.0, float(x[_JOINTS])))


def _workspace() -> Any:
    """OSQP with this program's pattern. Imported here: it brings scipy along."""
    from osqp import ext_builtin as osqp
    from scipy import sparse

    P = sparse.csc_matrix(np.triu(np.ones((_ALL, _ALL)) + np.eye(_ALL)))
    bounds, near = np.eye(_ALL), np.hstack((np.ones((ROWS, _JOINTS)), np.zeros((ROWS, 1))))
    A = sparse.csc_matrix(np.vstack((bounds, near)))
    settings = osqp.OSQPSettings()
    osqp.osqp_set_default_settings(settings)
    settings.verbose = settings.scaling = 0  # the numbers are near one already
    settings.eps_abs = settings.eps_rel = _ACCURACY
    settings.max_iter, settings.check_termination = _ITERATIONS, _CHECK_EVERY
    settings.adaptive_rho_interval = 2 * _CHECK_EVERY
    ones = np.ones(_ALL + ROWS)
    zeros = np.zeros(_ALL)
    return osqp.OSQPSolver(
        osqp.CSC(P), zeros, osqp.CSC(A), -ones, ones, _ALL + ROWS, _ALL, settings
    )
