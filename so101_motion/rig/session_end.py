"""Leave an arm at the end of a session: it holds, is released, goes home, or is parked.

The way home or to the park pose is a planned motion like any other: around the scene, under the
arm's caps, and a stop or a newer motion ends it, after which the arm holds. Joints that are not
held (limp, guided, in a fault, lent out) are left as they are. At the park pose the arm is lowered
until it lies on something, and let go of; a parked arm costs no current.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from so101_motion.common import interrupts
from so101_motion.common.errors import ConfigError, FollowingError, MotionError, So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.modes import HELD
from so101_motion.common.realtime import LOOK_FOR_SIGNALS
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_rad
from so101_motion.files.saved_poses import SavedPoses
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.timing.limits import MotionLimits

if TYPE_CHECKING:
    from so101_motion.arm.motion_handle import Motion
    from so101_motion.common.encoder_zeros import EncoderZeros
    from so101_motion.planning.request import Plan
    from so101_motion.rig.protocols import RigLike  # it plans; an arm's attributes need not

ENDS = ("hold", "release", "home", "park")
"""How an arm may be left. ``park``: at the pose of that name if one is saved, else at ``rest``."""

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
LONGEST = 60.0  # how long the way may take, unless less is asked for [s]; chosen

Waiter = Callable[["Future[None]", float], None]  # waits at most so long [s]; raises the error


class AtEnd:
    """A rig's ``at_end``; ``ConfigError`` for what is not one of ``ENDS``."""

    def __get__(self, rig: object, _kind: object = None) -> str:
        return str(getattr(rig, "_at_end", "hold"))

    def __set__(self, rig: Any, how: str) -> None:
        rig._at_end = _checked_end(how)


def _checked_end(how: str) -> str:
    if how not in ENDS:
        raise ConfigError("at_end", how, f"must be one of {', '.join(ENDS)}")
    return how


def leave_as_asked(rig: RigLike) -> None:
    """Carry out ``at_end``, once; after an error, and if there is no way, the arm holds."""
    how, rig.at_end = rig.at_end, "hold"
    error = sys.exc_info()[1]
    if how == "hold":
        return
    try:
        if not isinstance(error, KeyboardInterrupt | None):
            raise MotionError("something went wrong before, or it was stopped")
        leave(rig, how, rig.connection.encoder_zeros)
    except (So101Error, KeyboardInterrupt) as failed:
        why = "it was stopped" if isinstance(failed, KeyboardInterrupt) else str(failed)
        rig.on_left(f"{how} at the end: {why}; the arm holds")


def wait_in_real_time(future: Future[None], seconds: float) -> None:
    """Wait until ``future`` is done; ``MotionError`` if it is not in time. Signals are handled.

    A further Ctrl-C raises ``KeyboardInterrupt`` here, also where others are held back.
    """
    end, heard = time.monotonic() + seconds, interrupts.heard()
    while not future.done():
        interrupts.prolong()
        left = end - time.monotonic()
        if left <= 0.0:
            raise MotionError(f"the arm's motion did not end within {seconds:g} s")
        if interrupts.heard() > heard:
            raise KeyboardInterrupt
        wait((future,), min(left, LOOK_FOR_SIGNALS))
    future.result()


def leave(
    rig: RigLike,
    how: str,
    zeros: EncoderZeros | None,
    *,
    within: float = LONGEST,
    waiter: Waiter = wait_in_real_time,
) -> None:
    """Leave the arm as one of ``ENDS`` says; returns when it is there.

    Args:
        rig: The arm with its gripper; what is under way comes to rest first.
        how: One of ``ENDS``.
        zeros: The arm's, to which a saved pose is converted.
        within: How long the way may take [s]; an arm with a longer one holds.
        waiter: How to wait.

    Raises:
        ConfigError: ``how`` is none of them.
        So101Error: It holds where it is, and why: there is no plan, the way takes too long, a stop
            was asked for.
    """
    arm = rig.arm
    if _checked_end(how) == "release":
        arm.set_torque(False)
    elif how != "hold" and arm.state.mode in HELD:
        poses = SavedPoses(zeros=lambda: zeros)
        own = any(pose.name == "park" for pose in poses.own())
        q = poses.find("home" if how == "home" else "park" if own else "rest").q
        _go(rig, q, within, waiter)
        if how == "park":
            release_where_it_lies(rig, (q,), waiter)


def _go(rig: RigLike, q: Array, within: float, waiter: Waiter) -> None:
    arm = rig.arm

    def planned(motion: Motion) -> Plan:
        plan = motion.wait_for(arm.start_plan(JointGoal(q=q), search=arm.search_among_known()))
        if plan.duration > within:
            raise MotionError(
                f"the way takes {plan.duration:.1f} s, {within:.1f} s are allowed; raise the caps"
            )
        return plan

    wait_for(arm.start_series((planned,)), REST_WITHIN + within, waiter)


def wait_for(motion: Motion, within: float, waiter: Waiter) -> None:
    """Wait for a motion's end; what interrupts the wait stops the arm."""
    try:
        waiter(motion.future, within)
    except BaseException:
        motion.interrupt("stop")  # nothing if it is over
        with suppress(So101Error, TimeoutError):
            waiter(motion.future, REST_WITHIN)
        raise


def release_where_it_lies(rig: RigLike, poses: tuple[Array, ...], waiter: Waiter) -> bool:
    """Lower and release the arm if it is at one of ``poses``, each (5,), [rad]; says whether.

    It is lowered slowly in the direction of its weight until it lies on something: in the pose
    ``rest`` there are some millimetres left under the forearm.
    """
    arm = rig.arm
    q = arm.state.q
    if not any(float(np.max(np.abs(q - pose))) <= LIES_WITHIN for pose in poses):
        return False
    for i in range(len(ARM_JOINTS)):
        torque = float(arm.model.gravity_torque(np.append(arm.state.q_ref, rig.gripper.q_jaw))[i])
        if abs(torque) < BEARS:
            continue
        lying = arm.state.q_ref.copy()
        lying[i] -= np.sign(torque) * LOWERED_BY
        lying = np.clip(lying, *arm.range)
        with suppress(FollowingError):  # the arm lies on something
            motion = arm.retarget(lying, limits=LOWERING, guard=None)
            wait_for(motion, REST_WITHIN, waiter)
    arm.set_torque(False)
    return True
