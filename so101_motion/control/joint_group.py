"""The joints of a port: their two groups, the tolerances of motions, the interface of a driver."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from so101_motion.common.compliance import Compliance, Wall
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT, JointReading


class Channel(Enum):
    """A group of joints that move together."""

    ARM = "arm"
    JAW = "jaw"

    @property
    def joints(self) -> tuple[str, ...]:
        return ARM_JOINTS if self is Channel.ARM else (GRIPPER_JOINT,)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerances:
    """When a motion has arrived, and when a joint does not follow.

    The defaults suit the simulated arm; a real servo resolves 0.0015 rad and sags under load, so
    its driver comes with wider ones. All values chosen.

    Attributes:
        settle_position: Largest position error at the end [rad]; the default moves the tool of the
            stretched arm by less than 0.1 mm.
        late_position: The same for joints that half of ``settle_timeout`` brought no nearer [rad].
        settle_velocity: Largest velocity of a joint at rest [rad/s].
        settle_ticks: For how many ticks in a row both must hold.
        settle_timeout: How long after the last setpoint that may take [s].
        following_error: How far a joint may be from where it was wanted during the last
            ``following_lag`` [rad].
        contact_windows: Times within which a joint must move if its setpoints do [s].
        contact_distance: How much less than its setpoints it may move in such a time [rad];
            without a bound by default.
        contact_share: The same as a share of what they move; the larger of the two counts.
        pressed_stray: How much farther from its setpoints than just before a joint may be if it
            followed slowly and evenly and now stands, and its gears stay on one side of their
            play [rad]. By default no joint is checked for this, nor are those in their play.
        following_lag: How far behind its setpoints a healthy servo may be [s].
    """

    settle_position: float = 1e-4
    late_position: float = 1e-4
    settle_velocity: float = 0.01
    settle_ticks: int = 3
    settle_timeout: float = 1.0
    following_error: float = 0.14
    following_lag: float = 0.1
    contact_windows: tuple[float, ...] = (0.08, 0.24)
    contact_distance: float = math.inf
    contact_share: float = 0.6
    pressed_stray: float = math.inf


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
        room: float = 0.0,
    ) -> None:
        """Set the goals: arm joints, shape (5,), and jaw [rad].

        ``qd_cmd`` is the velocity of the arm joints at the goal, shape (5,), [rad/s]; a goal
        farther from the last one than it allows is refused. For None or NaN the driver's own cap
        holds, and the joint may be told to stay where it is. With torque off this only seeds the
        goal, which is then what was just measured. ``qdd_cmd`` is the acceleration, shape (5,),
        [rad/s^2], if it is known; lag compensation uses it. ``follows_target`` says that the joints
        follow targets instead of a plan: a joint may be told to turn round at any moment. By the
        share ``room`` all may be faster now without being faster than they are planned to be soon.

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
