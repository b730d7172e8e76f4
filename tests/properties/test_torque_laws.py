"""Laws of every plan of an arm that carries something."""

import numpy as np
from harness.random_plans import (
    MODEL,
    free_configuration,
    plan_or_refusal,
    seeds,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from so101_motion.common.errors import Overloaded
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.planner import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Payload, Strength
from so101_motion.planning.timing.verify import limit_report


@settings(max_examples=30)
@given(seeds, st.floats(0.0, 0.4), st.floats(0.5, 2.0), st.floats(1.0, 1.4), st.floats(1.0, 15.0))
def test_no_servo_has_to_exert_more_than_it_can_or_the_motion_is_refused(
    seed: int, mass: float, holding: float, more: float, acceleration: float
) -> None:
    rng = np.random.default_rng(seed)
    start, goal = free_configuration(rng), free_configuration(rng)
    payload = Payload(mass=mass, com=tuple(rng.uniform(-0.1, 0.15, 3)))
    strength = Strength(holding=holding, moving=more * holding)
    limits = MotionLimits.uniform(velocity=3.0, acceleration=acceleration, jerk=500.0)
    loaded = MODEL.with_payload(payload.mass, payload.com)
    request = PlanRequest(
        q_start=start, goal=JointGoal(q=goal), limits=limits, payload=payload, strength=strength
    )
    there = np.abs(loaded.holding_torques(start[None]))[0]
    plan, refusal = plan_or_refusal(request)
    if isinstance(refusal, Overloaded):
        assert refusal.limit >= holding
        assert abs(refusal.torque) > refusal.limit
        assert np.abs(loaded.holding_torques(refusal.q[None])).max() >= 0.9 * holding
    if refusal:
        return
    motion = plan.trajectory
    held = np.abs(loaded.holding_torques(motion.q))
    moved = np.abs(loaded.torques(motion.q, motion.qd, motion.qdd))
    assert np.all(held <= 1.01 * np.maximum(holding, there))
    assert np.all(held[-1] <= 1.002 * holding)
    allowed = np.where(there > holding, np.maximum(more * holding, 1.25 * there), more * holding)
    assert np.all(moved <= 1.002 * np.maximum(allowed, held))
    report = limit_report(motion, limits, MODEL.lower, MODEL.upper)
    assert report.worst <= 1.002
    assert np.array_equal(motion.q[-1], goal)


@given(seeds, st.floats(0.0, 2.0))
def test_a_payload_adds_the_torque_of_its_lever(seed: int, mass: float) -> None:
    rng = np.random.default_rng(seed)
    com = rng.uniform(-0.2, 0.2, 3)
    q = rng.uniform(MODEL.lower, MODEL.upper)
    tool, J = MODEL.frame(q), MODEL.frame_jacobian(q)
    lever = tool.R @ com
    J_com = J[:3] + np.cross(J[3:].T, lever).T
    added = J_com.T @ np.array([0.0, 0.0, 9.81 * mass])
    bare, loaded = (
        model.holding_torques(q[None])[0] for model in (MODEL, MODEL.with_payload(mass, com))
    )
    assert np.allclose(loaded - bare, added, atol=1e-9)
