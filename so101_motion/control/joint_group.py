"""The two groups of joints, arm and jaw, and the tolerances of their motions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT


class Channel(Enum):
    """A group of joints that move together."""

    ARM = "arm"
    JAW = "jaw"

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of its joints."""
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
