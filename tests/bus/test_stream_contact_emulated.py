"""Streams that lead into a crate, the table or the arm itself, on emulated servos: none touches."""

import math

import numpy as np
import pytest
from harness.random_scenes import obstacle
from harness.setpoints import swing

from so101_motion.common.errors import MotionError
from so101_motion.planning.collision.collision import CollisionModel

BEGIN = (100.0, -45.0, 45.0, 60.0, 0.0)
CRATE = obstacle("crate", (0.4, 0.04, 0.4), (0.3, 0.0, 0.2))
GOALS = {
    "'crate'": (-60.0, -45.0, 45.0, 60.0, 0.0),
    "the floor": (100.0, 75.0, -20.0, 60.0, 0.0),
    "the shoulder": (100.0, -50.0, 85.0, 95.0, 0.0),
}


@pytest.mark.parametrize(("into", "speed"), [*zip(GOALS, (180.0, 40.0, 180.0), strict=True)])
def test_neither_command_nor_servos_touch_what_a_stream_leads_into(bench, into, speed):
    rig = bench.open()
    bench.advance(0.5)
    arm = rig.arm
    arm.set_speed(math.radians(speed))
    arm.set_acceleration(math.radians(500.0 if speed > 100.0 else 200.0))
    bench.finish(bench.go(rig, *BEGIN))
    arm.scene = arm.scene.with_obstacles([CRATE])
    collision = CollisionModel(arm.model, arm.scene)
    opening = arm.start_stream()
    while not opening.opened.done():
        bench.advance(0.01)
    stream = opening.opened.result()
    stream.push(fastest(arm.state.q_ref, np.radians(GOALS[into]), arm.limits))
    stream.finish()
    nearest = math.inf
    for _ in range(1000):
        bench.advance(0.01)
        true = np.radians(bench.arm_deg(rig))
        for q in (true, arm.state.q_ref):
            nearest = min(nearest, float(collision.distances(q, arm.state.q_jaw).min()))
        if stream.future.done():
            break
    with pytest.raises(MotionError, match=f"into contact with {into}"):
        stream.future.result()
    assert nearest > 0.0


def fastest(q, q_goal, limits):
    """Points from rest to rest, nearly as fast as the limits allow."""
    way = float(np.abs(q_goal - q).max())
    seconds = max(
        1.9 * way / limits.velocity[0], math.sqrt(6.0 * way / limits.acceleration[0]), 0.4
    )
    return swing(q, q_goal, seconds)
