"""Judge the compiled library: the same checks by coal and Python, one configuration at a time."""

from math import ceil

import numpy as np

from so101_motion.planning.checkpoint import never_abandoned
from so101_motion.planning.collision.collision import CollisionModel

CUT = 4  # as in edges.c


class CoalJudge(CollisionModel):
    """A ``CollisionModel`` that asks the library nothing."""

    def __init__(self, model, scene=None, checkpoint=never_abandoned):
        super().__init__(model, scene, checkpoint)
        self.batch = Silent()

    def is_free(self, q, q_jaw=0.0):
        return not self._plain.levels[0].touches(np.append(q, q_jaw))

    def touching(self, configurations, q_jaw=0.0, *, extra=0.0):
        proof = self._wider(extra) if extra else self._plain
        q = np.column_stack((configurations, np.broadcast_to(q_jaw, len(configurations))))
        return np.array([proof.levels[0].touches(each) for each in q], dtype=bool)

    def first_blocked(self, points, q_jaw=0.0, *, tolerance=0.0, bend=0.0, extra=0.0):
        proof, reach = self._proof_of(tolerance, bend, extra), self._levers.at(q_jaw)
        return first_blocked(proof.levels, reach, points, q_jaw, self.checkpoint)

    def is_clear(self, q_from, q_to, q_jaw, *, spacing):
        """Whether no sample between two configurations touches."""
        count = int(np.abs(q_to - q_from) @ self._levers.at(q_jaw) / spacing)
        shares = np.arange(1, count + 1)[:, None] / (count + 1)
        return not self.touching(q_from + shares * (q_to - q_from), q_jaw).any()


class Silent:
    """Stands for the library and leaves everything to coal."""

    def register(self, _):
        return 0

    def near(self, *_):
        return None

    def lacks_more(self, *_):
        return None


def first_blocked(levels, reach, points, q_jaw, checkpoint=never_abandoned):
    """A configuration (5,) on the straight lines through ``points`` that is too close, or None.

    None is a proof that the motion is free. ``levels`` go from the margins themselves to the widest
    clearance; ``points`` are (n, 5) [rad]; ``reach`` is that of a ``CollisionModel``.
    """
    points = np.asarray(points, dtype=np.float64)
    travelled = np.append(0.0, np.cumsum(np.abs(np.diff(points, axis=0)) @ reach))
    total = float(travelled[-1])
    widest = levels[-1].clearance
    count = max(1, ceil(0.5 * total / widest))
    half = 0.5 * total / count
    middles = np.linspace(half, total - half, count)
    while True:
        k = next((k for k, level in enumerate(levels) if level.clearance >= half), -1)
        configurations = _configurations(points, travelled, middles, q_jaw)
        failed = _touching(levels[k].touches, configurations, checkpoint)
        if not failed:
            return None
        if k == 0:
            return np.array(configurations[failed[0], :5])
        if k == len(levels) - 1:
            # Most contacts are found here already.
            for i in failed:
                if levels[0].touches(configurations[i]):
                    return np.array(configurations[i, :5])
        half /= CUT
        middles = (middles[failed, None] + half * np.arange(1 - CUT, CUT, 2)).ravel()


def _touching(touches, configurations, checkpoint):
    """Which of the configurations, shape (n, 6), [rad], are too close to something."""
    failed = []
    for i, configuration in enumerate(configurations):
        checkpoint()
        if touches(configuration):
            failed.append(i)
    return failed


def _configurations(points, travelled, at, q_jaw):
    """The configurations after some travel along a polyline, all six joints, shape (len(at), 6)."""
    configurations = np.empty((len(at), 6))
    configurations[:, 5] = q_jaw
    if len(points) == 2 and travelled[-1] > 0.0:
        configurations[:, :5] = points[0] + (at / travelled[-1])[:, None] * (points[1] - points[0])
        return configurations
    k = np.minimum(np.searchsorted(travelled, at, "right"), len(points) - 1)
    before = np.maximum(k - 1, 0)
    length = travelled[k] - travelled[before]
    part = (at - travelled[before]) / np.where(length > 0.0, length, 1.0)
    configurations[:, :5] = points[before] + part[:, None] * (points[k] - points[before])
    return configurations
