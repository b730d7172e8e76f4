"""Make one arm follow the targets of a client, from the first target to the end of the session.

To a first target that is far it moves along a plan while the client waits; then a guarded following
uses every target in the next control cycle. When a joint is blocked, the arm holds until a target
is near. If it cannot be reached or has a fault, an error is raised.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lerobot_robot_so101_motion.units import JointUnits
from so101_motion.arm.arm import SCENE
from so101_motion.arm.gripper import JawFollowing
from so101_motion.arm.joint_caps import JointCaps
from so101_motion.common.errors import MotionError, PlanningError
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.state import JointState
from so101_motion.common.units import to_deg, to_rad
from so101_motion.control.following import APPROACH, GATE, Following
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.session_end import (
    REST_WITHIN,
    Waiter,
    release_where_it_lies,
    wait_for,
)
from so101_motion.tasks.teleop.pilot import FULL_JERK
from so101_motion.tasks.teleop.sides import JAW_APPROACH

if TYPE_CHECKING:
    from so101_motion.rig.hardware_rig import HardwareRig

_log = logging.getLogger(__name__)

SILENT_AFTER = 0.5  # how old a measurement may be [s], as for the driver

PARKED_WITHIN = 60.0  # how long to wait for the motion to the park pose [s]; chosen


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """The caps and the guard of an arm that follows."""

    speed: float = to_rad(180.0)  # cap on the speed of each joint [rad/s]
    acceleration: float = to_rad(500.0)  # cap on the acceleration of each joint [rad/s^2]
    approach_speed: float = to_rad(30.0)  # cap on the speed to a first target that is far [rad/s]
    stale_after: float = 0.25  # the arm slows to rest after this long without a target [s]
    guarded: bool = True  # whether it keeps clear of itself and of its scene

    @property
    def full(self) -> MotionLimits:
        """The caps while it follows."""
        return MotionLimits.uniform(
            velocity=self.speed, acceleration=self.acceleration, jerk=FULL_JERK
        )

    @property
    def approach(self) -> MotionLimits:
        """The caps on the path to a first target."""
        slow = np.minimum(self.approach_speed, self.speed)
        return MotionLimits.uniform(
            velocity=float(slow),
            acceleration=min(float(APPROACH.acceleration[0]), self.acceleration),
            jerk=float(APPROACH.jerk[0]),
        )


class ArmSession:
    """One arm that follows a client. Its methods are for one thread; ``state`` is for any.

    Caps and guard are those of ``pace`` while it follows. ``ConfigError`` if a cap is out of range.
    """

    def __init__(
        self,
        rig: HardwareRig,
        pace: Pace,
        scene: Scene,
        use_degrees: bool,
        wait: Waiter,
    ) -> None:
        self.rig, self._pace, self.wait = rig, pace, wait
        self._use_degrees = use_degrees
        self.learn_units()
        arm = rig.arm
        arm.scene = scene
        arm.set_ceiling(JointCaps(speed=pace.speed, acceleration=pace.acceleration))
        arm.set_speed(pace.speed)
        arm.set_acceleration(pace.acceleration)
        rig.warm_up()  # the first plan is often wanted at once
        self._following: Following | None = None
        self._jaw: JawFollowing | None = None
        self._trouble = ""  # why it holds until a target is near

    def learn_units(self) -> None:
        """Take over the calibration that the servos have now."""
        self.units = JointUnits(self.rig, use_degrees=self._use_degrees)

    @property
    def here(self) -> dict[str, float]:
        """The measured joint values in LeRobot's units, by key; raises as ``state`` does."""
        aperture = min(max(self.rig.gripper.aperture, 0.0), 1.0)
        return self.units.to_lerobot(self.state.q, aperture)

    @property
    def state(self) -> JointState:
        """The arm's newest state, at most ``SILENT_AFTER`` old.

        ``MotionError`` if it cannot be reached, or is in a fault.
        """
        rig, state = self.rig, self.rig.arm.state
        age, where = rig.clock.now() - state.t, f"the arm on {rig.settings.port}"
        if not rig.servos.is_connected or age > SILENT_AFTER:
            reason = rig.connection.problem or f"its servos have been silent for {age:.1f} s"
            raise MotionError(f"{where} cannot be reached: {reason}")
        if state.mode is Mode.FAULT:
            raise MotionError(f"{where} is in a fault: {state.fault}")
        return state

    @property
    def held_by(self) -> tuple[str, ...]:
        """The bodies or limits that keep the arm from its target; empty without any."""
        return () if self._following is None else self._following.held_by

    def follow(self, q: Array, aperture: float) -> tuple[Array, float]:
        """Follow a target from the next control cycle on; moves to the first one and waits.

        Joint angles have shape (5,), [rad], the jaw's opening is 0 to 1. Returns the target within
        the arm's range; its held position while it waits for a near one.
        """
        following = self._following
        if following is None or following.future.done():
            following = self._begin(q)
        # However far: what a policy says is drawn into the range, and told.
        taken = self.state.q_ref if following is None else following.aim(q, most=math.inf)
        return taken, self._aim_jaw(aperture)

    def rest(self) -> None:
        """Come to rest and end the following; the arm holds, and the jaw keeps its grip."""
        endings = [each.close() for each in (self._following, self._jaw) if each is not None]
        self._following = self._jaw = None
        for ending in endings:
            self.wait(ending, REST_WITHIN)

    def go(self, q: Array) -> None:
        """Move along a plan to joint angles, shape (5,), [rad], with the approach caps; wait."""
        motion = self.rig.arm.move(JointGoal(q=q), limits=self._pace.approach, wait=False)
        wait_for(motion, PARKED_WITHIN, self.wait)

    def release_where_it_lies(self, poses: tuple[Array, ...]) -> bool:
        """As ``session_end.release_where_it_lies``."""
        return release_where_it_lies(self.rig, poses, self.wait)

    def _begin(self, q: Array) -> Following | None:
        """Open a following, after a planned move to a far target; None while the arm waits."""
        ended, self._following = self._following, None
        if ended is not None and (error := ended.future.exception()) is not None:
            self._note(error)
        arm, pace, state = self.rig.arm, self._pace, self.state
        lower, upper = arm.range
        goal = np.clip(q, lower, upper)
        is_far = float(np.max(np.abs(goal - state.q_ref))) > GATE
        if is_far and (self._trouble or (pace.guarded and not self._has_approached(goal))):
            return None
        self._trouble = ""
        self._following = following = arm.follow(
            limits=pace.full,
            guard=SCENE if pace.guarded else None,
            approach=pace.approach,
            stale_after=pace.stale_after,
        )
        return following

    def _has_approached(self, goal: Array) -> bool:
        """Move to a first target along a plan; whether the arm may follow from there."""
        try:
            self.go(goal)
        except PlanningError as error:
            _log.warning(
                "no plan to the first target: %s. The arm moves as near to it as it can", error
            )
        except MotionError as error:
            self._note(error)
            return False
        return True

    def _note(self, error: BaseException) -> None:
        self._trouble = str(error)
        _log.warning(
            "%s. The arm holds until a target is at most %.0f deg away", error, to_deg(GATE)
        )

    def _aim_jaw(self, aperture: float) -> float:
        jaw = self._jaw
        if jaw is None or jaw.future.done():
            limits = self.rig.gripper.limits
            slow = limits.lowered_to(JAW_APPROACH * limits.velocity, limits.acceleration)
            self._jaw = jaw = self.rig.gripper.follow(
                approach=slow, stale_after=self._pace.stale_after
            )
        return jaw.aim(aperture, most=math.inf)
