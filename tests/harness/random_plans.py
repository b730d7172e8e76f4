"""One planner, and what its requests are drawn from."""

from hypothesis import assume
from hypothesis import strategies as st

from so101_motion.common.errors import PlanningError
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner

MODEL = RobotModel.load()
COLLISION = CollisionModel(MODEL)
PLANNER = Planner(MODEL)

seeds = st.integers(min_value=0, max_value=2**32 - 1)
jaws = st.sampled_from([0.0, 0.5, 1.7])


def random_configuration(rng):
    return rng.uniform(MODEL.lower, MODEL.upper)


def free_configuration(rng, q_jaw=0.0, collision=COLLISION):
    for _ in range(200):
        q = random_configuration(rng)
        if collision.is_free(q, q_jaw):
            return q
    return None


def two_free_configurations(rng, q_jaw=0.0, collision=COLLISION):
    """Or another example, if they are hard to find."""
    found = [free_configuration(rng, q_jaw, collision) for _ in range(2)]
    assume(found[0] is not None and found[1] is not None)
    return found


def plan_or_refusal(request, planner=PLANNER):
    try:
        return planner.plan(request), None
    except PlanningError as error:
        return None, error
