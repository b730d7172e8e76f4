"""Write hand scripts for a calibration: hold the arm up, and lead each joint to its stops.

A script is text, see ``hand.py``; write it to a file for ``so101 emulate --hand``, or type ``pose``
and ``sweep`` while the emulator runs. The hand carries the weight of the joint it leads, and
presses against a stop with little more than that: a stop gives way under more, and the calibration
would record it too far out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.drivers.emulator.hand import STIFFNESS
from so101_motion.drivers.emulator.joint_figures import JOINTS, SO101
from so101_motion.drivers.servo_types import STS3215_12V

SPEED = math.radians(120.0)
"""Speed at which the hand leads a joint [rad/s]; chosen, a person is slower."""

REST = 0.3
"""How long the hand stays at a stop [s]; chosen."""

_PRESS = 2.0 * STS3215_12V.break_away
"""Torque of the hand against a stop [N m]; chosen: enough to reach it, not enough to push it in."""

_START = 2.0
"""When the hand begins to sweep [s]; from half that time on it holds the pose. Chosen."""

UPRIGHT = {"wrist_roll": 0.0486795}
"""Roll angle at which the gripper opens straight upwards [rad]: the robot description mounts it 2.8
deg off."""


def holding_script(
    weight: Callable[[Array], Array], *, by: float, pose: Mapping[str, float] | None = None
) -> str:
    """A script in which the hand moves the arm to a pose and holds it there.

    Args:
        weight: Holding torque [N m] as a function of the six joint angles [rad], shapes (6,).
        by: When the arm reaches the pose [s].
        pose: The joint angles of the pose [rad]; those left out as in ``UPRIGHT``, else zero.
    """
    lines = [f"0 {joint} start" for joint in JOINTS]
    lines += [_line(weight, by, i, _angles(pose)) for i in range(len(JOINTS))]
    return "\n".join(lines)


def sweeping_script(
    weight: Callable[[Array], Array],
    *,
    pose: Mapping[str, float] | None = None,
    speed: float = SPEED,
) -> tuple[str, float]:
    """A script in which the hand moves the arm to a pose and then sweeps the joints, base to jaw.

    Args:
        weight: Holding torque [N m] as a function of the six joint angles [rad], shapes (6,).
        pose: The joint angles of the pose [rad]; those left out as in ``UPRIGHT``, else zero.
        speed: How fast it leads a joint [rad/s].

    Returns:
        The script, and when it is over [s].
    """
    held = _angles(pose)

    def line(t: float, i: int, q: Array, press: float = 0.0) -> str:
        return _line(weight, t, i, q, press)

    lines = [holding_script(weight, by=_START / 2.0, pose=pose)]
    t = _START
    for i, joint in enumerate(SO101):
        lines.append(line(t, i, held))
        q = held.copy()
        for there, press in ((joint.lower, -_PRESS), (joint.upper, _PRESS), (held[i], 0.0)):
            t += abs(there - q[i]) / speed
            q[i] = there
            lines += [line(t, i, q, press), line(t + REST, i, q, press)]
            t += REST
    return "\n".join(lines) + "\n", t


def _angles(pose: Mapping[str, float] | None) -> Array:
    wanted = {**UPRIGHT, **(pose or {})}
    return np.array([wanted.get(joint, 0.0) for joint in JOINTS])


def _line(weight: Callable[[Array], Array], t: float, i: int, q: Array, press: float = 0.0) -> str:
    """The line that leads joint ``i`` to its angle in ``q`` and carries it there."""
    aim = q[i] + (press + float(weight(q)[i])) / STIFFNESS
    return f"{t:.3f} {JOINTS[i]} {math.degrees(aim):.4f}"
