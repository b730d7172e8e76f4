"""Read a machine's arm and gripper, and turn the readings into a snapshot.

Our own module reports mode, joints and faults in one answer; another module is asked for its joints
and whether it moves. A machine reports measured joint angles, not the references that plans start
from, and a joint at rest that trembles by a tick must not spoil a plan. So ``q_ref`` stays the same
while the resting joints are within ``AT_REST`` of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from grpclib import GRPCError
from viam.components.arm import Arm
from viam.components.gripper import Gripper

from so101_motion.arm.gripper import JAW_CLOSED, JAW_OPEN
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT, JointReading, JointState
from so101_motion.common.units import to_rad
from so101_motion.drivers.feetech.servo_judgement import LETS_GO
from so101_motion.viam.conversion import convert

AT_REST = to_rad(1.0)
"""How far a resting joint may be from its reference [rad]; chosen: gravity pulls a servo about this
far if nothing corrects it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmReport:
    """The measured joint angles [rad], mode and whole status that an arm reported."""

    q: Array
    mode: Mode
    status: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class GripperReport:
    """The state that a gripper reported; an aperture is 0 closed, 1 open."""

    aperture: float = 0.0
    is_moving: bool = False
    is_holding: bool = False


async def ask_arm(arm: Arm) -> ArmReport:
    try:
        status = await arm.get_status()
    except GRPCError:  # many modules have none
        status = {}
    answered = status.get("joint_positions_deg")
    if isinstance(answered, Mapping) and all(joint in answered for joint in ARM_JOINTS):
        values = [answered[joint] for joint in ARM_JOINTS]
        q = convert.from_joint_values(values, what="joint_positions_deg")
        return ArmReport(q=q, mode=_mode(status), status=status)
    positions = await arm.get_joint_positions()
    status = {**status, "is_moving": await arm.is_moving()}
    return ArmReport(
        q=convert.from_joint_values(positions.values), mode=_mode(status), status=status
    )


def _outside(status: Mapping[str, Any]) -> tuple[dict[str, float], dict[str, float]]:
    """Where joints outside their range are, and where each comes back inside, by name [rad].

    An aperture ends at 0 and 1, so a jaw that is outside is known from here only.
    """
    here: dict[str, float] = {}
    limits: dict[str, float] = {}
    told: Any = status.get("out_of_range")
    for joint in (*ARM_JOINTS, GRIPPER_JOINT):
        with suppress(KeyError, TypeError, ValueError):  # it is inside, or nothing is told
            at, limit = (to_rad(float(told[joint][key])) for key in ("at_deg", "limit_deg"))
            if np.isfinite([at, limit]).all():
                here[joint], limits[joint] = at, limit
    return here, limits


def _mode(status: Mapping[str, Any]) -> Mode:
    try:
        return Mode(status["state"])
    except (KeyError, ValueError):
        if status.get("is_moving"):
            return Mode.MOVING
        return Mode.GUIDING if status.get("mode") == "manual" else Mode.HOLDING


async def ask_gripper(
    gripper: Gripper | None, last: GripperReport = GripperReport()
) -> GripperReport:
    """Read the state of a gripper: at rest where it was last where it reports nothing."""
    if gripper is None:
        return GripperReport()
    try:
        answered = await gripper.do_command({"command": "get_position"})
        percent = answered.get("position_percentage")
        return GripperReport(
            aperture=0.01 * percent if isinstance(percent, (int, float)) else last.aperture,
            is_moving=await gripper.is_moving(),
            is_holding=answered.get("is_holding_something") is True,
        )
    except GRPCError:
        return GripperReport(aperture=last.aperture)


def next_state(last: JointState | None, arm: ArmReport, jaw: GripperReport, t: float) -> JointState:
    """Make the next snapshot from reports that were read at ``t``, on our clock [s]."""
    status = arm.status
    moving = bool(status.get("is_moving", arm.mode in (Mode.MOVING, Mode.STOPPING)))
    here, limits = _outside(status)
    q_jaw = here.get(GRIPPER_JOINT, JAW_CLOSED + jaw.aperture * (JAW_OPEN - JAW_CLOSED))
    # As in the arm's own controller, a motion begins where a joint that is outside comes in.
    inside = np.array([limits.get(j, q) for j, q in zip(ARM_JOINTS, arm.q.tolist(), strict=True)])
    qd, q_ref = np.zeros(5), inside
    if last is not None and moving and t > last.t:
        qd = (arm.q - last.q) / (t - last.t)
    if last is not None and not moving and not last.arm_moving:
        stays = np.max(np.abs(inside - last.q_ref)) <= AT_REST
        q_ref = last.q_ref if stays else inside
    alarms, fault, lent = (status.get(key) for key in ("alarms", "fault", "lent_to"))
    late = status.get("late_ticks", 0)
    health = status.get("health")
    figures = health.items() if isinstance(health, Mapping) else ()
    return JointState(
        t=t,
        mode=arm.mode,
        reading=JointReading(
            q=arm.q,
            qd=qd,
            q_jaw=q_jaw,
            qd_jaw=0.0,
            alarms={str(k): str(v) for k, v in alarms.items()} if isinstance(alarms, dict) else {},
            let_go=frozenset(
                joint
                for joint, each in figures
                if isinstance(each, Mapping) and isinstance(faults := each.get("faults"), list)
                if LETS_GO & {*map(str, faults)}
            ),
            out_of_range=limits,
            silent=frozenset(
                joint for joint, each in figures if isinstance(each, Mapping) and each.get("silent")
            ),
        ),
        q_ref=q_ref,
        qd_ref=qd,
        q_jaw_ref=limits.get(GRIPPER_JOINT, q_jaw),
        arm_moving=moving,
        jaw_moving=jaw.is_moving,
        late_ticks=round(late) if isinstance(late, (int, float)) else 0,
        fault=fault if isinstance(fault, str) and fault else None,
        lent_to=lent if isinstance(lent, str) and lent else None,
    )
