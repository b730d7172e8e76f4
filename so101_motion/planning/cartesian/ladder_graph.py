"""Find the best sequence of configurations along a tool path: a ladder graph.

How it works. The path of the tool is cut at a number of points. At each point the arm has many
configurations: that is a column. A motion takes one configuration of each column, and neighbours
must be near each other in joint space. Dynamic programming finds the cheapest sequence over the
*whole* path (R. Bellman, Dynamic Programming, 1957), so a good beginning never leads into a dead
end that another beginning would have avoided; and if there is no sequence, it says how far one
gets.

Contact is expensive to check and rare. So only the best sequence is checked; configurations in
contact are forbidden, and the search is repeated from there on.

Costs. A sequence pays for its joint motion and, more, for changes of the pitch: both by the squares
of the steps, which spreads a change evenly. Each configuration may have its own price.

Source: the ladder graph of Descartes, ROS-Industrial's Cartesian path planner; J. De Maeyer,
B. Moyaers, E. Demeester, Cartesian Path Planning for Arc Welding Robots: Evaluation of the
Descartes Algorithm, ETFA 2017.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.geometry import Array
from so101_motion.planning.checkpoint import Checkpoint, never_abandoned

JUMP = 0.5
"""Largest Euclidean distance between configurations of neighbouring columns, without the pan [rad].
Chosen: five times the average for a centimetre of path. The curve is compared with the tool path
afterwards."""

PAN_JUMP = 1.5
"""The same for the pan alone [rad]. Past the pan axis it has to turn far in a few millimetres.
Chosen: half of what separates facing a point from reaching it over the back."""

SIDE_JUMP = 0.3  # the same for a change of sides, one motion on the pan axis only; chosen
OF_MOTION = 0.01  # cost of joint motion, against 1 for the pitch. Chosen: the pitch stays if it can

Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]


class LadderGraph:
    """Configurations in at least two columns, and the costs of sequences through them.

    Of each column: its configurations, shape (k, 5), [rad], where k differs and may be 0; the cost
    of a whole path of such configurations; and whether the arm faces the point in each, or is over
    its back.
    """

    def __init__(
        self,
        q: Sequence[Array],
        price: Sequence[Array],
        in_front: Sequence[Flags],
        checkpoint: Checkpoint = never_abandoned,
    ) -> None:
        self.q = q
        self._checkpoint = checkpoint
        self._in_front = in_front
        self._price = [values / (len(q) - 1) for values in price]
        self._without_pan = [np.ascontiguousarray(column[:, 1:]) for column in q]
        self._pitch = [column[:, 1:4].sum(axis=1) for column in q]
        self._steps: list[Array] = []
        self._cost = [self._price[0]]
        self._before: list[Indices] = [np.zeros(len(q[0]), dtype=np.intp)]

    def best(self, column: int | None = None) -> Indices | None:
        """The cheapest sequence from the first column to a column, by default the last.

        Its configuration in each column, by index, shape (column + 1,); None if there is none.
        """
        column = len(self.q) - 1 if column is None else column
        if self.farthest() < column:
            return None
        rows = np.empty(column + 1, dtype=np.intp)
        rows[column] = np.argmin(self._cost[column])
        for i in range(column, 0, -1):
            rows[i - 1] = self._before[i][rows[i]]
        return rows

    def sequence(self, rows: Indices) -> Array:
        """The configurations that a sequence takes, shape (len(rows), 5), [rad]."""
        return np.array([column[row] for column, row in zip(self.q, rows, strict=False)])

    def farthest(self) -> int:
        """The last column that a sequence reaches."""
        for i in range(len(self._cost), len(self.q)):
            self._checkpoint()
            if len(self._steps) < i:
                self._steps.append(self._step(i - 1))
            costs = self._cost[i - 1][:, None] + self._steps[i - 1]
            before = costs.argmin(axis=0)
            cost = costs[before, np.arange(len(before))] + self._price[i]
            if not np.isfinite(cost).any():
                break
            self._before.append(before)
            self._cost.append(cost)
        return len(self._cost) - 1

    def reached(self, column: int) -> Indices:
        """Which configurations of a column, up to the farthest, can be reached."""
        return np.flatnonzero(np.isfinite(self._cost[column]))

    def useful(self) -> list[Indices]:
        """For each column, the configurations from which the farthest column can be reached."""
        last = self.farthest()
        useful = [self.reached(last)]
        for i in range(last - 1, -1, -1):
            self._checkpoint()
            here = self.reached(i)
            onwards = np.isfinite(self._steps[i][np.ix_(here, useful[-1])]).any(axis=1)
            useful.append(here[onwards])
        return useful[::-1]

    def forbid(self, column: int, rows: Indices | int) -> None:
        """Remove configurations from a column other than the first."""
        self._price[column][rows] = np.inf
        del self._cost[column:], self._before[column:]

    def forbid_step(self, column: int, row: int, next_row: int) -> None:
        """Remove the step from a configuration to one of the next column."""
        self._steps[column][row, next_row] = np.inf
        del self._cost[column + 1 :], self._before[column + 1 :]

    def _step(self, column: int) -> Array:
        """Cost of each step from a column to the next, shape (k, l)."""
        moved = _squares(self._without_pan[column], self._without_pan[column + 1])
        pitched = (self._pitch[column + 1] - self._pitch[column][:, None]) ** 2
        cost = (pitched + OF_MOTION * moved) * (len(self.q) - 1)
        cost[moved > JUMP**2] = np.inf
        panned = np.abs(self.q[column][:, :1] - self.q[column + 1][:, 0])
        same = self._in_front[column][:, None] == self._in_front[column + 1]
        cost[panned > np.where(same, PAN_JUMP, SIDE_JUMP)] = np.inf
        return np.asarray(cost)


def are_near(q: Array, others: Array, jump: float, pan_jump: float) -> Flags:
    """Which of ``others`` (l, 5) are near which of ``q`` (k, 5), [rad]; shape (k, l)."""
    squares = _squares(q[:, 1:], others[:, 1:])
    return np.asarray((squares <= jump**2) & (np.abs(q[:, :1] - others[:, 0]) <= pan_jump))


def _squares(a: Array, b: Array) -> Array:
    """Squared distances between rows, shape (k, l)."""
    squares = -2.0 * (a @ b.T)
    squares += np.einsum("ij,ij->i", a, a)[:, None]
    squares += np.einsum("ij,ij->i", b, b)
    return np.maximum(squares, 0.0)
