"""The compiled check of configurations beside coal's, many of them close to contact.

Half of the configurations are drawn anywhere, half are found close to contact: on the line between
a free and a touching one it is halved until little is left. The scenes are random, of all kinds of
obstacles, with something in the hand or without. For each, the verdicts must be coal's: a "free"
where coal finds contact is a failure, and so is the opposite.
"""

import numpy as np
from harness.coal_check import CoalJudge
from harness.random_scenes import random_scene

from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import MARGIN

HALVINGS = 5


def random_configurations(rng, model, n, q_jaw):
    q = np.full((n, 6), q_jaw)
    q[:, :5] = rng.uniform(model.lower, model.upper, (n, 5))
    return q


def close_to_contact(rng, touching, q):
    """Configurations between free and touching ones of these; those near the change of verdict."""
    verdicts = touching(q)
    free, hit = q[~verdicts], q[verdicts]
    if not len(free) or not len(hit):
        return q
    a, b = rng.choice(free, len(q)), rng.choice(hit, len(q))
    a = b + np.minimum(1.0, 0.3 / np.abs(a - b).max(axis=1, keepdims=True)) * (a - b)
    verdicts = touching(a)
    for _ in range(rng.integers(HALVINGS, 3 * HALVINGS)):
        middle = 0.5 * (a + b)
        verdicts = touching(middle)
        a = np.where(verdicts[:, None], a, middle)
        b = np.where(verdicts[:, None], middle, b)
    return np.where(rng.random((len(q), 1)) < 0.5, a, b)


def compare(rng, model, n):
    """Compare ``n`` configurations in one random scene; what differs."""
    margin = float(rng.choice([0.001, MARGIN, MARGIN, 0.02]))
    count = int(rng.choice([0, 2, 5, 12]))
    scene = random_scene(rng, margin, held=rng.random() < 0.4, count=count)
    ours = CollisionModel(model, scene)
    judge = CoalJudge(model, scene)
    q_jaw = float(rng.choice([0.0, 0.5, 1.7]))

    def touching(q):
        return ours.touching(q[:, :5], q_jaw)

    anywhere = random_configurations(rng, model, n // 2, q_jaw)
    q = np.concatenate((anywhere, close_to_contact(rng, touching, anywhere)))
    found = touching(q)
    expected = judge.touching(q[:, :5], q_jaw)
    wrong = np.flatnonzero(found != expected)
    return [f"{len(wrong)} differ, such as {q[k].tolist()}" for k in wrong[:1]]
