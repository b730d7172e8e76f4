"""Word the errors of motions: joints that would jump, do not follow, or do not come to rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from so101_motion.common.errors import FollowingError, MotionError
from so101_motion.common.geometry import Array
from so101_motion.common.state import JointState
from so101_motion.common.units import to_deg
from so101_motion.control.joint_group import Tolerances

JUMP = 1e-4
"""How far the first setpoint of a motion may be from the reference [rad], and how much faster
[rad/s]. Chosen: a fifteenth of what the servo resolves, far above rounding."""

Recent = tuple[JointState, ...]
"""The states of the last second."""


def refuse_jump(joints: Sequence[str], jump: Array, unit: str) -> None:
    """Refuse a motion whose first setpoint is not where the joints are.

    Args:
        joints: Their names.
        jump: How far it is from there, shape (n,), [rad] or [rad/s].
        unit: ``"deg"`` or ``"deg/s"``.

    Raises:
        MotionError: It is too far.
    """
    i = int(np.argmax(np.abs(jump)))
    if abs(jump[i]) > JUMP:
        raise MotionError(
            f"{joints[i]} would jump by {to_deg(float(jump[i])):.3g} {unit}:"
            " this motion does not begin where the arm is; plan again from there"
        )


def left_behind(
    joint: str, channel: str, off: float, words: tuple[str, str], recent: Recent
) -> FollowingError:
    """A joint is ``off`` [rad] from its setpoints; ``words`` say why, and what to check."""
    happened, check = words
    return FollowingError(
        f"{joint} {happened} {to_deg(off):.1f} deg from where it should be; the {channel} stopped"
        f" and holds. Check {check}, then move again",
        joint=joint,
        error=off,
        recent=recent,
    )


def barred(joint: str, off: float, recent: Recent) -> FollowingError:
    """A joint that a motion was to bring into its range is ``off`` [rad] outside."""
    return FollowingError(
        f"{joint} was outside its calibrated range and did not come in: {to_deg(off):.1f} deg"
        " are missing; check what blocks it, or move it inside by hand",
        joint=joint,
        error=off,
        recent=recent,
    )


def unsettled(
    joint: str, off: float, speed: float, tolerances: Tolerances, recent: Recent
) -> FollowingError:
    """A joint is ``off`` [rad] from its goal, or moves at ``speed`` [rad/s], for too long."""
    return FollowingError(
        f"{joint} did not settle: after {tolerances.settle_timeout:g} s it is {to_deg(off):.2f} deg"
        f" from its goal ({to_deg(tolerances.settle_position):.2g} deg allowed) and moves at"
        f" {to_deg(speed):.1f} deg/s. Check that nothing touches the arm and that its load is"
        " not too heavy, then move again",
        joint=joint,
        error=off,
        recent=recent,
    )
