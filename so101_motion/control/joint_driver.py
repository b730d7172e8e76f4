"""The interface of a driver of six joints, simulated or real.

The drivers fit this without importing it; mypy checks the fit in ``rig``.
"""

from __future__ import annotations

from typing import Protocol

from so101_motion.common.compliance import Compliance, Wall
from so101_motion.common.geometry import Array
from so101_motion.common.state import JointReading


class JointDriver(Protocol):
    """Six joints, real or simulated. Only the I/O thread calls it.

    Each method may raise; the arm is then in FAULT. ``read`` is still called now and then, so it is
    the place to reconnect; nothing is written before somebody asks the arm to hold again.
    """

    def read(self) -> JointReading:
        """Measure all joints."""

    def write(
        self,
        q_cmd: Array,
        q_jaw_cmd: float,
        qd_cmd: Array | None = None,
        qdd_cmd: Array | None = None,
        follows_target: bool = False,
    ) -> None:
        """Set the goals: arm joints, shape (5,), and jaw [rad].

        ``qd_cmd`` is the velocity of the arm joints at the goal, shape (5,), [rad/s]; a goal
        farther from the last one than it allows is refused. For None or NaN the driver's own cap
        holds, and the joint may be told to stay where it is. With torque off this only seeds the
        goal, which is then what was just measured. ``qdd_cmd`` is the acceleration, shape (5,),
        [rad/s^2], if it is known; lag compensation uses it. ``follows_target`` says that the joints
        follow targets instead of a plan: a joint may be told to turn round at any moment.

        Raises ``CommandRefused`` for a goal that is too far away; the joints stay at the last one.
        """

    def set_torque(self, on: bool) -> None:
        """Drive the joints or release them; before ``True`` the goal has been seeded."""

    def guide(self, compliance: Compliance | None, wall: Wall | None = None) -> None:
        """Let the arm joints yield to a hand and hold themselves up; None ends that.

        They are driven before and afterwards. Meanwhile ``read`` comes at every tick, and of what
        is written only the jaw's goal counts. Joints that have force resist a hand that leads them
        farther than ``wall`` says.
        """

    def close(self) -> None:
        """Release the port and leave the servos as they are. Nothing is called after this."""
