"""The gripper as people use it: an aperture from 0 (closed) to 1 (open)."""

from __future__ import annotations

import numpy as np

from so101_motion.errors import ConfigError
from so101_motion.executor import Channel, Executor
from so101_motion.motion import Motion
from so101_motion.planning.limits import MotionLimits
from so101_motion.units import to_rad

JAW_CLOSED = to_rad(-10.0)
"""Jaw angle at aperture 0 [rad]; the lower joint limit of the robot description."""

JAW_OPEN = to_rad(100.0)
"""Jaw angle at aperture 1 [rad]; the upper joint limit."""

JAW_LIMITS = MotionLimits.uniform(velocity=to_rad(220.0), acceleration=20.0, jerk=400.0, n=1)
"""How fast the jaw moves. Speed: the published simulated gripper's 200 % of the travel a second,
just under what the servo can do; acceleration and jerk: chosen."""


class Gripper:
    """One jaw that opens and closes. A new motion takes over from the one under way.

    Args:
        executor: The I/O thread that moves it; owned by the rig.
    """

    def __init__(self, *, executor: Executor) -> None:
        self._executor = executor

    @property
    def q_jaw(self) -> float:
        """Measured jaw angle [rad]."""
        return self._executor.state.q_jaw

    @property
    def aperture(self) -> float:
        """How far it is open, from the measured jaw angle: 0 closed, 1 open."""
        return (self.q_jaw - JAW_CLOSED) / (JAW_OPEN - JAW_CLOSED)

    @property
    def is_moving(self) -> bool:
        """Whether a motion of the jaw is under way."""
        return self._executor.state.jaw_moving

    def start_move(self, aperture: float) -> Motion:
        """Open or close to ``aperture``.

        Raises:
            ConfigError: Outside 0 to 1.
        """
        if not 0.0 <= aperture <= 1.0:
            raise ConfigError("aperture", aperture, "must be between 0 (closed) and 1 (open)")
        q_goal = np.array([JAW_CLOSED + aperture * (JAW_OPEN - JAW_CLOSED)])
        motion = Motion()
        running = motion.begin(
            lambda: self._executor.retarget(q_goal, JAW_LIMITS, channel=Channel.JAW),
            self._executor.interrupt,
        )
        running.add_done_callback(motion.take_outcome)
        return motion

    def stop(self) -> None:
        """Slow to rest and hold; returns when the jaw is at rest. The arm is left alone."""
        self._executor.stop(Channel.JAW).result()
