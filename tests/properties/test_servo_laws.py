"""Laws of every step of Cartesian jogging, whatever the tool is asked to do."""

import numpy as np
from harness.random_plans import MODEL, free_configuration, seeds
from harness.random_scenes import random_scene
from harness.setpoints import shares
from hypothesis import given, settings
from hypothesis import strategies as st

from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.differential.servo import Servo
from so101_motion.planning.differential.targets import STILL, Twist
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Load, Payload, Strength

DT = 0.01


def a_target(rng: np.random.Generator):
    kind = rng.integers(0, 8)
    if kind < 5:
        angular = rng.normal(size=3) * rng.choice([0.0, 1.0])
        linear = rng.normal(size=3) * rng.choice([0.02, 0.2, 2.0])
        return Twist(linear=linear, angular=angular, in_tool=bool(rng.random() < 0.3))
    if kind == 5:
        return MODEL.frame(rng.uniform(MODEL.lower, MODEL.upper))
    if kind == 6:
        return rng.uniform([-0.4, -0.4, -0.1], [0.4, 0.4, 0.5])
    return STILL


def between(q: np.ndarray, share: float) -> np.ndarray:
    return q[:-1] + share * np.diff(q, axis=0)


@settings(max_examples=8)
@given(seeds, st.floats(0.2, 3.0), st.floats(0.5, 9.0), st.floats(0.05, 0.5))
def test_whatever_is_asked_for_limits_are_kept_nothing_is_touched_and_it_can_stop(
    seed: int, velocity: float, acceleration: float, jerk_time: float
) -> None:
    rng = np.random.default_rng(seed)
    scene, q_jaw = random_scene(rng, count=int(rng.integers(0, 5))), float(rng.uniform(0.0, 1.7))
    judge = CollisionModel(MODEL, scene)
    start = free_configuration(rng, q_jaw, judge)
    if start is None:
        return
    jerk = acceleration / jerk_time
    limits = MotionLimits.uniform(velocity=velocity, acceleration=acceleration, jerk=jerk)
    servo = Servo(MODEL, CollisionModel(MODEL, scene), limits, DT, start)
    steps = []
    for _ in range(rng.integers(1, 7)):
        target = a_target(rng)
        steps += [servo.step(target, q_jaw) for _ in range(rng.integers(1, 40))]
    announced = servo.path_to_rest()[2:]
    steps += [servo.step(STILL, q_jaw) for _ in range(len(announced) + 1)]

    q = np.array([start, start, start, *(step.q for step in steps)])
    qd, qdd = np.diff(q, axis=0) / DT, np.diff(q, 2, axis=0) / DT**2
    assert np.all(q >= MODEL.lower - 1e-9)
    assert np.all(q <= MODEL.upper + 1e-9)
    assert max(shares(q, DT, limits)) <= 1.0 + 1e-6
    assert np.allclose(qd[2:], [step.qd for step in steps], atol=1e-9)
    assert np.allclose(qdd[1:], [step.qdd for step in steps], atol=1e-6)
    assert all(0.0 <= step.share <= 1.0 for step in steps)
    assert min(judge.distances(each, q_jaw).min() for each in q) > 0.0
    assert min(judge.distances(each, q_jaw).min() for each in between(q, 0.5)) > 0.0
    # It came to rest, on the way that it announced.
    assert not servo.qd.any()
    assert np.allclose(q[-len(announced) - 1 : -1], announced, atol=1e-9)


@settings(max_examples=5)
@given(seeds, st.floats(0.0, 0.5), st.floats(0.6, 2.0))
def test_whatever_is_asked_for_no_joint_has_to_hold_more_than_it_may(
    seed: int, mass: float, holding: float
) -> None:
    rng = np.random.default_rng(seed)
    start = free_configuration(rng)
    payload = Payload(mass=mass, com=tuple(rng.uniform(-0.1, 0.15, 3)))
    strength = Strength(holding=holding, moving=1.25 * holding)
    limits = MotionLimits.uniform(velocity=2.0, acceleration=5.0, jerk=50.0)
    load = Load.of(MODEL, strength, start, payload)
    servo = Servo(MODEL, CollisionModel(MODEL), limits, DT, start, load=load)
    q = [start]
    for _ in range(4):
        target = a_target(rng)
        q += [servo.step(target).q for _ in range(40)]
    borne = np.abs(MODEL.with_payload(mass, payload.com).holding_torques(np.array(q)))
    assert np.all(borne <= np.maximum(1.005 * holding, borne[0] + 1e-3))


@settings(max_examples=6)
@given(seeds)
def test_bodies_that_are_too_close_at_the_start_never_get_closer(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, count=int(rng.integers(0, 5)))
    judge = CollisionModel(MODEL, scene)
    q = rng.uniform(MODEL.lower, MODEL.upper)
    for _ in range(200):
        if -0.005 < judge.clearance(q).distance < 0.003:
            break
        q = rng.uniform(MODEL.lower, MODEL.upper)
    else:
        return
    limits = MotionLimits.uniform(velocity=1.0, acceleration=3.0, jerk=100.0)
    servo = Servo(MODEL, CollisionModel(MODEL, scene), limits, DT, q)
    configurations = [q]
    for _ in range(3):
        target = a_target(rng)
        configurations += [servo.step(target).q for _ in range(20)]
    distances = [np.minimum(judge.distances(each), 0.003) for each in configurations]
    # How deep two hulls overlap is known to some tenths of a millimetre only.
    assert np.min(np.array(distances) - distances[0]) >= -5e-4
    assert np.all(distances[-1] >= distances[0] - 2e-4)


@settings(max_examples=8)
@given(seeds)
def test_a_pose_near_by_that_is_free_to_be_had_is_reached(seed: int) -> None:
    rng = np.random.default_rng(seed)
    judge = CollisionModel(MODEL)
    inner = MODEL.lower + 0.3, MODEL.upper - 0.3
    start = rng.uniform(*inner)
    goal = start + rng.uniform(-0.15, 0.15, 5)
    weakest = min(np.linalg.svd(MODEL.frame_jacobian(q)[:3])[1][2] for q in (start, goal))
    far_apart = judge.clearance(start).distance < 0.04 or judge.clearance(goal).distance < 0.04
    if far_apart or weakest < 0.03 or min(start[2], goal[2]) < -1.0:
        return
    limits = MotionLimits.uniform(velocity=1.5, acceleration=4.0, jerk=100.0)
    servo = Servo(MODEL, CollisionModel(MODEL), limits, DT, start)
    target = MODEL.frame(goal)
    for _ in range(400):
        servo.step(target)
    assert np.linalg.norm(MODEL.frame(servo.q).p - target.p) < 1e-4
    assert np.abs(servo.qd).max() < 0.05
