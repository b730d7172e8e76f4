"""Laws of every scene: checks, distances and plans agree with a second, plain implementation."""

import numpy as np
from harness.coal_check import CoalJudge
from harness.random_plans import (
    MODEL,
    PLANNER,
    free_configuration,
    jaws,
    plan_or_refusal,
    random_configuration,
    seeds,
    two_free_configurations,
)
from harness.random_scenes import random_scene
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from so101_motion.common.errors import InCollision, NoPath
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import LINKS, Scene
from so101_motion.planning.goals import GoalMetric, JointGoal, LineGoal, PoseGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner, PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)

margins = st.sampled_from([0.001, 0.003, 0.02])
judges = st.sampled_from([CollisionModel, CoalJudge])


@given(seed=seeds, q_jaw=jaws, margin=margins, held=st.booleans(), judge=judges)
@settings(max_examples=18)
def test_a_check_says_what_the_distances_of_all_pairs_say(seed, q_jaw, margin, held, judge):
    rng = np.random.default_rng(seed)
    collision = judge(MODEL, random_scene(rng, margin, held=held))
    for _ in range(20):
        q = random_configuration(rng)
        room = (collision.distances(q, q_jaw) - collision.margins).min()
        if abs(room) > 2e-6:
            assert collision.is_free(q, q_jaw) == (room > 0.0)


@given(seed=seeds, q_jaw=jaws, within=st.sampled_from([0.01, 0.05, 0.1]), judge=judges)
@settings(max_examples=12)
def test_near_pairs_are_all_that_are_near_with_points_that_far_apart(seed, q_jaw, within, judge):
    rng = np.random.default_rng(seed)
    collision = judge(MODEL, random_scene(rng, held=True))
    for _ in range(8):
        q = random_configuration(rng)
        distances = collision.distances(q, q_jaw)
        near = collision.nearest(q, q_jaw, within=within)
        expected = {collision.pairs[k] for k in np.flatnonzero(distances < within - 2e-6)}
        found = {(each.first, each.second) for each in near}
        for each in near:
            assert each.distance <= within
            k = collision.pairs.index((each.first, each.second))
            assert abs(each.distance - distances[k]) < 2e-6
        assert expected <= found
        assert [each.distance for each in near] == sorted(each.distance for each in near)


@given(seed=seeds, q_jaw=jaws, judge=judges)
@settings(max_examples=10)
def test_the_gradient_of_a_distance_is_what_the_joints_do_to_it(seed, q_jaw, judge):
    rng = np.random.default_rng(seed)
    collision = judge(MODEL, random_scene(rng, held=True))
    h = 1e-4
    for _ in range(5):
        q = random_configuration(rng)
        here = collision.distances(q, q_jaw)
        ahead, behind = (
            np.array([collision.distances(q + step, q_jaw) for step in sign * h * np.eye(5)])
            for sign in (1.0, -1.0)
        )
        for each in collision.nearest(q, q_jaw, within=0.1):
            k = collision.pairs.index((each.first, each.second))
            right, left = (ahead[:, k] - here[k]) / h, (here[k] - behind[:, k]) / h
            # Where the nearest point jumps from an edge to the next there is no one gradient.
            if each.distance > 1e-3 and np.abs(right - left).max() < 5e-3:
                assert np.allclose(each.gradient, 0.5 * (right + left), atol=2e-2)


@given(seed=seeds, q_jaw=jaws, held=st.booleans())
@settings(max_examples=6)
def test_a_plan_touches_nothing_or_says_what_is_in_the_way(seed, q_jaw, held):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, held=held)
    collision, judge = CollisionModel(MODEL, scene), CoalJudge(MODEL, scene)
    start, goal = two_free_configurations(rng, q_jaw, collision)
    request = PlanRequest(
        q_start=start, goal=JointGoal(q=goal), limits=LIMITS, q_jaw=q_jaw, scene=scene,
        time_budget=2.0,
    )  # fmt: skip
    plan, refusal = plan_or_refusal(request)
    if refusal:
        assert isinstance(refusal, NoPath)
        assert refusal.where in ("start", "goal", "path")
        assert set(refusal.blockers) <= {*LINKS, "floor", *(o.name for o in scene.obstacles)}
        return
    assert np.array_equal(plan.trajectory.q[0], start)
    assert np.array_equal(plan.trajectory.q[-1], goal)
    assert np.abs(plan.trajectory.qd[3:-3]).max(axis=1, initial=0.0).min(initial=1.0) > 0.0, "stops"
    for q in plan.trajectory.q[::3]:
        assert (judge.distances(q, q_jaw) > 0.0).all()


@given(seed=seeds)
@settings(max_examples=16)
def test_from_any_start_the_arm_leaves_harmlessly_or_says_what_it_touches(seed):
    rng = np.random.default_rng(seed)
    scene, beyond = (random_scene(rng, held=True), 0.0) if seed % 3 else (Scene(), 0.1)
    collision = CollisionModel(MODEL, scene)
    start = rng.uniform(MODEL.lower - beyond, MODEL.upper + beyond)
    goal = free_configuration(rng, 0.0, collision)
    assume(goal is not None)
    request = PlanRequest(
        q_start=start, goal=JointGoal(q=goal), limits=LIMITS, scene=scene, time_budget=2.0
    )
    plan, refusal = plan_or_refusal(request)
    if isinstance(refusal, NoPath):
        return
    if refusal:
        assert isinstance(refusal, InCollision)
        assert refusal.where == "start"
        assert not collision.is_free(start)
        things = {frozenset(pair) for pair in collision.pairs}
        assert frozenset((refusal.first, refusal.second)) in things
        return
    distances = np.array([collision.distances(q) for q in plan.trajectory.q[::2]])
    # Pairs in contact only part, by more and more; and no other pair comes into contact.
    kept = np.maximum.accumulate(np.minimum(distances, 0.0), axis=0)
    assert np.all(distances >= kept - 1e-3)
    outside = np.maximum(MODEL.lower - plan.trajectory.q, plan.trajectory.q - MODEL.upper)
    excess = np.maximum(outside, 0.0)
    assert np.all(np.diff(excess, axis=0) <= 1e-9)
    assert not np.any(excess[-1])


@given(seed=seeds)
@settings(max_examples=10)
def test_the_same_request_gives_the_same_bytes(seed):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, held=bool(seed % 2), count=3)
    collision = CollisionModel(MODEL, scene)
    start, goal = two_free_configurations(rng, 0.0, collision)
    T = MODEL.frame(start)
    ahead = SE3(T.R, T.p + 0.05 * rng.normal(size=3) / np.sqrt(3.0))
    metric = list(GoalMetric)[seed // 8 % 3]
    wanted = (
        JointGoal(q=goal),
        PoseGoal(T_base_tool=MODEL.frame(goal)),
        LineGoal(T_base_tool=ahead, metric=metric, orientation_tolerance=np.radians(20.0)),
    )[seed % 3]
    request = PlanRequest(
        q_start=start, goal=wanted, limits=LIMITS, scene=scene, seed=seed, time_budget=3.0
    )
    answers = []
    for planner in (Planner(RobotModel.load()), PLANNER, PLANNER):
        plan, refusal = plan_or_refusal(request, planner)
        assume(not isinstance(refusal, NoPath))  # that is a matter of time
        motion = plan.trajectory if plan else None
        answers.append(
            motion.q.tobytes() + motion.qd.tobytes() + motion.qdd.tobytes()
            if motion
            else str(refusal).encode()
        )
    assert answers[0] == answers[1] == answers[2]
