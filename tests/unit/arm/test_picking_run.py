"""Picking and placing on a simulated arm, among things that can be gripped."""

import threading
import time

import numpy as np
import pytest

from so101_motion.arm.picking import TRIES
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import Interrupted, MotionError, NoPath
from so101_motion.common.geometry import SE3
from so101_motion.common.units import to_rad
from so101_motion.planning.collision.scene import FLOOR_Z, Box, Obstacle, Scene
from so101_motion.rig.simulated_rig import open_simulated

pytestmark = pytest.mark.usefixtures("planning_process")

START = np.array([0.0, -1.7, 1.5, 1.2, 0.0])


def cube(x=0.2, y=0.05, edge=0.03):
    T = SE3.from_translation((x, y, FLOOR_Z + edge / 2.0))
    return Obstacle(name="cube", shape=Box(size=np.full(3, edge)), T_base_obstacle=T, mass=0.02)


@pytest.fixture
def rig():
    with open_simulated(
        clock=ManualClock(), speed=to_rad(180.0), acceleration=to_rad(500.0), q_start=START,
        scene=Scene(obstacles=(cube(),)),
    ) as rig:  # fmt: skip
        yield rig


def until(rig, condition):
    """Let time pass until it is true, but none while the arm is planned for."""
    moment, end = threading.Event(), time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        if rig.arm.state.arm_moving or rig.gripper.is_moving:
            rig.clock.advance(0.05)
        else:
            rig.clock.advance(0.01)
            moment.wait(0.001)


def finish(rig, run):
    until(rig, run.future.done)
    return run.future.result()


def test_where_nothing_is_the_jaw_closes_on_nothing_and_says_so_each_time(rig):
    rig.things.take_away("cube")
    said = []
    run = rig.picker.start("cube", tell=said.append)
    with pytest.raises(MotionError, match=r"'cube' was not held in 3 tries: .* on nothing where"):
        finish(rig, run)
    assert len(said) == TRIES
    assert rig.arm.scene.items
    assert not rig.arm.scene.attached
    before = run.plan.plans["reach"].tool_path[0]
    np.testing.assert_allclose(rig.arm.T_base_tool.p, before, atol=2e-3)  # it has gone back


@pytest.mark.parametrize("stage", ["plan", "approach", "close", "lift"])
def test_a_stop_at_any_stage_ends_it_and_what_is_held_stays_held(rig, stage):
    run = rig.picker.start("cube")
    until(rig, lambda: run.stage == stage)
    stopped = rig.arm.start_stop()
    with pytest.raises(Interrupted, match="the motion was ended early by stop") as ended:
        finish(rig, run)
    until(rig, stopped.done)
    sent = rig.arm.state.q_ref
    rig.clock.advance(1.0)
    np.testing.assert_array_equal(rig.arm.state.q_ref, sent)
    held = stage == "lift"
    if stage != "close":  # there the jaw may have closed before the stop came
        assert rig.gripper.is_holding == held
        assert ("'cube' is still held" in str(ended.value)) == held


def test_a_scene_that_changes_meanwhile_is_not_moved_in(rig):
    run = rig.picker.start("cube")
    until(rig, lambda: run.stage == "approach")
    rig.arm.scene = Scene(obstacles=(cube(0.22),))
    with pytest.raises(MotionError, match="the scene has changed since 'cube' was planned for"):
        finish(rig, run)


def test_what_cannot_be_picked_moves_nothing(rig):
    rig.arm.scene = Scene(obstacles=(cube(edge=0.08),))
    q = rig.arm.q
    with pytest.raises(NoPath, match="planning: 'cube' is 20 mm too wide"):
        finish(rig, rig.picker.start("cube"))
    np.testing.assert_array_equal(rig.arm.q, q)
