"""Judge the compiled library: the same checks by coal and Python, one configuration at a time."""

from itertools import pairwise

import numpy as np

from so101_motion.planning.checkpoint import never_abandoned
from so101_motion.planning.collision.collision import CollisionModel


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

    def keeps_room_along(self, points, q_jaw=0.0, *, share=1.0):
        """Whether pairs keep a share of their margins, at samples 4 mm of travel apart."""
        return all(
            (self.distances(q, q_jaw) >= share * self.margins).all()
            for begin, end in pairwise(points)
            for q in np.linspace(begin, end, 2 + int(np.abs(end - begin) @ self.reach / 0.004))
        )


class Silent:
    """Stands for the library and leaves everything to coal."""

    def register(self, _):
        return 0

    def near(self, *_):
        return None
