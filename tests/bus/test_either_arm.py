"""The real rig on emulated servos, or with ``--hardware PORT`` on a real arm.

A real arm moves by 10 deg at most from where it stands, at 15 deg/s, its jaw all the way.
"""

import numpy as np
import pytest
from harness.emulated_rig import STEP_DEG, either_bench, near
from harness.path_following import follow, random_plan

from so101_motion.common.errors import Interrupted
from so101_motion.common.modes import Mode
from so101_motion.control.executor import Channel


@pytest.fixture
def bench(arm_port, tmp_path, planning_process):
    with either_bench(arm_port, tmp_path, reply_timeout=0.5) as bench:
        yield bench


@pytest.fixture
def rig(bench):
    rig = bench.open()
    bench.advance(1.0)  # the weight is taken up
    return rig


# Opening


def test_nothing_moves_by_being_opened_and_closed(bench):
    first = bench.open()
    bench.advance(1.0)
    before = bench.q_deg
    bench.shut(first)
    rig = bench.open()
    bench.advance(1.0)

    assert bench.q_deg == pytest.approx(before, abs=0.5)
    assert rig.arm.state.mode is Mode.HOLDING
    assert rig.servos.is_connected


def test_every_servo_says_how_it_is(bench, rig):
    bench.advance(0.5)
    health = rig.servos.health

    assert [one.joint for one in health] == [*rig.servos.setups]
    for one in health:
        assert 4.0 < one.volts < 14.5
        assert 5 < one.temperature_c < 60
        assert one.faults == ()
        assert not one.is_silent
        assert one.answers > 10
        assert one.lost + one.corrupt < 0.05 * one.answers


# Moving


def test_it_goes_where_it_is_sent_and_back(bench, rig):
    start = np.degrees(rig.arm.state.q)
    for goal in (near(rig, 1, 0, 0, 0.5, 1), start):
        bench.finish(bench.go(rig, *goal))
        assert bench.arm_deg(rig) == pytest.approx(goal, abs=0.35)
    bench.advance(2.0)
    assert bench.arm_deg(rig) == pytest.approx(start, abs=0.35)


def test_it_stays_within_3_deg_of_its_path_and_passes_every_waypoint(bench, rig):
    start = np.degrees(rig.arm.state.q)
    middle = near(rig, 0.5, 0.5, 0.5, 0.5, 0.5)
    plan, way = random_plan(rig, 5, waypoints=3, middle=middle, reach=0.5 * STEP_DEG)
    followed = follow(bench, rig, plan, way)

    assert followed.error < 3.0
    assert followed.missed < 3.0
    assert followed.final <= 0.3
    assert followed.lag < 0.15
    bench.finish(bench.go(rig, *start))


def test_a_stop_brings_it_to_rest_where_it_is(bench, rig):
    start = np.degrees(rig.arm.state.q)
    rig.arm.set_speed(np.radians(5.0))
    motion = bench.go(rig, *near(rig, 1, 0, 0, 0, 0))
    bench.under_way(motion, rig, 0.7)
    bench.finish(rig.executor.stop())
    with pytest.raises(Interrupted):
        bench.finish(motion)
    here = bench.arm_deg(rig)
    bench.advance(1.0)

    assert 0.3 < abs(here[0] - start[0]) < STEP_DEG - 1.0
    assert bench.arm_deg(rig) == pytest.approx(here, abs=0.7)
    bench.finish(bench.go(rig, *start))


def test_it_turns_to_a_new_goal_on_the_way(bench, rig):
    start, goal = np.degrees(rig.arm.state.q), near(rig, 1, 0, 0, 0, 0)
    first = rig.arm.retarget(np.radians(goal))
    bench.under_way(first, rig, 0.2)
    second = rig.arm.retarget(np.radians(start))
    with pytest.raises(Interrupted, match="a newer motion"):
        bench.finish(first)
    bench.finish(second)

    assert bench.arm_deg(rig) == pytest.approx(start, abs=0.35)


# The gripper


def test_the_jaw_opens_and_closes(bench, rig):
    bench.finish(rig.gripper.move(0.9, wait=False))
    assert rig.gripper.aperture == pytest.approx(0.9, abs=0.02)
    bench.finish(rig.gripper.grab(wait=False))
    assert rig.gripper.aperture < 0.05
    assert not rig.gripper.is_holding


def test_arm_and_jaw_move_together_and_a_stop_of_the_jaw_leaves_the_arm_alone(bench, rig):
    start, goal = np.degrees(rig.arm.state.q), near(rig, 1, 0, 0, 0, 0)
    arm = bench.go(rig, *goal)
    jaw = rig.gripper.move(0.9, wait=False)
    bench.under_way(arm, rig, 0.3)
    bench.finish(rig.executor.stop(Channel.JAW))
    with pytest.raises(Interrupted):
        bench.finish(jaw)
    bench.finish(arm)

    assert rig.gripper.aperture < 0.9
    assert bench.arm_deg(rig) == pytest.approx(goal, abs=0.35)
    bench.finish(rig.gripper.grab(wait=False))
    bench.finish(bench.go(rig, *start))
