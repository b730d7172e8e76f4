"""Estimate joint angles for display while the arm is uncalibrated.

Before homing, the former calibration is used, if there was one. After homing, the joints are taken
to have been in the requested pose at that moment. A joint that has reached both stops is known
exactly. All others are guesses and marked as such.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from so101_motion.calib.procedure.steps import State
from so101_motion.calib.procedure.travel import MIDDLE
from so101_motion.calib.procedure.travel_assessment import ROLL, Verdict
from so101_motion.calib.procedure.view import JointView
from so101_motion.calib.record.record import JOINTS
from so101_motion.calib.record.zero import ROLL_UPRIGHT, STOPS
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.drivers.bus.registers import TICKS_PER_TURN
from so101_motion.drivers.bus.ticks import RAD_PER_TICK

HOMING_POSE: Mapping[str, float] = {
    **dict.fromkeys(ARM_JOINTS, 0.0),
    ROLL: ROLL_UPRIGHT,
    GRIPPER_JOINT: sum(STOPS[GRIPPER_JOINT]) / 2.0,
}
"""The model's angles in the homing pose [rad]: about the middle of each travel."""

_FACTORY = (0, 0, TICKS_PER_TURN - 1)  # offset and limits of a servo nobody has calibrated
_HOMED = (State.HOMED, State.RECORDING, State.COMPLETED)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseEstimate:
    """Estimated joint angles, and which of them are guesses.

    Attributes:
        angles: Every joint's angle [rad]; a joint that was never read has its homing angle.
    """

    angles: Mapping[str, float]
    guessed: frozenset[str]  # joints whose angle is a guess

    @property
    def q(self) -> Array:
        return np.array([self.angles[joint] for joint in ARM_JOINTS])

    @property
    def q_jaw(self) -> float:
        return self.angles[GRIPPER_JOINT]


def estimate_pose(
    state: State, joints: Mapping[str, JointView], former: Mapping[str, float]
) -> PoseEstimate:
    """Estimate the joint angles; ``former`` are those before homing [rad]."""
    angles, guessed = dict(HOMING_POSE), set(JOINTS)
    for joint, view in joints.items():
        if view.ticks is None:
            continue
        if state in _HOMED:
            angles[joint], is_guess = _since_homing(view, view.ticks)
        elif joint in former and _is_calibrated(view):
            angles[joint], is_guess = former[joint], False
        else:
            angles[joint], is_guess = _from_pose(joint, view.ticks), True
        if not is_guess:
            guessed.discard(joint)
    return PoseEstimate(angles=angles, guessed=frozenset(guessed))


def _since_homing(view: JointView, ticks: int) -> tuple[float, bool]:
    """The angle of a homed joint, and whether it is a guess."""
    lower, upper = view.recorded_min, view.recorded_max
    if lower is not None and upper is not None and view.verdict is Verdict.COMPLETE:
        middle = sum(STOPS[view.joint]) / 2.0
        return middle + (ticks - (lower + upper) / 2.0) * RAD_PER_TICK, False
    return _from_pose(view.joint, ticks), view.joint != ROLL  # roll's zero is where it was homed


def _from_pose(joint: str, ticks: int) -> float:
    return HOMING_POSE[joint] + (ticks - MIDDLE) * RAD_PER_TICK


def _is_calibrated(view: JointView) -> bool:
    return (view.homing_offset, view.range_min, view.range_max) != _FACTORY
