"""Measure pairs of bodies with coal, which looks only where the boxes around two bodies are near.

The compiled library answers most questions about a scene; what is close to a margin, the depth of
contacts, and reports come from here. Bodies are no part of a Pinocchio geometry model: it copies a
table of all pairs whenever a body is added, so 10,000 boxes took two minutes (pin 4.1.0).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.bodies import Bodies

_ENDLESS = 1e6  # half the side of the box around a body without an end [m]


class Found(NamedTuple):
    """Distance [m], nearest points [m] and normal of two bodies, as in ``ClosePair``."""

    distance: float
    p_first: Array
    p_second: Array
    normal: Array


class PairsByCoal:
    """Distances and contacts of pairs of bodies by coal."""

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
