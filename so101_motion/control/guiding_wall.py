"""How far a hand may lead a guided arm: clear of itself, its surroundings and other arms.

The driver makes a wall of it that the hand feels (``drivers/feetech/hand_guiding.py``).
"""

from __future__ import annotations

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.course import Neighbours
from so101_motion.planning.differential.guard import Guard


class GuidingWall:
    """Holds back the joints that a hand leads into contact. Only the I/O thread calls it.

    Args:
        guard: Finds what is near.
        neighbours: Other arms to keep off; None if there are none.

    Attributes:
        guard: As given. It can be replaced while a hand guides the arm.
    """

    def __init__(self, guard: Guard, neighbours: Neighbours | None) -> None:
        self.guard, self._neighbours = guard, neighbours

    def __call__(self, q: Array, q_guided: Array) -> Array:
        """How far a hand leads the joints from ``q``, shape (5,), to ``q_guided``, (k, 5)."""
        others = () if self._neighbours is None else self._neighbours.near_at(q)
        return self.guard.guided_to(q, q_guided, others)
