"""The bodies of an arm and of the objects it holds, for keeping two arms apart.

They are hulls that contain the real parts (``bodies.py``), with bounds on how far each moves with
the joints, and their places at a configuration.
"""

from __future__ import annotations

import ctypes
from functools import cache, lru_cache
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.batch_check import BatchCheck, pointer
from so101_motion.planning.collision.bodies import bodies_without
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
        bodies, self.levers = bodies_without(self.model, attached, left_out)
        self.objects = bodies.bodies
        self.names = tuple(each.name for each in self.objects)
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
