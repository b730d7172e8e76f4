"""Shapes by which benchmarks judge how near two arms are: polytopes, hulls and triangles.

*Polytopes* around the official solids, from measured supports in 400 directions: on edges they
stand out by some millimetres. *Hulls*, one a link, which contain the official parts and stand out
of their convex hulls by 0.8 mm at most. *Triangles*, as links are drawn, inside the hulls: as near
as this project comes to the true solids, whose meshes are not part of it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from itertools import product
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


class Facing:
    """Two arms of five joints and a jaw, the left one's base at the origin.

    Args:
        T_left_right: Where the right one's base is.
    """

    def __init__(self, T_left_right: SE3) -> None:
        self._bases = SE3.identity(), T_left_right
        self._model = RobotModel.load().pin_model
        self._data = self._model.createData()
        self._polytopes, self._hulls, self._triangles = polytopes(), hulls(), triangles()
        self.nearest_hulls = self.nearest_triangles = math.inf

    def touch(self, q_left: Array, q_right: Array) -> bool:
        """Whether the polytopes touch at configurations, shapes (6,), [rad]."""
        shapes = self._polytopes
        return any(
            coal.collide(
                shapes[a], T_a, shapes[b], T_b, coal.CollisionRequest(), coal.CollisionResult()
            )
            for a, T_a, b, T_b in self._pairs(q_left, q_right)
        )

    def measure(self, q_left: Array, q_right: Array) -> None:
        """Update how near hulls and triangles have come [m]; 0 for touching ones.

        Triangles are inside their hulls, so those of hulls that are further apart are left out.
        """
        for a, T_a, b, T_b in self._pairs(q_left, q_right):
            apart = _distance(self._hulls[a], T_a, self._hulls[b], T_b)
            self.nearest_hulls = min(self.nearest_hulls, apart)
            if apart < self.nearest_triangles:
                apart = _distance(self._triangles[a], T_a, self._triangles[b], T_b)
                self.nearest_triangles = min(self.nearest_triangles, apart)

    def _pairs(self, q_left: Array, q_right: Array) -> Iterator[tuple[str, Any, str, Any]]:
        """Links of either arm with their places; not both bases, which do not move."""
        left, right = map(self._placed, (q_left, q_right), self._bases)
        for (a, T_a), (b, T_b) in product(left.items(), right.items()):
            if not a == b == BASE:
                yield a, T_a, b, T_b

    def _placed(self, q: Array, T: SE3) -> dict[str, Any]:
        pin.framesForwardKinematics(self._model, self._data, q)
        base, found = pin.SE3(np.array(T.R), np.array(T.p)), {}
        for link in self._hulls:
            place = base * self._data.oMf[self._model.getFrameId(link)]
            found[link] = coal.Transform3s(place.rotation, place.translation)
        return found


def _distance(a: Any, T_a: Any, b: Any, T_b: Any) -> float:
    found = coal.distance(a, T_a, b, T_b, coal.DistanceRequest(), coal.DistanceResult())
    return max(float(found), 0.0)
