"""The bodies of an arm and of the objects it holds, for keeping two arms apart.

They are hulls that contain the real parts (``bodies.py``), with bounds on how far each moves with
the joints, and their places at a configuration.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.batch_check import BatchCheck, pointer
from so101_motion.planning.collision.bodies import Body, bodies_without
from so101_motion.planning.collision.scene import Attached, Scene
from so101_motion.planning.kinematics.model import RobotModel


class ArmBodies:
    """The bodies of one arm and of the objects it holds. May be used by any thread.

    Attributes:
        passed: Names of objects that the other arm's gripper may touch.
        names: Their names in messages.
        levers: Bounds on the distance of any point of each body from each joint's axis, shape
            (n, 6), [m].
    """

    def __init__(
        self,
        model: RobotModel,
        attached: tuple[Attached, ...] = (),
        left_out: frozenset[str] = frozenset(),
        passed: frozenset[str] = frozenset(),
    ) -> None:
        self.model, self.passed = model.pin_model, passed
        self._robot, self._attached = model, attached
        bodies = bodies_without(self.model, attached, left_out)
        self.objects = bodies.bodies
        self.names = tuple(each.name for each in self.objects)
        offsets = [np.array(self.model.jointPlacements[j].translation) for j in range(1, 7)]
        self.levers = np.array([_levers(each, offsets) for each in self.objects], dtype=float)
        self.levers_pointer = pointer(self.levers)
        self._without = dict[frozenset[str], ArmBodies]()
        self._batch = BatchCheck(self.model, bodies, 0.0)

    @property
    def handle(self) -> ctypes.c_void_p:
        """The compiled library's handle of them."""
        return self._batch.scene

    def without(self, left_out: frozenset[str]) -> ArmBodies:
        """A copy without some bodies, and without objects that are passed on."""
        if left_out not in self._without:
            self._without[left_out] = ArmBodies(self._robot, self._attached, left_out)
        return self._without[left_out]

    def placed(self, q: Array, T: SE3, data: Any) -> list[Any]:
        """Poses of the bodies at a configuration (6,) of an arm with its base at ``T``; coal's."""
        pin.forwardKinematics(self.model, data, q)
        base = pin.SE3(np.array(T.R), np.array(T.p))
        places = [base * data.oMi[each.joint] * each.placement for each in self.objects]
        return [coal.Transform3s(each.rotation, each.translation) for each in places]


@cache
def _model() -> RobotModel:
    return RobotModel.load()


@lru_cache(maxsize=32)
def bodies_of(attached: tuple[Attached, ...] = (), to: str | None = None) -> ArmBodies:
    """The bodies of an SO-101 that holds ``attached``; cached.

    They are checked against the arm ``to``, which may touch an object passed to it; None for any
    arm.
    """
    passed = (each.name for each in attached if each.passed_to and to in (None, each.passed_to))
    return _bodies_in(Scene(attached=attached, floor_z=None), frozenset(passed))


@lru_cache(maxsize=32)
def _bodies_in(scene: Scene, passed: frozenset[str]) -> ArmBodies:
    return ArmBodies(_model(), scene.attached, passed=passed)


def _levers(body: Body, offsets: Sequence[Array]) -> Array:
    """Bounds on the distance of a body's points from each joint's axis, shape (6,), [m]."""
    levers, joint = np.zeros(6), body.joint
    if joint == 0:
        return levers
    points = _corners(body.shape) @ body.placement.rotation.T + body.placement.translation
    extra = float(body.shape.getSweptSphereRadius())
    levers[joint - 1] = float(np.linalg.norm(points[:, :2], axis=1).max()) + extra
    ball = float(np.linalg.norm(points, axis=1).max()) + extra
    for j in range(joint - 1, 0, -1):
        offset = offsets[j]
        levers[j - 1] = float(np.linalg.norm(offset[:2])) + ball
        ball += float(np.linalg.norm(offset))
    return levers


def _corners(shape: Any) -> Array:
    if isinstance(shape, coal.ConvexBase):
        return np.array(shape.points())
    shape.computeLocalAABB()
    box = shape.aabb_local
    low, high = np.array(box.min_), np.array(box.max_)
    return np.array([np.where(pick, low, high) for pick in np.ndindex(2, 2, 2)])
