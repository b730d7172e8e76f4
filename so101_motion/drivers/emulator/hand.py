"""Model a person's hand that moves joints by a script, and an object between the jaws.

A hand script is text, one waypoint a line: time [s], joint, angle [deg in the arm's frame] or
``release``. The hand takes a joint where it is at the joint's first waypoint, leads it in straight
lines from waypoint to waypoint, holds, and lets go at ``release``::

    # time  joint          angle
    1.0     shoulder_pan   start
    3.0     shoulder_pan   -40
    4.0     shoulder_pan   release

The hand is a spring with a limited torque: it can lead a limp joint, pulls in vain at one that
holds, and stops at a mechanical stop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from so101_motion.common.errors import ConfigError
from so101_motion.drivers.emulator.joint_figures import JOINTS

STRENGTH = 2.0
"""Largest torque of the hand [N m]; chosen: enough for any limp joint, not for a driven one."""

STIFFNESS = 25.0
"""Stiffness of the hand [N m/rad]; chosen."""

_DAMPING = 1.5  # [N m s/rad], chosen: about critical with a servo's inertia

OBJECT_STIFFNESS = 120.0
"""Stiffness of an object between the jaws [N m/rad at the jaw]; chosen: hard plastic."""

_GAP_MM = (
    (-11.5, 0.0), (-10.0, 1.9), (-5.0, 8.8), (0.0, 15.8), (5.0, 22.1), (10.0, 28.5),
    (20.0, 41.2), (30.0, 53.5), (45.0, 71.2),
)  # fmt: skip
"""Opening between the jaw tips by jaw angle [deg], measured on the official solids."""


def jaw_angle_for_gap(gap: float) -> float:
    """Jaw angle [rad] at which the tips are ``gap`` [m] apart; ``ConfigError`` if none."""
    gap_mm = gap * 1000.0
    for (angle, width), (next_angle, next_width) in pairwise(_GAP_MM):
        if width <= gap_mm <= next_width:
            share = (gap_mm - width) / (next_width - width)
            return math.radians(angle + share * (next_angle - angle))
    raise ConfigError("object", gap, f"must be 0 to {_GAP_MM[-1][1] / 1000.0} m wide")


@dataclass(frozen=True, slots=True, kw_only=True)
class Waypoint:
    """One line of a script: where to lead ``joint`` by ``t`` [s].

    ``q`` is None for "where it is" (``start``) [rad]; ``release`` is whether the hand lets go.
    """

    t: float
    joint: str
    q: float | None = None
    release: bool = False


def parse_script(text: str) -> tuple[Waypoint, ...]:
    waypoints = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            when, joint, what = words
            if joint not in JOINTS:
                raise ValueError
            q = None if what in ("start", "release") else math.radians(float(what))
            waypoints.append(Waypoint(t=float(when), joint=joint, q=q, release=what == "release"))
        except ValueError:
            reason = f"line {number} must be: seconds joint degrees|start|release"
            raise ConfigError("hand", line.strip(), reason) from None
    return tuple(sorted(waypoints, key=lambda waypoint: waypoint.t))


class Hand:
    """A hand of a largest torque [N m] that follows a script, sorted by time, from ``t`` on [s]."""

    def __init__(
        self, script: Sequence[Waypoint] = (), t: float = 0.0, *, strength: float = STRENGTH
    ) -> None:
        self._start, self._strength = t, strength
        self._ahead = {
            joint: [waypoint for waypoint in script if waypoint.joint == joint]
            for joint in dict.fromkeys(waypoint.joint for waypoint in script)
        }
        self._behind: dict[str, tuple[float, float]] = {}  # time and angle last passed, if held

    @property
    def busy(self) -> bool:
        """Whether it holds a joint or has waypoints left."""
        return any(self._ahead.values()) or bool(self._behind)

    def torque(self, joint: str, t: float, q: float, qd: float) -> float:
        """Torque on ``joint`` [N m] at ``q`` [rad], ``qd`` [rad/s]; ``t`` [s] never goes back."""
        if joint not in self._ahead:
            return 0.0
        now, ahead = t - self._start, self._ahead[joint]
        while ahead and ahead[0].t <= now:
            self._pass(joint, ahead.pop(0), q)
        if joint not in self._behind:
            return 0.0
        wanted = self._wanted(joint, now)
        pull = STIFFNESS * (wanted - q) - _DAMPING * qd
        return max(min(pull, self._strength), -self._strength)

    def _pass(self, joint: str, waypoint: Waypoint, q: float) -> None:
        if waypoint.release:
            self._behind.pop(joint, None)
            return
        fresh = joint not in self._behind
        here = q if fresh or waypoint.q is None else waypoint.q
        self._behind[joint] = (waypoint.t, here)

    def _wanted(self, joint: str, now: float) -> float:
        t_from, q_from = self._behind[joint]
        ahead = self._ahead[joint]
        if not ahead or ahead[0].q is None:
            return q_from
        target = ahead[0]
        assert target.q is not None
        return q_from + (target.q - q_from) * (now - t_from) / (target.t - t_from)
