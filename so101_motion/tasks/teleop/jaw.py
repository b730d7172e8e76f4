"""Move the follower's jaw with the leader's trigger, and grip what it closes on.

The jaw runs after the trigger like the arm after the leader. What it closes on stops it; it then
falls behind its setpoints, which ends the pursuit, and the gripper's own grab takes over: that
presses with a steady force instead of ever harder, however far the trigger is drawn. When the
trigger is opened beyond where the jaw stands, or the thing has slipped out, the jaw runs after it
again.
"""

from __future__ import annotations

import numpy as np

from so101_motion.arm.gripper import Gripper
from so101_motion.arm.motion_handle import Motion
from so101_motion.common.errors import FollowingError
from so101_motion.control.target_tracking import Pursuit, TrackingTarget
from so101_motion.planning.timing.trajectory import Setpoint
from so101_motion.tasks.teleop.pilot import Pilot

LET_GO = 0.03
"""How much wider than the jaw stands the trigger must want it for a grip to be given up, share of
the travel; chosen: more than a trigger trembles."""


class Jaw:
    """Moves one gripper after the trigger.

    Args:
        gripper: The follower's.
        pilot: Says what the trigger wants.
    """

    def __init__(self, gripper: Gripper, pilot: Pilot) -> None:
        self._gripper, self._pilot = gripper, pilot
        self._pursuit: Pursuit | None = None
        self._grip: Motion | None = None

    @property
    def is_gripping(self) -> bool:
        """Whether it has closed on something."""
        return self._grip is not None and self._gripper.is_holding

    def is_idle(self) -> bool:
        """Whether it no longer follows the trigger, so that ``take_up`` is due."""
        if self._grip is not None:
            wanted = self._wanted()
            is_let_go = wanted is not None and wanted > self._gripper.aperture + LET_GO
            return is_let_go or (self._grip.future.done() and not self._gripper.is_holding)
        return self._pursuit is None or self._pursuit.future.done()

    def take_up(self) -> None:
        """Press on the object, or follow the trigger again. May block.

        Raises:
            So101Error: The jaw cannot be moved now.
        """
        pursuit, self._pursuit = self._pursuit, None
        self._grip = None
        ended = pursuit.future if pursuit is not None and pursuit.future.done() else None
        has_met = ended is not None and isinstance(ended.exception(), FollowingError)
        self._go_on(grips=has_met)

    def resume(self) -> None:
        """Continue after the joints were held anew, which released the grip. May block.

        Raises:
            So101Error: The jaw cannot be moved now.
        """
        gripped, self._grip = self._grip is not None, None
        self._pursuit = None
        self._go_on(grips=gripped)

    def close(self) -> None:
        """Stop; keeps a grip."""
        pursuit, self._pursuit = self._pursuit, None
        if pursuit is not None:
            pursuit.close().exception()

    # How

    def _go_on(self, *, grips: bool) -> None:
        wanted = self._wanted()
        if grips and wanted is not None and wanted < self._gripper.aperture + LET_GO:
            self._grip = self._gripper.start_grab(wanted)
        else:
            self._pursuit = self._gripper.open_pursuit(self._aim)

    def _wanted(self) -> float | None:
        seen = self._pilot.jaw(self._gripper.limits)
        return None if seen is None else seen[0]

    def _aim(self, now: Setpoint) -> TrackingTarget | None:
        seen = self._pilot.jaw(self._gripper.limits)
        if seen is None:
            return None
        aperture, rate, limits = seen
        span = self._gripper.opened - self._gripper.closed
        return TrackingTarget(
            q=np.array([self._gripper.closed + aperture * span]),
            qd=np.array([rate * span]),
            limits=limits,
        )
