"""Report joints that rest outside the served limits as just inside, so that viam-server plans.

The served kinematics have the joint limits of the robot's description, and viam-server checks every
arm of a machine against them before it plans: with one joint a tick outside, its builtin motion
service moves no arm at all. Real joints do rest outside, because a joint's zero is known to a few
degrees only. So ``GetJointPositions`` moves the angle inside, by ``FARTHEST`` at most, and the
status has a note. The pose, the geometries, the status and our own plans use the measured angles.
"""

from __future__ import annotations

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import range_deg, to_deg
from so101_motion.control.limit_recovery import FARTHEST_OUT
from so101_motion.viam.conversion.kinematics import chain

FARTHEST = FARTHEST_OUT
"""By how much a reported angle may differ from the measured one [rad]. A joint farther out is most
likely not calibrated, and its measured angle is reported."""


def served_limits() -> tuple[Array, Array]:
    """The joint limits that viam-server knows, lower and upper, shapes (5,), [rad]."""
    joints = [segment for segment in chain() if segment.joint is not None]
    return np.array([each.lower for each in joints]), np.array([each.upper for each in joints])


def reported(q: Array) -> Array:
    """The angles to report to viam-server for an arm at ``q``, both shape (5,), [rad]."""
    inside = np.clip(q, *served_limits())
    return np.where(np.abs(q - inside) <= FARTHEST, inside, q)


def remarks(q: Array) -> list[str]:
    """A note for each joint that is outside the served limits."""
    lower, upper = served_limits()
    found = []
    for i in np.flatnonzero((q < lower) | (q > upper)):
        here, between = to_deg(float(q[i])), range_deg(float(lower[i]), float(upper[i]), 1)
        said = to_deg(float(reported(q)[i]))
        then = (
            f"GetJointPositions says {said:.1f} deg, because viam-server's builtin motion service"
            " moves no arm of the machine while one is outside; joint_positions_deg of the status"
            " is what was measured. Move the joint inside, or calibrate the arm again"
            if said != here
            else "viam-server's builtin motion service moves no arm of the machine until it is"
            " inside. Move it inside by hand, or calibrate the arm again"
        )
        found.append(
            f"{ARM_JOINTS[i]} is at {here:.1f} deg, outside the limits that viam-server knows,"
            f" {between} deg; {then}"
        )
    return found
