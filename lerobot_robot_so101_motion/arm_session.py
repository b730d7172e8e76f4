"""Make one arm follow the targets of a client, from the first target to the end of the session.

To a first target that is far it moves along a plan while the client waits; then a guarded following
uses every target in the next control cycle. When a joint is blocked, the arm holds until a target
is near. If it cannot be reached or has a fault, an error is raised.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lerobot_robot_so101_motion.units import JointUnits
from so101_motion.arm.arm import SCENE
from so101_motion.arm.gripper import JawFollowing
from so101_motion.arm.joint_caps import JointCaps
from so101_motion.arm.motion_handle import Motion
from so101_motion.common.errors import FollowingError, MotionError, PlanningError, So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.realtime import LOOK_FOR_SIGNALS
from so101_motion.common.state import ARM_JOINTS, JointState
from so101_motion.common.units import to_deg, to_rad
from so101_motion.control.following import APPROACH, GATE, Following
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.tasks.teleop.pilot import FULL_JERK
from so101_motion.tasks.teleop.sides import JAW_APPROACH

if TYPE_CHECKING:
    from so101_motion.rig.hardware_rig import HardwareRig

_log = logging.getLogger(__name__)

SILENT_AFTER = 0.5  # how old a measurement may be [s], as for the driver

LIES_WITHIN = to_rad(6.0)
"""Largest distance from a lying pose at which an arm is released [rad]; chosen."""

LOWERED_BY, LOWERING = (
    to_rad(25.0),
    MotionLimits.uniform(velocity=to_rad(15.0), acceleration=to_rad(50.0), jerk=20.0),
)
"""How far and how fast an arm is lowered until it lies on something [rad]; chosen: from ``rest``
the forearm sinks by 18 deg."""

BEARS = 0.1
"""A joint that carries less torque than this stays in place when it is released [N m]; chosen,
below the friction of a servo."""

REST_WITHIN = 10.0  # how long to wait for a stop [s]; it takes less than a second
PARKED_WITHIN = 60.0  # how long to wait for the motion to the park pose [s]; chosen
Waiter = Callable[["Future[None]", float], None]  # waits at most so long [s]; raises the error


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
        *,
        waiter: Waiter | None = None,
    ) -> None:
        self.rig, self._pace, self.wait = rig, pace, waiter or wait_in_real_time
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
        taken = self.state.q_ref if following is None else following.aim(q)
        return taken, self._aim_jaw(aperture)

    def rest(self) -> None:
        """Come to rest and end the following; the arm holds, and the jaw keeps its grip."""
        endings = [each.close() for each in (self._following, self._jaw) if each is not None]
        self._following = self._jaw = None
        for ending in endings:
            self.wait(ending, REST_WITHIN)

    def go(self, q: Array, *, within: float = PARKED_WITHIN) -> None:
        """Move along a plan to joint angles, shape (5,), [rad], with the approach caps; wait."""
        motion = self.rig.arm.move(JointGoal(q=q), limits=self._pace.approach, wait=False)
        self._await(motion, within)

    def release_where_it_lies(self, poses: tuple[Array, ...]) -> bool:
        """Lower and release the arm if it is at one of ``poses``, each (5,), [rad]; says whether.

        It is lowered slowly in the direction of its weight until it lies on something: in the pose
        ``rest`` there are some millimetres left under the forearm.
        """
        arm = self.rig.arm
        q = arm.state.q
        if not any(float(np.max(np.abs(q - pose))) <= LIES_WITHIN for pose in poses):
            return False
        self._lower()
        arm.set_torque(False)
        return True

    def _lower(self) -> None:
        arm = self.rig.arm
        for i in range(len(ARM_JOINTS)):
            q = np.append(arm.state.q_ref, self.rig.gripper.q_jaw)
            torque = float(arm.model.gravity_torque(q)[i])
            if abs(torque) < BEARS:
                continue
            lying = q[:5]
            lying[i] -= np.sign(torque) * LOWERED_BY
            lying = np.clip(lying, *arm.range)
            with suppress(FollowingError):  # the arm lies on something
                motion = arm.retarget(lying, limits=LOWERING, guard=None)
                self._await(motion, REST_WITHIN)

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
        return jaw.aim(aperture)

    def _await(self, motion: Motion, within: float) -> None:
        try:
            self.wait(motion.future, within)
        except BaseException:
            motion.interrupt("stop")  # nothing if it is over
            with suppress(So101Error, TimeoutError):
                self.wait(motion.future, REST_WITHIN)
            raise


def wait_in_real_time(future: Future[None], seconds: float) -> None:
    """Wait until ``future`` is done; ``MotionError`` if it is not in time. Signals are handled."""
    end = time.monotonic() + seconds
    while not future.done():
        left = end - time.monotonic()
        if left <= 0.0:
            raise MotionError(f"the arm's motion did not end within {seconds:g} s")
        wait((future,), min(left, LOOK_FOR_SIGNALS))
    future.result()
