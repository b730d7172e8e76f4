"""Check configurations and lines of several arms: each in its scene, and against the others.

A configuration is the joints of all arms in one vector, shape (5 k,), [rad].
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.apart import are_apart, placement
from so101_motion.planning.collision.arm_bodies import ArmBodies
from so101_motion.planning.collision.batch_check import (
    BatchTeamCheck,
    Couple,
)
from so101_motion.planning.collision.collision import CollisionModel


class TeamArm(NamedTuple):
    """One of several arms that move together."""

    collision: CollisionModel  # its scene, without the other arms
    q_jaw: float  # angle of its jaw [rad]
    bodies: ArmBodies  # its bodies for the check against the other arms
    T_cell_base: SE3  # pose of its base in the cell


class TeamCheck:
    """Checks configurations of several arms, and lines between them.

    Args:
        arms: The arms, in the order of their joints.
        spacing: Largest travel between samples of an arm in its scene [m].
        room: Distance that arms keep [m].
    """

    def __init__(self, arms: Sequence[TeamArm], *, spacing: float, room: float) -> None:
        self._arms, self._room = arms, room
        self._checks = [e.collision.sampled_check(e.q_jaw, spacing=spacing) for e in arms]
        self._rows = np.empty((len(arms), 2, 6))
        self._rows[:, :, 5] = np.array([each.q_jaw for each in arms])[:, None]
        self._pairs = [
            (i, j, a.T_cell_base.inverse @ b.T_cell_base)
            for (i, a), (j, b) in combinations(enumerate(arms), 2)
        ]

    def compiled(self) -> BatchTeamCheck:
        """This check for the library's search."""
        couples = []
        for i, j, T in self._pairs:
            a, b = self._arms[i].bodies, self._arms[j].bodies
            levers = a.levers_pointer, b.levers_pointer
            couples.append(Couple(i, j, a.handle, b.handle, *levers, tuple(placement(T))))
        return BatchTeamCheck(self._checks, couples, self._room)

    def is_free(self, q: Array) -> bool:
        """Whether nothing is too near at ``q``."""
        each = q.reshape(-1, 5)
        if not all(check.is_free(one) for check, one in zip(self._checks, each, strict=True)):
            return False
        return self._are_apart(q[None])

    def is_clear(self, q_from: Array, q_to: Array) -> bool:
        """Whether no sample of a line touches, and the arms are proven to stay apart."""
        lines = zip(self._checks, q_from.reshape(-1, 5), q_to.reshape(-1, 5), strict=True)
        if not all(check.is_clear(a, b) for check, a, b in lines):
            return False
        return self._are_apart(np.array([q_from, q_to]))

    def _are_apart(self, q: Array) -> bool:
        rows, arms = self._rows[:, : len(q)], self._arms
        rows[:, :, :5] = q.reshape(len(q), -1, 5).transpose(1, 0, 2)
        return all(
            are_apart(arms[i].bodies, arms[j].bodies, T, rows[i], rows[j], room=self._room)
            for i, j, T in self._pairs
        )
