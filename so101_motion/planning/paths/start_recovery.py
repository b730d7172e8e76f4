"""Leave a start that is beyond a limit or in contact by a short, harmless motion.

Such starts are normal. A powered-off SO-101 lies folded on itself and on the table, with the lift
beyond its limit, and the hulls of its links are wider than the links. So a start is refused only if
no harmless motion leads out of it: a short straight joint motion to a free configuration inside the
limits, along which no pair of bodies that is too close comes closer and no other pair becomes too
close. A joint outside its limits moves straight inward during it.

Candidates for its end are the nearest configuration inside the limits and, from there, short moves
towards the goals, towards the zero pose (which is free on every table) and of single joints; the
harmless one with the least motion is taken. If there is none, moves of all joints in random
proportions are tried, then the shortest out of solids that are not convex, because the distance
from their surface may grow on the way out. The planner makes this motion slowly and plans from its
end.

An arm in a surface of which the inside is not known is left there, unless a longer motion was asked
for (``LeaveContactGoal``): every way out may lead deeper into what nobody has seen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from so101_motion.common.errors import InCollision
from so101_motion.common.geometry import Array
from so101_motion.planning.collision.collision import BACK_OUT, CollisionModel
from so101_motion.planning.kinematics.model import RobotModel

OUTSIDE = 2.0 * math.pi / 4096.0  # a start so little outside is inside [rad]: a servo's tick
FARTHEST = 0.12  # travel out of a bad start [m]; chosen, twice a folded arm's

CLOSER = 5e-4
"""How much closer a pair that is too close may come [m], because parts that slide along each other
do, and the depth of an overlap is not known better. Chosen."""

_RANDOM_DIRECTIONS = 60

_MOTION = {
    False: "small motion frees it; back out slowly, guide it by hand, or correct the scene if"
    " that is not there",
    True: "straight motion frees it; guide it by hand, or correct the scene if that is not there",
}
"""End of the error message, for a small motion and for a longer one."""


def needs_departure(
    model: RobotModel, collision: CollisionModel, q_start: Array, q_jaw: float
) -> bool:
    """Whether a start is outside the limits or too close to something."""
    return model.outside(q_start, OUTSIDE) is not None or not collision.is_free(q_start, q_jaw)


def find_departure(
    model: RobotModel,
    collision: CollisionModel,
    q_start: Array,
    *,
    q_jaw: float,
    towards: Sequence[Array],
    seed: int,
    farthest: float = FARTHEST,
) -> Array:
    """The configuration, free and inside the limits, to which a bad start can be left, (5,) [rad].

    Raises:
        InCollision: There is none; the message says what the arm touches.
    """
    in_surface = collision.unknown(
        np.arange(len(collision.pairs)), collision.distances(q_start, q_jaw)
    )
    if farthest <= FARTHEST and in_surface.any():
        first, second = collision.pairs[int(np.argmax(in_surface))]
        called = collision.scene.called(second)
        raise InCollision(
            f"at the start {collision.scene.called(first)} is in contact with {called}: {BACK_OUT}",
            first=first,
            second=second,
            where="start",
            can_back_out=True,
        )
    inside = np.clip(q_start, model.lower, model.upper)
    random = np.random.default_rng(seed).standard_normal((_RANDOM_DIRECTIONS, 5))
    plain = [*(q - inside for q in towards), -inside, *np.eye(5), *-np.eye(5)]
    tries: list[tuple[Any, Any]] = [(plain, True), (random, True)]
    if not collision.measured.all():
        tries.append((plain, collision.measured))
    for directions, judged in tries:
        exits = [
            q
            for direction in directions
            if np.any(direction)
            for q in _along(collision, model, inside, direction, farthest)
        ]
        free = [q for q in (inside, *exits) if collision.is_free(q, q_jaw)]
        free.sort(key=lambda q: float(np.abs(q - q_start) @ collision.reach))
        for q_exit in free:
            if is_harmless(collision, np.array([q_start, q_exit]), q_jaw, judged):
                return q_exit
    closest = collision.clearance(q_start, q_jaw)
    raise InCollision(
        f"at the start {closest.message('is')}, and no {_MOTION[farthest > FARTHEST]}",
        first=closest.first,
        second=closest.second,
        where="start",
        can_back_out=farthest <= FARTHEST,
    )


def is_harmless(collision: CollisionModel, points: Array, q_jaw: float, judged: Any = True) -> bool:
    """Whether along ``points`` (n, 5) close pairs only move apart, and no other becomes close.

    ``judged``: the pairs this is asked of, booleans, shape (len(pairs),), or True. It is not asked
    of pairs with a surface that the arm is in to an unknown depth: a link on its far side passes
    through it.
    """
    travelled = collision.travel(points)
    steps = max(1, math.ceil(travelled[-1] / float(collision.margins.min())))
    at = np.linspace(0.0, travelled[-1], steps + 1)
    columns = [np.interp(at, travelled, points[:, i]) for i in range(5)]
    # A pair must keep the distance it has gained, up to its margin.
    kept = np.full(len(collision.pairs), -math.inf)
    judged = judged & ~collision.in_surface(points[0], q_jaw)
    numbers = np.arange(len(kept))
    for q in np.column_stack(columns):
        distances = collision.distances(q, q_jaw)
        distances[collision.unknown(numbers, distances)] = -math.inf
        distances[~judged] = math.inf
        if np.any(distances < kept - CLOSER):
            return False
        kept = np.minimum(np.maximum(kept, distances), collision.margins)
    return True


def _along(
    collision: CollisionModel, model: RobotModel, inside: Array, direction: Array, farthest: float
) -> list[Array]:
    """Configurations along a path at growing distances, cut off at the limits."""
    unit = direction / float(np.abs(direction) @ collision.reach)
    distances = farthest * np.array([0.04, 0.08, 0.16, 0.32, 0.6, 1.0])
    return [np.clip(inside + d * unit, model.lower, model.upper) for d in distances]
