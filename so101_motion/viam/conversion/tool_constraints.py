"""Read Viam's path constraints, and check whether a plan's setpoints keep them.

A line constraint keeps the component on a straight line; a pseudolinear one allows a share of the
distance to either side. An orientation constraint limits how far the component may be turned from
the steady turn between start and goal.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from viam.proto.service.motion import Constraints

from so101_motion.common.attributes import checked_number
from so101_motion.common.errors import ConfigError, PlanningError
from so101_motion.common.geometry import SE3, Array, interpolated, rotation_angle
from so101_motion.common.units import to_deg, to_m, to_mm, to_rad

_LOOK_EVERY = 4  # every fourth setpoint is measured
_ROUNDING = 1e-4  # [m] and [rad] added to what is allowed: 0.1 mm, as for goals


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolConstraints:
    """The path constraints of one request; infinite where there is none."""

    line: float = math.inf  # how far it may leave the straight line [m]
    line_share: float = math.inf  # the same as a share of the distance
    turn: float = math.inf  # how far it may be turned from the steady turn from start to goal [rad]
    turn_share: float = math.inf  # the same as a share of that turn
    axis_only: bool = False  # turns about its own z axis are free
    wants_line: bool = False

    @classmethod
    def of(cls, constraints: Constraints | None, *, counts_turn: bool) -> ToolConstraints:
        """Read the constraints of a request; the tightest of each kind counts.

        A goal without an orientation (``counts_turn`` false) leaves it free on a line, too.
        """
        if constraints is None:
            return cls()
        line = turn = line_share = turn_share = math.inf
        for linear in constraints.linear_constraint:
            line = min(line, to_m(_positive("line_tolerance_mm", linear.line_tolerance_mm)))
            if counts_turn:
                asked = _positive("orientation_tolerance_degs", linear.orientation_tolerance_degs)
                turn = min(turn, to_rad(asked) or math.inf)
        for pseudo in constraints.pseudolinear_constraint:
            asked = _positive("line_tolerance_factor", pseudo.line_tolerance_factor)
            line_share = min(line_share, asked or math.inf)
            if counts_turn:
                asked = _positive(
                    "orientation_tolerance_factor", pseudo.orientation_tolerance_factor
                )
                turn_share = min(turn_share, asked or math.inf)
        free_turns = []
        for oriented in constraints.orientation_constraint:
            asked = _positive("orientation_tolerance_degs", oriented.orientation_tolerance_degs)
            if asked == 0.0:
                raise ConfigError(
                    "orientation_tolerance_degs", asked, "must be more than 0 deg; 5 is usual"
                )
            turn = min(turn, to_rad(asked))
            free_turns.append(oriented.ignore_theta)
        return cls(
            line=line,
            line_share=line_share,
            turn=turn,
            turn_share=turn_share,
            axis_only=bool(free_turns) and all(free_turns),
            wants_line=bool(constraints.linear_constraint),
        )

    @property
    def is_any(self) -> bool:
        return not all(
            math.isinf(most) for most in (self.line, self.line_share, self.turn, self.turn_share)
        )

    def check(self, q: Array, component: Callable[[Array], SE3]) -> None:
        """Refuse a motion with setpoints ``q``, shape (n, 5), [rad], that breaks a constraint."""
        if not self.is_any:
            return
        chosen = np.unique(np.append(np.arange(0, len(q), _LOOK_EVERY), len(q) - 1))
        poses = [component(q[k]) for k in chosen]
        start, goal = poses[0], poses[-1]
        self._check_line(poses, start, goal)
        self._check_turn(poses, start, goal)

    def _check_line(self, poses: list[SE3], start: SE3, goal: SE3) -> None:
        line = goal.p - start.p
        distance = float(np.linalg.norm(line))
        allowed = min(self.line, self.line_share * distance) if distance else self.line
        if math.isinf(allowed):
            return
        along = line / distance if distance else line
        for k, pose in enumerate(poses):
            offset = pose.p - start.p
            off = float(np.linalg.norm(offset - np.clip(offset @ along, 0.0, distance) * along))
            if off > allowed + _ROUNDING:
                raise _broken(
                    k / (len(poses) - 1),
                    f"{to_mm(off):.1f} mm off the straight line",
                    f"{to_mm(allowed):g} mm",
                )

    def _check_turn(self, poses: list[SE3], start: SE3, goal: SE3) -> None:
        whole = self._angle(start, goal)
        allowed = min(self.turn, self.turn_share * whole) if whole else self.turn
        if math.isinf(allowed):
            return
        distance = float(np.linalg.norm(goal.p - start.p))
        for k, pose in enumerate(poses):
            share = k / (len(poses) - 1)
            if distance:
                share = float(np.clip((pose.p - start.p) @ (goal.p - start.p) / distance**2, 0, 1))
            off = self._angle(interpolated(start, goal, share), pose)
            if off > allowed + _ROUNDING:
                raise _broken(
                    k / (len(poses) - 1),
                    f"turned {to_deg(off):.1f} deg from between start and goal",
                    f"{to_deg(allowed):g} deg",
                )

    def _angle(self, one: SE3, other: SE3) -> float:
        if self.axis_only:
            cosine = float(np.clip(one.R[:, 2] @ other.R[:, 2], -1.0, 1.0))
            return math.acos(cosine)
        return rotation_angle(one.R.T @ other.R)


def _broken(share: float, what: str, allowed: str) -> PlanningError:
    return PlanningError(
        f"no path found that keeps the constraints: {100 * share:.0f} % along, the component would"
        f" be {what}, {allowed} are allowed; loosen the constraint, or choose a nearer goal"
    )


def _positive(key: str, value: float) -> float:
    return checked_number(key, value, lower=0.0)
