"""Check prescribed waypoints, and leave out repeated ones and those on a straight line.

A prescribed path is followed or refused, never replaced by another; so the error names the
waypoint, or the two waypoints between which the path is blocked. Waypoints are counted from 1,
without the start.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from so101_motion.common.errors import ConfigError, OutsideLimits
from so101_motion.common.geometry import Array
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.motion_builder import SAME, MotionBuilder

_ONE = 2.0 * math.pi / 4096.0
"""Waypoints no farther apart than this are one [rad]: a tick of the servo's encoder."""

_TURN = 1e-6  # a waypoint at which the direction changes less than this is on a line


def checked_path(model: RobotModel, moves: MotionBuilder, q_from: Array, waypoints: Array) -> Array:
    """The collision-free polyline (m, 5) [rad] from a start through waypoints, simplified.

    Args:
        moves: Checks configurations and lines for contact.
        q_from: A free configuration inside the limits, shape (5,), [rad].
        waypoints: Shape (n, 5), n >= 1, [rad].

    Raises:
        OutsideLimits: A waypoint is outside the joint limits; the message says which.
        InCollision: A waypoint, or the path to it, is in contact; the message says which.
        ConfigError: There is no waypoint.
    """
    if len(waypoints) == 0:
        raise ConfigError("waypoints", [], "a path needs at least one waypoint")
    for number, q in enumerate(waypoints, 1):
        _check(model, moves, q, f"waypoint {number} of {len(waypoints)}")
    drawn_in = np.clip(waypoints, model.lower, model.upper)
    corners = np.concatenate([q_from[None], drawn_in])
    for number, leg in enumerate(pairwise(corners)):
        blocked = moves.collision.first_blocked(np.array(leg), moves.q_jaw)
        if blocked is not None:
            begin = f"waypoint {number}" if number else "the start"
            when = f"between {begin} and waypoint {number + 1}"
            raise moves.in_collision(blocked, "path", when)
    return simplified(corners)


def _check(model: RobotModel, moves: MotionBuilder, q: Array, name: str) -> None:
    try:
        model.check_limits(q)
    except OutsideLimits as error:
        raise OutsideLimits(
            f"{name}: {error}",
            joint=error.joint,
            value=error.value,
            lower=error.lower,
            upper=error.upper,
        ) from None
    if not moves.collision.is_free(q, moves.q_jaw):
        raise moves.in_collision(q, "path", f"at {name}")


def simplified(waypoints: Array) -> Array:
    """A polyline without (nearly) repeated waypoints and those on a straight line.

    Args:
        waypoints: Shape (m, n), m >= 2, [rad].

    Returns:
        At least two of them, first and last included; equal if all are.
    """
    kept = [waypoints[0]]
    for q in waypoints[1:-1]:
        if np.abs(q - kept[-1]).max() > _ONE:
            kept.append(q)
    if len(kept) > 1 and np.abs(waypoints[-1] - kept[-1]).max() <= _ONE:
        kept.pop()
    points = np.array([*kept, waypoints[-1]])
    steps = np.diff(points, axis=0)
    steps /= np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), SAME)
    turns = np.abs(np.diff(steps, axis=0)).max(axis=1, initial=0.0)
    return np.asarray(points[np.concatenate([[True], turns > _TURN, [True]])])
