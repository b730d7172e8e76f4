"""The compiled closed forms give the answers of those in Python, in their order."""

import itertools

import numpy as np
import pytest

from so101_motion.common.geometry import SE3
from so101_motion.planning.goals import GoalMetric, PoseGoal
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.ik_closed import ClosedForms
from so101_motion.planning.kinematics.ik_task import check_goal, check_seed
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.native.library import native

pytestmark = pytest.mark.skipif(native().library is None, reason=native().reason)

PEN = SE3.from_rpy((0.3, 0.2, 0.1), (0.02, 0.01, 0.08))
FRAMES = ("tool", "jaw_tip", "pen")


@pytest.fixture(scope="module")
def model():
    return RobotModel.load().with_frame("pen", PEN)


@pytest.fixture(scope="module")
def forms(model):
    """In Python and compiled."""
    structure = IkSolver(model).structure
    return ClosedForms(structure), ClosedForms(structure, native().library)


def goals(model, kind, metric, frame, count):
    """Goals at random poses of a kind, each with a seed, some of them outside the limits."""
    random = np.random.default_rng([1, *map(ord, kind)])
    for k in range(count):
        q = random.uniform(model.lower, model.upper)
        T = model.frame(q, frame)
        if kind == "anywhere":
            T = SE3(T.R, random.uniform([-0.6, -0.6, -0.4], [0.6, 0.6, 0.7]))
        elif kind == "turned":
            T = SE3(model.frame(random.uniform(model.lower, model.upper)).R, T.p)
        elif kind == "straight down":
            T = SE3(np.diag([1.0, -1.0, -1.0]), T.p)
        elif kind == "stretched":
            q[2] = np.radians(-73.8016)  # upper arm and forearm in line
            T = model.frame(q, frame)
        tolerance = (0.01, 0.3, 2.0)[k % 3]
        goal = PoseGoal(T_base_tool=T, metric=metric, frame=frame, approach_tolerance=tolerance)
        seed = np.zeros(5) if k % 2 else 1.05 * random.uniform(model.lower, model.upper)
        yield check_goal(model, goal), check_seed(seed)


@pytest.mark.parametrize("kind", ["in reach", "anywhere", "turned", "straight down", "stretched"])
def test_compiled_and_in_python_it_is_the_same(model, forms, kind):
    python, compiled = forms
    found = 0
    for metric, frame in itertools.product(GoalMetric, FRAMES):
        for task, seed in goals(model, kind, metric, frame, 30):
            expected, answer = list(python.nearest(task, seed)), list(compiled.nearest(task, seed))
            assert [each.branch for each in answer] == [each.branch for each in expected]
            for one, other in zip(answer, expected, strict=True):
                np.testing.assert_allclose(one.q, other.q, rtol=0.0, atol=1e-9)
            found += len(expected)
    assert found > 100
