"""A jog without an arm: setpoints, step by step, for targets."""

import numpy as np

from so101_motion.arm.open_ended_motions import GUARDED_STOP
from so101_motion.control.cartesian_jog import Jog
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.differential.guard import Guard


class Jogged(Jog):
    """A jog from rest at ``q_start`` in a scene; ``q_jaw`` is where the jaw stands [rad]."""

    def __init__(self, model, scene, limits, dt, q_start, load=None, q_jaw=0.0):
        guard = Guard(
            CollisionModel(model, scene), lambda: q_jaw, load,
            acceleration=GUARDED_STOP.acceleration,
        )  # fmt: skip
        super().__init__(
            model, q_start=np.asarray(q_start, dtype=float), limits=limits,
            stop_limits=GUARDED_STOP, dt=dt, guard=guard,
        )  # fmt: skip

    def step(self, target):
        self._wish(target)
        return self.sample(0)

    @property
    def q(self):
        return self.now.q

    @property
    def qd(self):
        return self.now.qd

    @property
    def share(self):
        return self._reference.share
