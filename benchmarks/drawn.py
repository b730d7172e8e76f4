"""Check contact independently of the planner: with the drawn triangles, without any margin.

It shares neither hulls, nor pairs, nor margins with ``planning/collision/collision.py``. All links
are held against each other except those that hinge on each other, all but base and shoulder against
the floor, and all but the base against every obstacle.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import so101_description

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.coal_shapes import full_cubes, octree
from so101_motion.planning.collision.scene import Box, PointCloud, Scene


class DrawnArm:
    """The arm as drawn among boxes and clouds. Belongs to one thread."""

    def __init__(self, scene: Scene) -> None:
        self._model = pin.buildModelFromUrdf(str(so101_description.URDF_PATH))
        self._data = self._model.createData()
        self._bodies = pin.GeometryModel()
        for link, part in so101_description.PARTS.items():
            frame = self._model.frames[self._model.getFrameId(link)]
            self._add(link, frame.parentJoint, frame.placement, _triangles(part))
        links = range(len(so101_description.PARTS))
        pairs = [(i, j) for i in links for j in links if j > i + 1]
        if scene.floor_z is not None:
            plane = coal.Halfspace(np.array([0.0, 0.0, 1.0]), scene.floor_z)
            floor = self._add("floor", 0, pin.SE3.Identity(), plane)
            pairs += [(i, floor) for i in links[2:]]
        for obstacle in scene.obstacles:
            T, shape = obstacle.T_base_obstacle, obstacle.shape
            assert isinstance(shape, Box | PointCloud)
            standing = (
                coal.Box(*shape.size.tolist())
                if isinstance(shape, Box)
                else octree(full_cubes(shape), shape.resolution)
            )
            this = self._add(obstacle.name, 0, pin.SE3(np.array(T.R), np.array(T.p)), standing)
            pairs += [(i, this) for i in links[1:]]
        for pair in pairs:
            self._bodies.addCollisionPair(pin.CollisionPair(*pair))
        self._results = pin.GeometryData(self._bodies)
        self._manager = pin.BroadPhaseManager_NaiveCollisionManager(
            self._model, self._bodies, self._results
        )
        self._stop = pin.CollisionCallBackDefault(self._bodies, self._results, True)

    def touches(self, q: Array, q_jaw: float = 0.0) -> bool:
        """Whether anything touches anything at joint angles ``q``, shape (5,), [rad]."""
        posture = np.append(q, q_jaw)
        return bool(
            pin.computeCollisions(self._model, self._data, self._manager, self._stop, posture)
        )

    def touches_along(self, points: Array, step: float) -> bool:
        """The same anywhere on a polyline, shape (n, 5), looked at every ``step`` [rad]."""
        for a, b in pairwise(points):
            count = max(1, int(np.ceil(np.linalg.norm(b - a) / step)))
            if any(self.touches(a + (k / count) * (b - a)) for k in range(count)):
                return True
        return self.touches(points[-1])

    def _add(self, name: str, joint: int, placement: Any, shape: Any) -> int:
        return int(
            self._bodies.addGeometryObject(pin.GeometryObject(name, joint, placement, shape))
        )


def _triangles(part: str) -> Any:
    meshes = [surface.mesh for surface in so101_description.load_visual(part)]
    shape = coal.BVHModelOBBRSS()
    shape.beginModel(sum(len(m.faces) for m in meshes), sum(len(m.vertices) for m in meshes))
    for mesh in meshes:
        for a, b, c in mesh.vertices[mesh.faces]:
            shape.addTriangle(a, b, c)
    shape.endModel()
    return shape
