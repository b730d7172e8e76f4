"""The compiled closed forms, judged by Pinocchio and by a search over what a goal leaves free."""

import math

import numpy as np
import pytest

from benchmarks.plan_problems import at_pitch
from so101_motion.common.geometry import SE3
from so101_motion.planning.goals import GoalMetric, PoseGoal
from so101_motion.planning.kinematics.arm_geometry import REACH_SLACK
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.ik_closed import ClosedForms
from so101_motion.planning.kinematics.ik_task import check_goal, check_seed
from so101_motion.planning.kinematics.model import RobotModel

PEN = SE3.from_rpy((0.3, 0.2, 0.1), (0.02, 0.01, 0.08))
FRAMES = ("tool", "jaw_tip", "pen")


@pytest.fixture(scope="module")
def model():
    return RobotModel.load().with_frame("pen", PEN)


@pytest.fixture(scope="module")
def forms(model):
    return ClosedForms(IkSolver(model).structure)


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


@pytest.mark.parametrize("metric", GoalMetric)
@pytest.mark.parametrize("kind", ["in reach", "anywhere", "turned", "straight down", "stretched"])
def test_each_puts_the_frame_at_the_point_within_the_limits(model, forms, kind, metric):
    found = 0
    for frame in FRAMES:
        for task, seed in goals(model, kind, metric, frame, 30):
            nearest = forms.nearest(task, seed)
            for configuration in (*nearest, *forms.spread(task, seed)):
                q = np.array(configuration.q)
                off = np.linalg.norm(model.frame(q, frame).p - task.p_base)
                most = (1e-6, 1e-9) if configuration in nearest else (1.1 * REACH_SLACK, 2e-6)
                assert off < most[0]
                assert np.all((q >= model.lower - most[1]) & (q <= model.upper + most[1]))
                assert configuration.branch == forms.branch(q, frame) or off > 1e-7
                found += 1
    assert found > 5


@pytest.mark.parametrize("frame", FRAMES)
def test_no_range_of_pitches_is_missed(model, forms, frame):
    structure, reached = IkSolver(model).structure, 0
    metric = GoalMetric.POSITION_ONLY
    for task, seed in (
        *goals(model, "anywhere", metric, frame, 15),
        *goals(model, "in reach", metric, frame, 15),
    ):
        roll = structure.clip_roll(seed[4])
        on_grid = [
            q
            for pitch in np.linspace(-np.pi, np.pi, 121)
            for q in at_pitch(structure, task.p_base, pitch, roll, frame)
        ]
        spread = [np.array(c.q) for c in forms.spread(task, seed) if c.q[4] == roll]
        assert bool(forms.nearest(task, seed)) >= bool(on_grid)
        for q in on_grid:
            like = [each for each in spread if forms.branch(each, frame) == forms.branch(q, frame)]
            turns = [math.remainder(each[1:4].sum() - q[1:4].sum(), math.tau) for each in like]
            assert np.abs(turns).min() < 0.21
        reached += bool(on_grid)
    assert reached > 10


@pytest.mark.parametrize("kind", ["in reach", "straight down", "stretched"])
def test_for_a_point_none_of_those_spread_over_its_pitches_is_much_nearer(model, forms, kind):
    beaten = compared = 0
    for frame in FRAMES:
        for task, seed in goals(model, kind, GoalMetric.POSITION_ONLY, frame, 30):
            nearest = next(iter(forms.nearest(task, seed)), None)
            if nearest is None:
                continue
            away = math.dist(nearest.q, seed)
            same_roll = (c for c in forms.spread(task, seed) if c.q[4] == nearest.q[4])
            least = min((math.dist(c.q, seed) for c in same_roll), default=math.inf)
            assert away <= least + 0.05
            beaten += away > least + 1e-3
            compared += 1
    assert compared > 50
    assert beaten <= 1
