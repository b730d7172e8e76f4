"""Solve inverse kinematics in closed form for many poses at once.

The formulas are those of ``native/arm_ik.c`` and ``native/planar.c``, on arrays. A search along a
tool path tries thousands of configurations, most of which do not exist or break a limit, and needs
to know how far each is from being allowed. So none is left out here; each has its ``excess``.

Shapes. The axes of configurations are: points (n), sides front and back (2), values that the caller
varies, mostly the pitch (m), and elbow up or down (2). Roll and pitch broadcast to (n, 2, m).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.kinematics.arm_geometry import TAU, ArmStructure

_ROUNDS = 6  # iterations in which pan and roll are made to agree; each gains a digit or two
_ROUNDING = 1e-9  # how far a cosine may be beyond 1


class Hands(NamedTuple):
    """A frame of the gripper at given rolls, shapes as the rolls'."""

    lateral: Array  # distance from the plane through the pan axis, to the left [m]
    length: Array  # wrist to the frame's origin, within the plane [m]
    elevation: Array  # elevation of that vector at pitch zero [rad]


class Facing(NamedTuple):
    """The arm's plane turned to points, from the front and from the back; shapes (n, 2, m)."""

    pan: Array  # the pan joint's angle, within half a turn of zero [rad]
    x: Array  # the point within the plane, forward of the shoulder [m]
    z: Array  # the same, up from the shoulder, shape (n, 1, 1), [m]
    # how much closer the point is to the pan axis than the frame can come [m]; mostly 0
    beside: Array


class ConfigurationGrid(NamedTuple):
    """Configurations, allowed or not."""

    q: Array  # joint angles, shape (n, 2, m, 2, 5), [rad]
    # largest distance of a joint beyond its limits, shape (n, 2, m, 2), [rad]; negative inside,
    # infinite where the point is out of reach with that pitch
    excess: Array


def wrap(angle: Array) -> Array:
    """Wrap angles of any shape to within half a turn of zero [rad]."""
    return angle - TAU * np.round(angle / TAU)


def hands(structure: ArmStructure, frame: str, roll: Array) -> Hands:
    """A frame of the gripper at given rolls, any shape, [rad]."""
    c, s = np.cos(roll), np.sin(roll)
    forward, left, up = (
        constant + of_cos * c + of_sin * s
        for constant, of_cos, of_sin in structure.measures.offsets[frame]
    )
    return Hands(left, np.hypot(forward, up), np.arctan2(up, forward))


def facing(structure: ArmStructure, p_base: Array, lateral: Array) -> Facing:
    """Turn the arm's plane to points ``p_base`` (n, 3) [m] that are ``lateral`` [m] beside it."""
    m = structure.measures
    x, y, z = (p_base - np.array([*m.pan, m.shoulder[1]])).T[:, :, None, None]
    square = x * x + y * y - lateral * lateral
    along = np.sqrt(np.maximum(square, 0.0)) * np.array([[1.0], [-1.0]])
    pan = m.pan_sign * wrap(np.arctan2(y, x) - m.azimuth - np.arctan2(lateral, along))
    beside = np.maximum(np.abs(lateral) - np.hypot(x, y), 0.0) + 0.0 * along
    return Facing(pan, along - m.shoulder[0], z, beside)


def straight_pitches(structure: ArmStructure, target: Facing, hand: Hands) -> Array:
    """The two pitches at which upper arm and forearm are in line, shape (n, 2, 2), [rad].

    There the elbow changes from up to down; NaN where the arm never gets straight. ``target`` is
    for one roll, shapes (n, 2, 1).
    """
    measures = structure.bars
    distance = np.hypot(target.x, target.z)
    reach = measures.upper_arm + measures.forearm
    cosine = (distance**2 + hand.length**2 - reach**2) / (2.0 * distance * hand.length)
    with np.errstate(invalid="ignore"):
        turned = np.arccos(cosine)
    aligned = hand.elevation - np.arctan2(target.z, target.x)
    return np.concatenate([aligned - turned, aligned + turned], axis=2)


def configurations(
    structure: ArmStructure, target: Facing, hand: Hands, pitch: Array, roll: Array
) -> ConfigurationGrid:
    """All configurations with pitches and rolls that broadcast to (n, 2, m) [rad]."""
    bars = structure.bars
    a, elevation_a, b, _ = bars[:4]
    elevation = hand.elevation - pitch
    wrist_x = target.x - hand.length * np.cos(elevation)
    wrist_z = target.z - hand.length * np.sin(elevation)
    cosine = (wrist_x * wrist_x + wrist_z * wrist_z - a * a - b * b) / (2.0 * a * b)
    bent = np.clip(cosine, -1.0, 1.0)
    fold = np.arccos(bent)
    lean = np.arctan2(b * np.sin(fold), a + b * bent)
    bearing = elevation_a - np.arctan2(wrist_z, wrist_x)
    up_down = np.array([1.0, -1.0])
    q = np.empty((*cosine.shape, 2, 5))
    q[..., 0] = target.pan[..., None]
    q[..., 2] = bars.straight + fold[..., None] * up_down
    q[..., 1] = wrap(bearing[..., None] - lean[..., None] * up_down)
    q[..., 3] = wrap(np.broadcast_to(pitch, cosine.shape)[..., None] - q[..., 1] - q[..., 2])
    q[..., 4] = np.broadcast_to(roll, cosine.shape)[..., None]
    m = structure.measures
    excess = np.maximum(np.array(m.lower) - q, q - np.array(m.upper)).max(axis=-1)
    exists = (np.abs(cosine) <= 1.0 + _ROUNDING) & (target.beside == 0.0)
    return ConfigurationGrid(q, np.where(exists[..., None], excess, np.inf))


def configurations_at(
    structure: ArmStructure,
    frame: str,
    p_base: Array,
    roll: Array,
    pitch: Array | Callable[[Array], Array],
) -> ConfigurationGrid:
    """All configurations with a frame at points (n, 3) [m]; ``pitch`` may be a function of pans."""
    hand = hands(structure, frame, roll)
    target = facing(structure, p_base, hand.lateral)
    pitches = pitch(target.pan) if callable(pitch) else pitch
    return configurations(structure, target, hand, pitches, roll)


def pitch_towards(structure: ArmStructure, pan: Array, axis: Array) -> Array:
    """The pitch, shape as ``pan``, [rad], that brings the approach nearest to ``axis`` (n, 3)."""
    m = structure.measures
    azimuth = m.azimuth + m.pan_sign * pan
    x, y, z = axis.T[:, :, None, None]
    return np.asarray(
        m.approach_elevation - np.arctan2(z, x * np.cos(azimuth) + y * np.sin(azimuth))
    )


def roll_for(structure: ArmStructure, pan: Array, pitch: Array, R_base_tool: Array) -> Array:
    """The roll (n, 2, m) [rad] that turns the tool nearest to rotations (n, 3, 3).

    In axes along the roll axis (x) and the lift axis (y) the roll should make a rotation N, but can
    only turn about x; the nearest angle has ``tan = (N_zy - N_yz) / (N_yy + N_zz)``.
    """
    m = structure.measures
    pan, pitch = np.broadcast_arrays(m.pan_sign * pan, pitch)
    wanted = R_base_tool @ (m.R_base_tool.T @ m.R_base_axes)
    N = _about(1, -pitch) @ (m.R_base_axes.T @ (_about(2, -pan) @ wanted[:, None, None]))
    roll = np.arctan2(N[..., 2, 1] - N[..., 1, 2], N[..., 1, 1] + N[..., 2, 2])
    middle = 0.5 * (m.lower[4] + m.upper[4])
    return middle + wrap(roll - middle)


def facing_turned(
    structure: ArmStructure, frame: str, p_base: Array, R_base_tool: Array, roll: float
) -> tuple[Facing, Array]:
    """The arm's plane turned to points (n, 3) [m], and the pitches that bring the approach nearest.

    Pan, pitch and roll agree, both results are (n, 2, 1): the roll moves a frame beside the roll
    axis, that changes the pan, and that changes the roll. The iteration converges quickly, unless a
    point is as near to the pan axis as the frame is to the roll axis; then the result is some
    configuration.
    """
    rolls = np.full((len(p_base), 2, 1), roll)
    for _ in range(_ROUNDS):
        target = facing(structure, p_base, hands(structure, frame, rolls).lateral)
        pitch = pitch_towards(structure, target.pan, R_base_tool[:, :, 2])
        rolls = roll_for(structure, target.pan, pitch, R_base_tool)
    return target, pitch


def _about(axis: int, angle: Array) -> Array:
    """Rotations (..., 3, 3) about a coordinate axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.zeros((*angle.shape, 3, 3))
    R[..., axis, axis] = 1.0
    R[..., i, i] = R[..., j, j] = np.cos(angle)
    R[..., j, i] = np.sin(angle)
    R[..., i, j] = -R[..., j, i]
    return R


def angles_between(a: Array, b: Array) -> Array:
    """Angles between unit vectors (..., 3), shape (...), [rad]; accurate near zero."""
    return np.asarray(2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(a - b, axis=-1), 0.0, 1.0)))


def rotation_angles(R: Array) -> Array:
    """Angles of rotations (..., 3, 3), shape (...), [rad]; accurate near zero."""
    half_sine = np.linalg.norm(R - np.eye(3), axis=(-2, -1)) / np.sqrt(8.0)
    return np.asarray(2.0 * np.arcsin(np.clip(half_sine, 0.0, 1.0)))
