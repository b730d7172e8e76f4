"""Shapes by which benchmarks judge how near arms are to each other: polytopes, hulls, triangles.

*Polytopes* around the official solids, from measured supports in 400 directions: on edges they
stand out by some millimetres. *Hulls*, one a link, which contain the official parts and stand out
of their convex hulls by 0.8 mm at most. *Triangles*, as links are drawn, inside the hulls: as near
as this project comes to the true solids, whose meshes are not part of it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import so101_description
from scipy.spatial import HalfspaceIntersection

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.coal_shapes import convex_hull, standing_shape
from so101_motion.planning.collision.scene import Mesh
from so101_motion.planning.kinematics.model import RobotModel

SUPPORTS = Path(__file__).parents[1] / "tests" / "data" / "official_supports.json"
BASE = "base_link"

Shapes = Mapping[str, Any]
"""Coal's shapes by the name of their link."""


def polytopes() -> Shapes:
    """Polytopes around the official solids."""
    known = json.loads(SUPPORTS.read_text())
    k = np.arange(known["count"])
    z = 1.0 - 2.0 * (k + 0.5) / known["count"]
    azimuth = np.pi * (1.0 + np.sqrt(5.0)) * (k + 0.5)
    flat = np.sqrt(1.0 - z * z)
    directions = np.column_stack((flat * np.cos(azimuth), flat * np.sin(azimuth), z))
    found = {}
    for link, reach_mm in known["supports_mm"].items():
        reach = np.array(reach_mm) * 1e-3
        inside = np.linalg.lstsq(directions, reach, rcond=None)[0]
        planes = np.column_stack((directions, -reach))
        found[link] = convex_hull(HalfspaceIntersection(planes, inside).intersections)
    return found


def hulls() -> Shapes:
    """Hulls that contain the official parts."""
    parts = so101_description.PARTS
    return {
        link: convex_hull(so101_description.load_hull(part).vertices)
        for link, part in parts.items()
    }


def triangles() -> Shapes:
    """The links as they are drawn."""
    found = {}
    for link, part in so101_description.PARTS.items():
        meshes = [each.mesh for each in so101_description.load_visual(part)]
        first = np.cumsum([0, *(len(each.vertices) for each in meshes)])
        vertices = np.concatenate([each.vertices for each in meshes])
        faces = np.concatenate([each.faces + k for each, k in zip(meshes, first, strict=False)])
        found[link] = standing_shape(Mesh(vertices=vertices, triangles=faces))
    return found


class Solids:
    """Arms of five joints and a jaw that stand somewhere.

    Args:
        bases: Where the base of each is.
    """

    def __init__(self, *bases: SE3) -> None:
        self._bases = bases
        self._model = RobotModel.load().pin_model
        self._data = self._model.createData()
        self._polytopes, self._hulls, self._triangles = polytopes(), hulls(), triangles()
        self._links = list(self._hulls)
        self._balls = [_ball(self._polytopes[each], self._hulls[each]) for each in self._links]
        self.nearest_hulls = self.nearest_triangles = math.inf

    def touch(self, *q: Array) -> bool:
        """Whether polytopes of two arms touch at configurations of all, shapes (6,), [rad]."""
        shapes = self._polytopes
        return any(
            coal.collide(
                shapes[a], T_a, shapes[b], T_b, coal.CollisionRequest(), coal.CollisionResult()
            )
            for a, T_a, b, T_b in self._pairs(q, 0.0)
        )

    def measure(self, *q: Array) -> None:
        """Update how near hulls and triangles of two arms have come [m]; 0 for touching ones.

        Triangles are inside their hulls, so those of hulls that are further apart are left out.
        """
        for a, T_a, b, T_b in self._pairs(q, self.nearest_triangles):
            apart = _distance(self._hulls[a], T_a, self._hulls[b], T_b)
            self.nearest_hulls = min(self.nearest_hulls, apart)
            if apart < self.nearest_triangles:
                apart = _distance(self._triangles[a], T_a, self._triangles[b], T_b)
                self.nearest_triangles = min(self.nearest_triangles, apart)

    def _pairs(self, q: Sequence[Array], within: float) -> Iterator[tuple[str, Any, str, Any]]:
        """Links of every two arms that may be within so much [m] of each other, with their places.

        Not both bases, which do not move.
        """
        radii = np.array([radius for _, radius in self._balls])
        for (one, at), (other, to) in combinations(map(self._placed, q, self._bases), 2):
            far = np.linalg.norm(at[:, None] - to[None], axis=2) - radii[:, None] - radii[None]
            for i, j in np.argwhere(far < within).tolist():
                a, b = self._links[i], self._links[j]
                if not a == b == BASE:
                    yield a, one[i], b, other[j]

    def _placed(self, q: Array, T: SE3) -> tuple[list[Any], Array]:
        """Where the links are, and the middles of the balls around them."""
        pin.framesForwardKinematics(self._model, self._data, q)
        base, places, middles = pin.SE3(np.array(T.R), np.array(T.p)), [], []
        for link, (middle, _) in zip(self._links, self._balls, strict=True):
            place = base * self._data.oMf[self._model.getFrameId(link)]
            places.append(coal.Transform3s(place.rotation, place.translation))
            middles.append(place.act(middle))
        return places, np.array(middles)


def _ball(*shapes: Any) -> tuple[Array, float]:
    """The middle and the radius of a ball around shapes."""
    points = np.concatenate([np.array(each.points()) for each in shapes])
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return middle, float(np.linalg.norm(points - middle, axis=1).max())


def _distance(a: Any, T_a: Any, b: Any, T_b: Any) -> float:
    found = coal.distance(a, T_a, b, T_b, coal.DistanceRequest(), coal.DistanceResult())
    return max(float(found), 0.0)
