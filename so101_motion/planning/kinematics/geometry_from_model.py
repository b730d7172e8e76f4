"""Measure the arm's dimensions on the kinematic model; refuse a model of another structure.

The closed forms contain no lengths: axes and origins are taken from the model at zero, and then
formulas and model are compared at random joint angles. If they differ, the model has another
structure than the formulas (another wrist, a tilted base) and is refused.
"""

from __future__ import annotations

from math import atan2, hypot, pi

import numpy as np

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array, rot_z, rotation_angle, rotation_by
from so101_motion.planning.kinematics.arm_geometry import (
    ArmStructure,
    Bars,
    FrameOffset,
    Measures,
    to_joints,
)
from so101_motion.planning.kinematics.batch_ik import hands
from so101_motion.planning.kinematics.batch_kinematics import JOINT_LINKS
from so101_motion.planning.kinematics.model import RobotModel

FIT_POSITION = 2e-5  # formulas against model [m]; rounded URDF angles cost 5 um
FIT_ANGLE = 1e-4  # largest difference in the tool's rotation [rad]. Chosen, as above
_TRIALS = 16


def measure_structure(model: RobotModel) -> ArmStructure:
    """Measure the structure of a model's arm."""
    structure = _structure(model)
    if structure is None or not _fits(structure, model):
        reason = (
            "describes an arm that is not built like the SO-101: a vertical pan, three parallel"
            " joints, and a roll along which the tool points"
        )
        raise ConfigError("urdf", None, reason)
    return structure


def _structure(model: RobotModel) -> ArmStructure | None:
    if np.any(model.lower < -pi) or np.any(model.upper > pi):
        return None
    zero = np.zeros(5)
    axes = model.frame_jacobian(zero)[3:]
    pan_axis, left, roll_axis = axes[:, 0], axes[:, 1], axes[:, 4]
    up, approach = np.array([0.0, 0.0, 1.0]), model.frame(zero).R[:, 2]
    crossings = [
        np.cross(pan_axis, up),  # the pan axis is vertical,
        left @ up,  # the lift axis horizontal,
        left @ roll_axis,  # the roll axis across it,
        np.cross(roll_axis, approach),  # and the tool points along the roll axis
    ]
    if max(np.linalg.norm(each) for each in crossings) > FIT_ANGLE:
        return None
    return ArmStructure(_measure(model, axes))


def _measure(model: RobotModel, axes: Array) -> Measures:
    zero = np.zeros(5)
    left, roll_axis = axes[:, 1], axes[:, 4]
    plane = np.array([np.cross(left, [0.0, 0.0, 1.0]), left, [0.0, 0.0, 1.0]])
    origins = np.array([model.frame(zero, name).p for name in JOINT_LINKS])
    pan, shoulder, elbow, wrist, roll = origins @ plane.T
    reference = np.array([wrist[0], pan[1], wrist[2]])
    R_base_tool = model.frame(zero).R
    approach = plane @ R_base_tool[:, 2]
    upper_arm, forearm = elbow - shoulder, wrist - elbow
    lower, upper = to_joints(model.lower), to_joints(model.upper)
    return Measures(
        pan=(float(origins[0, 0]), float(origins[0, 1])),
        pan_sign=1.0 if axes[2, 0] > 0.0 else -1.0,
        azimuth=atan2(plane[0, 1], plane[0, 0]),
        shoulder=(float(shoulder[0] - pan[0]), float(shoulder[2])),
        bars=Bars(
            upper_arm=hypot(upper_arm[0], upper_arm[2]),
            upper_arm_elevation=atan2(upper_arm[2], upper_arm[0]),
            forearm=hypot(forearm[0], forearm[2]),
            forearm_elevation=atan2(forearm[2], forearm[0]),
            lower=lower[1:4],
            upper=upper[1:4],
        ),
        offsets={
            name: _offset(
                plane @ model.frame(zero, name).p - roll, roll - reference, plane @ roll_axis
            )
            for name in model.gripper_frames
        },
        approach_elevation=atan2(approach[2], approach[0]),
        R_base_tool=R_base_tool,
        R_base_axes=np.column_stack([roll_axis, left, np.cross(roll_axis, left)]),
        lower=lower,
        upper=upper,
    )


def _offset(from_roll: Array, roll_from_wrist: Array, roll_axis: Array) -> FrameOffset:
    """Rodrigues' formula for a point that turns about the roll axis, row by row."""
    along = roll_axis * (roll_axis @ from_roll)
    rows = np.column_stack(
        [along + roll_from_wrist, from_roll - along, np.cross(roll_axis, from_roll)]
    )
    forward, left, up = ((float(a), float(b), float(c)) for a, b, c in rows)
    return FrameOffset(forward, left, up)


def _fits(structure: ArmStructure, model: RobotModel) -> bool:
    bars = structure.bars
    folds = [abs(bars.straight - limit) for limit in (model.lower[2], model.upper[2])]
    if max(folds) > pi:
        return False
    rng = np.random.default_rng(0)
    for q in rng.uniform(model.lower, model.upper, (_TRIALS, 5)):
        R = rotation(structure.measures, q)
        if rotation_angle(R.T @ model.frame(q).R) > FIT_ANGLE:
            return False
        for name in structure.measures.offsets:
            off = position(structure, q, name) - model.frame(q, name).p
            if np.linalg.norm(off) > FIT_POSITION:
                return False
    return True


def position(structure: ArmStructure, q: Array, frame: str) -> Array:
    """Position of a frame by the structure, shape (3,), [m]; only to compare with the model."""
    m = structure.measures
    lateral, *hand = hands(structure, frame, q[4])
    lengths, elevations = zip(m.bars[:2], m.bars[2:4], hand, strict=True)
    elevation = np.array(elevations) - np.cumsum(q[1:4])
    x, z = lengths @ np.cos(elevation), lengths @ np.sin(elevation)
    turned = rot_z(m.azimuth + m.pan_sign * q[0]) @ [m.shoulder[0] + x, lateral, m.shoulder[1] + z]
    return np.asarray(np.array([m.pan[0], m.pan[1], 0.0]) + turned)


def rotation(m: Measures, q: Array) -> Array:
    """Rotation of the tool by the structure, shape (3, 3); only to compare with the model."""
    roll_axis, left, _ = m.R_base_axes.T
    return (
        rot_z(m.pan_sign * q[0])
        @ rotation_by(left * (q[1] + q[2] + q[3]))
        @ rotation_by(roll_axis * q[4])
        @ m.R_base_tool
    )
