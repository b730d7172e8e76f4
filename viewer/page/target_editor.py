"""The target of the Move tab, the commands that change it, and undo."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from dataclasses import replace
from itertools import product

import numpy as np

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.common.state import JointState
from so101_motion.common.units import to_mm, to_rad
from so101_motion.planning.goals import PoseGoal

from .history import History
from .target_ik import FRAMES, Direction, Target, TargetSolver

ABOVE = 0.02
"""How far above a surface that is clicked the target is [m]; chosen: the jaws stay clear of it."""

FROM_ABOVE = (to_rad(-90.0), to_rad(-70.0), to_rad(-50.0))
"""How the gripper may come from above [rad], the best first; chosen: further out it must lean."""

AROUND = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.10, 0.12)
"""How far from a target in contact a free one is looked for [m]; chosen: half a second at most."""

_CUBE = np.array(sorted(product((-1.0, 0.0, 1.0), repeat=3), key=lambda p: -p[2]))
_WAYS = _CUBE[np.any(_CUBE != 0.0, axis=1)]
_WAYS /= np.linalg.norm(_WAYS, axis=1, keepdims=True)
"""Directions in which it is looked for, shape (26, 3); up comes first."""

ANY, TILT, TURN = "any", "tilt", "tilt and roll"
DIRECTIONS = (ANY, TILT, TURN)  # how much of the gripper's direction is chosen with a target


class TargetEditor(ABC):
    """The target, and the commands that change it, as the arm was last seen."""

    def __init__(self, solver: TargetSolver, state: JointState, now: Callable[[], float]) -> None:
        self._solver, self.state = solver, state
        self.target = solver.first_target(state.q_ref, q_jaw=state.q_jaw_ref)
        self.kind = ANY
        self.history = History((self.target, self.kind), self._restore, now)

    @abstractmethod
    def _aim(self, target: Target) -> None:
        """Take ``target`` as the target; a plan to another one is dropped."""

    def set_target_point(self, p_base: Array) -> None:
        """Set a new target point, shape (3,), [m]."""
        wanted = None if self.kind == ANY else self._kept(self.direction)
        self._take(self._at_point(p_base, self.target.frame, wanted), "point")

    def set_target_joints(self, q: Array) -> None:
        """Set joint angles as the target, shape (5,), [rad]."""
        self._take(self._at_joints(q, self.target.frame))

    def set_target_joint(self, i: int, angle: float) -> None:
        """Turn one joint of the ghost to ``angle`` [rad]; the others stay."""
        q = np.array(self.target.q)
        q[i] = angle
        self._take(self._at_joints(q, self.target.frame), ("joint", i))

    def set_target_above(self, p_base: Array) -> None:
        """Set a target point above one of a surface, shape (3,), [m]; the gripper stops short.

        It comes from above if it can; a direction that is kept stays.
        """
        p_above, frame = p_base + np.array([0.0, 0.0, ABOVE]), self.target.frame
        if self.kind != ANY:
            self.set_target_point(p_above)
            return
        targets = (self._at_point(p_above, frame, Direction(tilt=tilt)) for tilt in FROM_ABOVE)
        down = next((target for target in targets if target.problem is None), None)
        self._take(self._at_point(p_above, frame, None) if down is None else down)

    def take_nearest(self) -> None:
        """Set the nearest place that is reached without contact; ``ConfigError`` without one."""
        if self.target.problem is None:
            return
        near = self._nearest() or self._beside()
        if near is None:
            far = f"within {to_mm(AROUND[-1]):.0f} mm of it"
            raise ConfigError("target", None, f"no place {far} can be reached; choose another one")
        self._take(near)

    def set_target_here(self) -> None:
        self.set_target_joints(self.state.q_ref)

    def set_target_frame(self, frame: str) -> None:
        """Set the frame that targets are for, one of ``FRAMES``; the ghost stays where it is."""
        if frame not in FRAMES:
            raise ConfigError("frame", frame, f"must be one of {', '.join(FRAMES)}")
        self._take(self._at_joints(self.target.q, frame))

    # Where the gripper points

    def set_direction(self, kind: str) -> None:
        """Choose how much of the gripper's direction is kept, one of ``DIRECTIONS``."""
        if kind not in DIRECTIONS:
            raise ConfigError("direction", kind, f"must be one of {', '.join(DIRECTIONS)}")
        self.kind = kind
        self.set_target_point(self.target.p_base)

    def set_tilt(self, tilt: float) -> None:
        """Set how far up the gripper points [rad], -pi/2 for straight down."""
        self.kind = TILT if self.kind == ANY else self.kind
        self._turn(replace(self.direction, tilt=tilt))

    def set_roll(self, roll: float) -> None:
        """Set how far the gripper is turned about its direction [rad]."""
        self.kind = TURN
        self._turn(replace(self.direction, roll=roll))

    def set_turn(self, R_base_target: Array) -> None:
        """Set the gripper's direction, as far as it is chosen, from a rotation, shape (3, 3)."""
        tilt = float(np.arcsin(np.clip(R_base_target[2, 2], -1.0, 1.0)))
        R_level = self._solver.turned(
            Direction(tilt=tilt, roll=0.0), float(self.target.q[0]), self.target.frame
        )
        R_roll = R_level.T @ R_base_target
        self._turn(Direction(tilt=tilt, roll=float(np.arctan2(R_roll[0, 1], R_roll[0, 0]))))

    @property
    def direction(self) -> Direction:
        wanted, there = self.target.direction, self._solver.direction(self.target.q)
        if wanted is None:
            return there
        return wanted if wanted.roll is not None else replace(wanted, roll=there.roll)

    @property
    def R_base_target(self) -> Array:
        """How the target is turned, shape (3, 3)."""
        return self._solver.turned(self.direction, float(self.target.q[0]), self.target.frame)

    # Helpers

    def _nearest(self) -> Target | None:
        near = self._at_joints(self.target.q, self.target.frame)
        return near if near.problem is None else None

    def _beside(self) -> Target | None:
        target = self.target
        points = (target.p_base + away * way for away in AROUND for way in _WAYS)
        found = (self._at_point(p, target.frame, target.direction) for p in points)
        return next((each for each in found if each.problem is None), None)

    def _kept(self, direction: Direction) -> Direction:
        return direction if self.kind == TURN else replace(direction, roll=None)

    def _turn(self, direction: Direction) -> None:
        if self.kind != ANY:
            target, wanted = self.target, self._kept(direction)
            self._take(self._at_point(target.p_base, target.frame, wanted), "turn")

    def _at_point(self, p_base: Array, frame: str, direction: Direction | None) -> Target:
        state = self.state
        return self._solver.at_point(
            p_base, frame, q_seed=state.q_ref, q_jaw=state.q_jaw_ref, direction=direction
        )

    def _at_joints(self, q: Array, frame: str) -> Target:
        return self._solver.at_joints(q, frame, q_jaw=self.state.q_jaw_ref)

    def _again(self, target: Target) -> Target:
        if isinstance(target.goal, PoseGoal):
            return self._at_point(target.p_base, target.frame, target.direction)
        return self._at_joints(target.q, target.frame)

    def _restore(self, before: tuple[Target, str], _words: str) -> None:
        target, self.kind = before
        self._aim(self._again(target))

    def _take(self, target: Target, kind: Hashable = None) -> None:
        self.history.add((target, self.kind), kind)
        self._aim(target)
