"""The torques that hold an arm still: its weight, and what a load in the gripper adds.

They are needed in every cycle, so ``servo_weight.c`` computes them. The planner's model says where
the masses are.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.drivers.goal_limiter import SIX
from so101_motion.native.library import quick

THREE = ctypes.c_double * 3


class ArmWeight(ctypes.Structure):
    """The weight of an arm; called with angles, it gives the torques that hold them.

    Args:
        bodies: For each joint its placement in the one before, rotation by rows and position [m],
            and the mass [kg] and centre [m] of what it moves, shape (6, 16). It turns about its z.
        loaded: The same with a kilogram in the gripper.
        gravity: The acceleration in the base, shape (3,), [m/s^2].
    """

    _fields_ = [("up", THREE), ("load", THREE), ("body", ctypes.c_double * 16 * 6)]

    def __init__(self, bodies: Array, loaded: Array, gravity: Array) -> None:
        mass, mass_loaded = bodies[4, 12], loaded[4, 12]
        load = (mass_loaded * loaded[4, 13:] - mass * bodies[4, 13:]) / (mass_loaded - mass)
        super().__init__(up=THREE(*-gravity), load=THREE(*load))
        ctypes.memmove(self.body, np.ascontiguousarray(bodies).ctypes.data, 6 * 16 * 8)

    def __call__(self, q: Sequence[float] | Array) -> Array:
        """Torques that hold the six joints of the empty arm at ``q`` (6,) [rad], (6,), [N m]."""
        return self._weighed(q)[0]

    def per_kg(self, q: Sequence[float] | Array) -> Array:
        """What each kilogram in the gripper adds to them, shape (6,), [N m/kg]."""
        return self._weighed(q)[1]

    def _weighed(self, q: Sequence[float] | Array) -> tuple[Array, Array]:
        own, per_kg = SIX(), SIX()
        quick().so101_weigh(ctypes.byref(self), SIX(*q), own, per_kg)
        return np.array(own), np.array(per_kg)
