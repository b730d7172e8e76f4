"""A simulated arm that keeps its setpoints, and what setpoints use of the caps of their joints."""

import numpy as np

from so101_motion.control.streamed_trajectory import TimedPoint
from so101_motion.drivers.simulated import SimArm


def shares(q, dt, limits):
    """The largest share of the velocity, acceleration and jerk caps, by differences of ``q``."""
    return [
        np.max(np.abs(np.diff(q, order, axis=0)) / dt**order / getattr(limits, cap), initial=0.0)
        for order, cap in enumerate(("velocity", "acceleration", "jerk"), start=1)
    ]


def swing(begin, end, seconds):
    """Points of a smooth motion from rest to rest, every 20 ms, for a stream."""
    u = np.linspace(0.0, 1.0, round(seconds / 0.02) + 1)
    q = begin + (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5)[:, None] * (np.asarray(end) - begin)
    return [TimedPoint(t=0.02 * k, q=each) for k, each in enumerate(q)]


class TapedArm(SimArm):
    """A simulated arm that keeps what it was told.

    Attributes:
        tape: Every goal as (time, arm joints, jaw).
        torques: Every torque command as (on, goal written before it or None).
    """

    def __init__(self, clock, **settings):
        super().__init__(clock, **settings)
        self.tape = []
        self.torques = []
        self.is_closed = False

    def write(self, q_cmd, q_jaw_cmd, qd_cmd=None, qdd_cmd=None, *order):
        super().write(q_cmd, q_jaw_cmd, qd_cmd, qdd_cmd, *order)
        self.tape.append((self._clock.now(), np.array(q_cmd), q_jaw_cmd))

    def set_torque(self, on):
        super().set_torque(on)
        self.torques.append((on, self.tape[-1][1] if self.tape else None))

    def close(self):
        super().close()
        self.is_closed = True

    @property
    def times(self):
        return np.array([t for t, _, _ in self.tape])

    @property
    def goals(self):
        return np.array([q for _, q, _ in self.tape])

    @property
    def jaw_goals(self):
        return np.array([q_jaw for _, _, q_jaw in self.tape])
