"""Check configurations for collisions, and measure distances between bodies.

Pinocchio is imported only in this folder and in ``kinematics``, coal only in this folder.

A configuration is free if every pair of bodies keeps more than its margin apart. The jaw is placed
by its own angle: an open gripper is wider. The compiled library checks many configurations at once,
and coal decides only the close calls (``batch_check.py``). There are two checks of joint motions.

Both use *travel*, an upper bound on how far any point of the arm moves: the sum of the joint angles
passed, each times the distance of the furthest point from that joint's axis.

*The proof.* If all pairs of bodies keep ``c`` apart at some configuration, nothing touches within
``c`` of travel before and after it. So a motion is cut into parts, and the configuration in the
middle of each must clear half the part's travel. A part that fails is cut into smaller ones, down
to those that the margins themselves clear. Far from everything a few configurations clear a whole
move. The result: the bodies keep at least their margins in the middle of every smallest part, and
never touch in between.

*The sampled check.* The margins at configurations a fixed travel apart. Near obstacles it costs a
third of a proof and misses little: the search for a path uses it, and the result is proven.

Source: F. Schwarzer, M. Saha, J.-C. Latombe, Adaptive Dynamic Collision Checking for Single and
Multiple Articulated Robots in Complex Environments, IEEE T-RO 2005.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from so101_motion.common.geometry import Array
from so101_motion.planning.checkpoint import Checkpoint, never_abandoned
from so101_motion.planning.collision.batch_check import (
    NEAR_ROW,
    ArmLines,
    BatchCheck,
    Level,
    Levels,
    LineCheck,
)
from so101_motion.planning.collision.bodies import NEAR, Bodies, bodies_in
from so101_motion.planning.collision.scene import MARGIN, Scene, checked_scene
from so101_motion.planning.collision.solids import RIB, SAMPLE, points_in
from so101_motion.planning.kinematics.model import RobotModel

BACK_OUT = (
    "how deep is not known, so guide it out by hand, correct the scene, or let it"
    " back out slowly, which may lead deeper"
)
"""What to do about an arm in a surface of which the inside is not known."""


WIDER = (0.012, 0.048)
"""Clearances beyond the margins that a proof asks for [m]. Of nine sets, none was faster on the
paths of four scenes, and equally fast ones had more clearances."""

NEARBY = 0.03  # where the closest pair is looked for first [m]. Chosen: at most goals one is nearer


class Clearance(NamedTuple):
    """The distance of two bodies.

    It is negative by the depth if they overlap; 0 if they overlap and the depth is not known,
    because the second is a surface only.

    Attributes:
        distance: The distance [m].
        first: A link by its human name, such as ``"upper arm"``, or a held object.
        second: Another link, ``"floor"`` or an obstacle.
        margin: Distance they must keep [m].
        called: The names of the two in messages.
    """

    distance: float
    first: str
    second: str
    margin: float
    called: tuple[str, str]

    @property
    def room(self) -> float:
        """Distance beyond the margin [m]; negative if the two are too close."""
        return self.distance - self.margin

    def message(self, verb: str = "would be") -> str:
        """In words, such as ``"the jaw would be 2.0 mm into the floor"``."""
        first, second = self.called
        if self.distance > 0.0:
            return f"{first} {verb} {self.distance * 1e3:.1f} mm from {second}"
        if self.distance == 0.0:
            return f"{first} {verb} in contact with {second}"
        return f"{first} {verb} {-self.distance * 1e3:.1f} mm into {second}"


class ClosePair(NamedTuple):
    """Two bodies that are near each other, and the gradient of their distance."""

    distance: float  # as in ``Clearance``, like the next two
    first: str
    second: str
    gradient: Array  # derivative of the distance by each joint, shape (5,), [m/rad]
    margin: float  # distance they must keep [m]


class CollisionModel:
    """Checks configurations and motions for contact. Belongs to one thread.

    Args:
        model: The arm.
        scene: Obstacles and held objects; just the floor by default.
        checkpoint: Called again and again during long computations.

    Attributes:
        scene: The scene.
        batch: The check by the compiled library.
        margin: Distance that must be kept from obstacles [m].
        pairs: The pairs of bodies that are checked, by name.
        margins: Distance that each pair must keep, shape (len(pairs),), [m].
        checkpoint: As given; code that uses this model calls it too.
        reach: For each arm joint, a bound on how far a point moves per angle, shape (5,), [m/rad].
    """

    def __init__(
        self,
        model: RobotModel,
        scene: Scene | None = None,
        checkpoint: Checkpoint = never_abandoned,
    ) -> None:
        self.scene = checked_scene(scene or Scene())
        self.checkpoint = checkpoint
        self.margin = self.scene.margin
        self._model = model.pin_model
        self._data = self._model.createData()
        bodies = bodies_in(self._model, self.scene, checkpoint)
        self._bodies, self.pairs, self.margins = bodies.bodies, bodies.pairs, bodies.margins
        self._levers, self.reach = bodies.levers, bodies.levers.longest
        self._moved_by = bodies.moved_by
        self._insides, self._points = bodies.insides, lru_cache(maxsize=32)(self._points_in)
        self._second = bodies.indices[:, 1]
        self._with_surface = np.isin(self._second, list(self._insides))
        self._coal = PairsByCoal(self._model, self._data, bodies)
        self.batch = BatchCheck(self._model, bodies, self.scene.floor_z)
        self.batch.watch(checkpoint)
        self._wider = lru_cache(maxsize=8)(self._with_room)
        self._lenient = lru_cache(maxsize=1)(self._with_tolerance)
        self._bent = lru_cache(maxsize=16)(self._with_bend)
        least = float(self.margins.min(initial=self.margin))
        clearances = (each for each in WIDER if each > least)
        self._plain = self._proof(
            self._level(least), *(self._level(each, at_least=each) for each in clearances)
        )
        self._q = np.zeros(self._model.nq)

    def is_free(self, q: ArrayLike, q_jaw: float = 0.0) -> bool:
        """Whether every pair of bodies keeps more than its margin apart."""
        self.checkpoint()
        return not self.batch.touches(self._plain.native, np.asarray(q), q_jaw)

    def touching(
        self, configurations: Array, q_jaw: float | Array = 0.0, *, extra: float = 0.0
    ) -> Array:
        """Which of several configurations (n, 5) [rad] are not free, booleans, shape (n,).

        The jaw stands at one angle in all of them, or at one in each, shape (n,), [rad]. Pairs must
        keep ``extra`` [m] beyond their margins.
        """
        proof = self._wider(extra) if extra else self._plain
        q = np.empty((len(configurations), 6))
        q[:, :5], q[:, 5] = configurations, q_jaw
        return self.batch.touching(proof.native, q)

    def distances(self, q: ArrayLike, q_jaw: float = 0.0) -> Array:
        """The distance of each pair, shape (len(pairs),), [m]; as in ``Clearance``."""
        self._q[:5] = q
        self._q[5] = q_jaw
        self.checkpoint()
        self._coal.place(self._q)
        return np.array([self._found(k).distance for k in range(len(self.pairs))])

    def lacking(self, q: ArrayLike, q_jaw: float, margins: Array) -> Array:
        """How much each pair is closer than its margin, both shape (len(pairs),), [m]; mostly 0.

        Infinite for pairs in contact of which the depth is not known.
        """
        self.checkpoint()
        widest = float(margins.max(initial=0.0))
        near = self.batch.near(np.asarray(q), q_jaw, widest)
        rows = self._near_by_coal(q, q_jaw, widest) if near is None else near[0]
        return self.lack_in(rows, margins)

    def lack_in(self, rows: Array, margins: Array) -> Array:
        """``lacking`` from the rows of ``near_bounds``, if they reach as far as the margins."""
        lack, pairs = np.zeros(len(self.pairs)), rows[:, 0].astype(int)
        lack[pairs] = np.maximum(margins[pairs] - rows[:, 1], 0.0)
        lack[pairs[self.unknown(pairs, rows[:, 1])]] = math.inf
        return lack

    def unknown(self, pairs: Any, distances: Any) -> Any:
        """Which of pairs, at such distances [m], overlap to a depth that is not known."""
        return (distances == 0.0) & self._with_surface[pairs]

    def in_surface(self, q: Array, q_jaw: float) -> Any:
        """The pairs with a surface that the arm is in to an unknown depth, booleans by pair."""
        numbers = np.arange(len(self.pairs))
        found = numbers[self.unknown(numbers, self.distances(q, q_jaw))]
        return np.isin(self._second, self._second[found])

    @property
    def measured(self) -> Any:
        """Whether the depth of each pair is the shortest way out, booleans, shape (len(pairs),).

        It is not in what is no convex solid (``solids.py``).
        """
        known = [
            body for body, each in self._insides.items() if each is not None and each.is_convex
        ]
        return ~self._with_surface | np.isin(self._second, known)

    def lacks_more(self, places: Array, q_jaw: float, margins: Array, lack: Array) -> bool:
        """Whether at one of several configurations (n, 5) ``lacking`` exceeds ``lack`` [m]."""
        said = self.batch.lacks_more(places, q_jaw, margins, lack)
        if said is not None:
            return said
        return any((self.lacking(q, q_jaw, margins) > lack).any() for q in places)

    def clearance(self, q: ArrayLike, q_jaw: float = 0.0) -> Clearance:
        """The pair of bodies with the least distance beyond its margin."""
        self.checkpoint()
        for within in (NEARBY, NEAR):
            near = self.batch.near(np.asarray(q), q_jaw, within)
            if near is None:
                break
            pairs, distances = near[0][:, 0].astype(int), near[0][:, 1]
            rooms = distances - self.margins[pairs]
            if (self._with_surface[pairs] & (distances <= RIB)).any():  # perhaps in a solid
                break
            # Any other pair has more room than this.
            if rooms.min(initial=math.inf) < within - self.margins.max():
                closest = min(range(len(rooms)), key=lambda k: (rooms[k], pairs[k]))
                return self._clearance(int(pairs[closest]), float(distances[closest]))
        self._q[:5], self._q[5] = q, q_jaw
        least = self._coal.place(self._q) - self.margins
        found = dict[int, float]()
        for k in np.argsort(least, kind="stable").tolist():
            if found and least[k] > min(found.values()):
                break
            found[k] = self._found(k).distance - self.margins[k]
        last = min(found, key=lambda k: (found[k], k))
        return self._clearance(last, self._found(last).distance)

    def _clearance(self, k: int, distance: float) -> Clearance:
        first, second = self.pairs[k]
        return Clearance(
            distance=distance,
            first=first,
            second=second,
            margin=float(self.margins[k]),
            called=(self.scene.called(first), self.scene.called(second)),
        )

    def first_contact(self, q: ArrayLike, q_jaw: float = 0.0) -> tuple[str, str] | None:
        """The two bodies that are too close, the closest if there are several, or None."""
        if self.is_free(q, q_jaw):
            return None
        closest = self.clearance(q, q_jaw)
        return closest.first, closest.second

    def nearest(self, q: ArrayLike, q_jaw: float = 0.0, *, within: float) -> list[ClosePair]:
        """The pairs of bodies nearer than ``within`` [m], at most ``NEAR``, the nearest first.

        Fastest if ``within`` is the same in each call; ``ValueError`` if it is out of range.
        """
        rows, _ = self.near_bounds(q, q_jaw, within=within)
        return [self.described(row) for row in rows[np.argsort(rows[:, 1], kind="stable")]]

    def described(self, row: Array) -> ClosePair:
        """Turn a row of ``near_bounds`` into a ``ClosePair``."""
        k = int(row[0])
        return ClosePair(float(row[1]), *self.pairs[k], row[11:], float(self.margins[k]))

    def near_bounds(
        self, q: ArrayLike, q_jaw: float = 0.0, *, within: float, gap: float = 0.0
    ) -> tuple[Array, Array]:
        """Like ``nearest``, but as numbers and in any order, for use in every control cycle.

        Returns:
            A row for each pair of bodies: its index in ``pairs``, distance, the three of ``Found``
            after that, gradient; shape (n, 16). And the bounds (``guard.py``) of a step
            that keeps ``gap`` [m] beyond the margins free where it is free now, shape (n, 7), valid
            until the next call.
        """
        if not 0.0 < within <= NEAR:
            raise ValueError(f"within must be more than 0 and at most {NEAR} m, got {within}")
        said = self.batch.near(np.asarray(q), q_jaw, within, gap)
        if said is not None:
            return said
        rows = self._near_by_coal(q, q_jaw, within)
        rooms = rows[:, 1] - self.margins[rows[:, 0].astype(int)]
        return rows, np.column_stack((rows[:, -5:], np.minimum(0.0, gap - rooms), rooms))

    def _near_by_coal(self, q: ArrayLike, q_jaw: float, within: float) -> Array:
        self._q[:5] = q
        self._q[5] = q_jaw
        found = dict[int, Found]()
        for k in self._coal.boxes_within(within, self._q):
            each = self._found(k)
            if each.distance <= within:
                found[k] = each
        return self._rows(found) if found else np.zeros((0, NEAR_ROW))

    def _found(self, k: int) -> Found:
        """What coal finds for a pair, with the depth in solids of which it knows the surface."""
        found, body = self._coal.found(k), int(self._second[k])
        if found.distance > RIB or body not in self._insides:
            return found
        inside = self._insides[body]
        if inside is not None:
            first, T, at = self._coal.pair(k)
            points = partial(self._points, first)
            deep = inside.depth(self._bodies[first].shape, points, at.rotation, at.translation)
            if deep is not None:
                p_first, p_second = T.act(deep.p_body), T.act(deep.p_solid)
                return Found(-deep.depth, p_first, p_second, T.rotation @ deep.normal)
        # Coal follows a depth as small as the spacing of the body's points.
        return found._replace(distance=max(found.distance, 0.0 if inside is None else -SAMPLE))

    def _points_in(self, body: int) -> Array:
        return points_in(self._bodies[body].shape)

    def _rows(self, found: dict[int, Found]) -> Array:
        """The rows of ``near_bounds`` from what was found for each pair."""
        pairs = list(found)
        distances, p_first, p_second, normal = map(np.array, zip(*found.values(), strict=True))
        J = pin.computeJointJacobians(self._model, self._data, self._q)
        moved_by = self._moved_by[pairs]
        gradient = _rates(J, moved_by[:, 1], p_second, normal)
        gradient -= _rates(J, moved_by[:, 0], p_first, normal)
        return np.column_stack((pairs, distances, p_first, p_second, normal, gradient))

    def travel(self, points: Array) -> Array:
        """A bound on how far any point of the arm has moved along (n, 5), shape (n,), [m]."""
        steps: Array = np.abs(np.diff(points, axis=0)) @ self.reach
        return np.concatenate(([0.0], np.cumsum(steps)))

    def first_blocked(
        self,
        points: Array,
        q_jaw: float = 0.0,
        *,
        tolerance: float = 0.0,
        bend: float = 0.0,
        extra: float = 0.0,
    ) -> Array | None:
        """A configuration on the straight lines through ``points`` that is too close, or None.

        None is a proof that the whole motion, ends included, is free of contact, and that the
        margins are kept at configurations a few millimetres of travel apart, but not just at the
        ends. The same motion gives the same answer.

        Args:
            points: Joint angles, shape (n, 5), n >= 1, [rad].
            tolerance: Share of its margin by which a pair may be closer.
            bend: How far any point of the arm may be off those lines [m]; the margins are widened
                by as much, and the proof holds for all such motions. Not with ``tolerance``.
            extra: Further widening of the margins [m]; with ``bend`` only.
        """
        self.checkpoint()
        proof, reach = self._proof_of(tolerance, bend, extra), self._levers.at(q_jaw)
        return self.batch.first_blocked(proof.native, reach, points, q_jaw)

    def _proof_of(self, tolerance: float, bend: float, extra: float) -> _Proof:
        if tolerance or bend:
            return self._bent(bend, extra) if bend else self._lenient(tolerance)
        return self._plain

    def sampled_check(self, q_jaw: float = 0.0, *, spacing: float, extra: float = 0.0) -> LineCheck:
        """A quicker check of motions at samples, which proves nothing between them.

        Samples are at most ``spacing`` [m] of travel apart; pairs must keep ``extra`` [m] beyond
        their margins.
        """
        self.checkpoint()
        proof, reach = self._wider(extra) if extra else self._plain, self._levers.at(q_jaw)
        return LineCheck([ArmLines(self.batch, proof.native, reach, q_jaw, spacing)])

    def _level(
        self, clearance: float, *, part: float = 1.0, extra: float = 0.0, at_least: float = 0.0
    ) -> Level:
        """A check of ``part`` of the margins plus ``extra`` [m], at least ``at_least`` [m]."""
        margins = np.maximum(part * self.margins + extra, at_least)
        own, scene = (
            max(part * each + extra, at_least) for each in (min(self.margin, MARGIN), self.margin)
        )
        return Level(clearance, partial(self._coal.touches, margins), (own, scene))

    def _proof(self, *levels: Level) -> _Proof:
        return _Proof(levels, Levels(self.batch, levels))

    def _with_room(self, extra: float) -> _Proof:
        """A check of the margins plus ``extra`` [m]."""
        return self._proof(self._level(self._plain.levels[0].clearance + extra, extra=extra))

    def _with_tolerance(self, tolerance: float) -> _Proof:
        """The levels, and below them a check of the margins less the tolerance."""
        levels, kept = self._plain.levels, 1.0 - tolerance
        return self._proof(self._level(kept * levels[0].clearance, part=kept), *levels)

    def _with_bend(self, bend: float, extra: float) -> _Proof:
        """The levels for motions that are off the checked lines by up to ``bend`` [m]."""
        least, *wider = self._plain.levels
        lowest = self._level(least.clearance + extra, extra=bend + extra)
        higher = (each._replace(clearance=each.clearance - bend) for each in wider)
        return self._proof(lowest, *(each for each in higher if each.clearance > lowest.clearance))


class _Proof(NamedTuple):
    """The levels of a proof, from the margins up, and the same for the library."""

    levels: Sequence[Level]
    native: Levels


def _rates(J: Array, joints: Array, p: Array, normal: Array) -> Array:
    """How fast points (k, 3) [m] move along normals with the arm joints, shape (k, 5), [m/rad]."""
    (px, py, pz), (nx, ny, nz) = p.T, normal.T
    # Written out: np.cross takes longer than all the rest.
    moment = np.array((py * nz - pz * ny, pz * nx - px * nz, px * ny - py * nx))
    rates = normal @ J[:3, :5] + moment.T @ J[3:, :5]
    return np.asarray(np.where(np.arange(5) < joints[:, None], rates, 0.0))


_ENDLESS = 1e6  # half the side of the box around a body without an end [m]


class Found(NamedTuple):
    """How near two bodies are to each other."""

    distance: float  # as in ``Clearance``
    p_first: Array  # the point of the first nearest to the second, in base, shape (3,), [m]
    p_second: Array  # the point of the second nearest to the first, in base, shape (3,), [m]
    normal: Array  # unit vector from the first to the second, shape (3,)


class PairsByCoal:
    """Distances and contacts of pairs of bodies by coal, which looks only where boxes are near.

    Bodies are no part of a Pinocchio geometry model: it copies a table of all pairs whenever a body
    is added, so 10,000 boxes took two minutes (pin 4.1.0).
    """

    def __init__(self, model: Any, data: Any, bodies: Bodies) -> None:
        self._model, self._data = model, data
        self._bodies, self._swapped = bodies.bodies, bodies.swapped
        self._indices = bodies.indices.tolist()
        self._first, self._second = bodies.indices.T
        self._movers = [i for i, each in enumerate(self._bodies) if each.joint > 0]
        self._requests = lru_cache(maxsize=64)(_request)
        boxes = [_local_box(each.shape) for each in self._bodies]
        self._local = np.array(boxes).reshape(-1, 2, 3)
        self._T = [each.placement for each in self._bodies]
        self._at = [_transform(each) for each in self._T]
        self._middles, self._halves = np.empty((2, len(boxes), 3))
        for i in range(len(boxes)):
            self._box(i)

    def place(self, q_full: Array) -> Array:
        """Move the bodies to a configuration (6,) [rad].

        Returns a distance that each pair has at least, shape (n,), [m]; minus infinity where their
        boxes overlap.
        """
        pin.forwardKinematics(self._model, self._data, q_full)
        for i in self._movers:
            body = self._bodies[i]
            self._T[i] = self._data.oMi[body.joint] * body.placement
            self._at[i] = _transform(self._T[i])
            self._box(i)
        gaps = np.abs(self._middles[self._first] - self._middles[self._second])
        gaps -= self._halves[self._first] + self._halves[self._second]
        least = np.sqrt((np.maximum(gaps, 0.0) ** 2).sum(axis=1))
        least[least == 0.0] = -np.inf
        return np.asarray(least)

    def boxes_within(self, distance: float, q_full: Array) -> list[int]:
        """The pairs whose boxes are within a distance [m] at a configuration (6,) [rad]."""
        return list(np.flatnonzero(self.place(q_full) <= distance))

    def touches(self, margins: Array, q_full: Array) -> bool:
        """Whether a pair is closer than its margin [m] at a configuration (6,) [rad]."""
        least = self.place(q_full)
        if np.isnan(least).any():  # angles that are no numbers
            return True
        for k in np.flatnonzero(least <= margins).tolist():
            a, b = self._indices[k]
            shapes = self._bodies[a].shape, self._at[a], self._bodies[b].shape, self._at[b]
            result = coal.CollisionResult()
            if coal.collide(*shapes, self._requests(float(margins[k])), result):
                return True
        return False

    def found(self, k: int) -> Found:
        """The distance of a pair, where the bodies are."""
        a, b = self._indices[k]
        shapes = self._bodies[a].shape, self._at[a], self._bodies[b].shape, self._at[b]
        result = coal.DistanceResult()
        distance = float(coal.distance(*shapes, _DISTANCE, result))
        if self._swapped[k]:
            sides = (result.getNearestPoint2(), result.getNearestPoint1(), -result.normal)
        else:
            sides = (result.getNearestPoint1(), result.getNearestPoint2(), result.normal)
        return Found(distance, *sides)

    def pair(self, k: int) -> tuple[int, Any, Any]:
        """The first body of a pair, the pose of the second, and that of the first in it."""
        a, b = self._indices[k]
        return a, self._T[b], self._T[b].actInv(self._T[a])

    def _box(self, i: int) -> None:
        middle, half = self._local[i]
        R = self._T[i].rotation
        self._middles[i], self._halves[i] = R @ middle + self._T[i].translation, np.abs(R) @ half


_DISTANCE = coal.DistanceRequest()


def _request(margin: float) -> Any:
    request = coal.CollisionRequest()
    request.security_margin = margin
    return request


def _transform(T: Any) -> Any:
    return coal.Transform3s(T.rotation, T.translation)


def _local_box(shape: Any) -> tuple[Array, Array]:
    """The middle and half the sides of a box around a shape, in its frame."""
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    if not max(np.abs(low).max(), np.abs(high).max()) < _ENDLESS:
        return np.zeros(3), np.full(3, _ENDLESS)
    radius = shape.getSweptSphereRadius() if hasattr(shape, "getSweptSphereRadius") else 0.0
    return 0.5 * (low + high), 0.5 * (high - low) + radius
