"""A joint that meets an obstacle on its way: the motion ends, and the joint pushes no more."""

import math
from contextlib import nullcontext

import numpy as np
import pytest

from so101_motion.arm.cell import Cell
from so101_motion.common.errors import FollowingError
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Attached, Box, Scene
from so101_motion.rig.simulated_rig import open_simulated

SEEN_WITHIN = 0.1
"""From the contact to the command that ends the pushing [s]."""


pytestmark = pytest.mark.emulated(reply_timeout=2.0, held_kg=0.1)


@pytest.mark.parametrize(
    ("joint", "speed"), [("shoulder_pan", 25), ("shoulder_pan", 180), ("elbow_flex", 10)]
)
def test_a_joint_that_meets_a_wall_is_stopped_within_100_ms(bench, joint, speed):
    rig = bench.open()
    bench.advance(1.0)
    rig.arm.set_speed(math.radians(speed))
    rig.arm.set_acceleration(math.radians(500.0))
    i = ("shoulder_pan", "shoulder_lift", "elbow_flex").index(joint)
    wall = bench.world.q[i] - math.radians(35.0)
    bench.world.put_wall(joint, wall, math.inf)
    goal = [0.0, 0.0, 0.0, 0.0, 0.0]
    goal[i] = -60.0
    motion, touched, parted = bench.go(rig, *goal), None, None
    for _ in range(600):
        bench.advance(0.01)
        if touched is None and bench.world.q[i] <= wall:
            touched = bench.clock.now()
        if touched is not None and rig.arm.state.qd_ref[i] == 0.0:
            parted = bench.clock.now()
            break
    assert parted - touched <= SEEN_WITHIN
    with pytest.raises(FollowingError, match=f"{joint} was held up"):
        bench.finish(motion)
    bench.advance(1.0)
    push = abs(bench.world.servo(joint).drive.demand)
    assert push < 350, "it rests against the wall with a third of its drive at most"


def test_loads_turns_and_play_are_no_contact(bench):
    rig = bench.open()
    bench.advance(1.0)
    rig.arm.set_speed(math.radians(180.0))
    rig.arm.set_acceleration(math.radians(500.0))
    for goal in ([60, -60, 60, -60, 90], [-60, 30, -60, 60, -90], [0, 0, 0, 0, 0]):
        bench.finish(bench.go(rig, *goal))


def silence_moves(bench, rig, ticks, share=1.0):
    """Move to and fro while nothing reaches the servos for so many ticks, again and again."""
    for goal in np.array([[25, -10, -20, 10, 20], [-25, 5, 0, -20, -30]]):
        motion, k = bench.go(rig, *(share * goal)), 0
        while not motion.future.done():
            k += 1
            bench.emulator.bus.faults.request_loss = float(50 <= k % 100 < 50 + ticks)
            bench.advance(0.01)
        bench.finish(motion)


@pytest.mark.parametrize(("speed", "ticks", "share"), [(15.0, 9, 0.6), (90.0, 6, 1.0)])
def test_a_silence_of_all_servos_is_no_contact_and_joints_do_not_hurry_after_it(
    bench, speed, ticks, share
):
    rig = bench.open()
    bench.advance(1.0)
    rig.arm.set_speed(math.radians(speed))
    silence_moves(bench, rig, ticks, share)


@pytest.mark.parametrize(("away", "held"), [(0.7, False), (2.0, False), (2.0, True)])
def test_one_that_missed_its_goals_stops_beside_arms_that_it_can_meet(bench, away, held):
    rig = bench.open()
    bench.advance(1.0)
    rig.arm.set_speed(math.radians(45.0))
    cell = Cell()
    cell.add("left", rig, SE3.identity())
    with open_simulated(clock=bench.clock) as right:
        cell.add("right", right, SE3.from_translation((0.0, away, 0.0)))
        if held:  # however long it is
            box = Box(size=[0.02, 0.02, 0.1])
            stick = Attached(name="stick", shape=box, T_tool_object=SE3.identity())
            right.arm.scene = Scene(attached=(stick,))
        stops = pytest.raises(FollowingError, match=r"missed its goals .* answered for 0\.09 s")
        with stops if away < 1.0 or held else nullcontext():
            silence_moves(bench, rig, ticks=9)
        bench.emulator.bus.faults.request_loss = 0.0
        bench.advance(0.5)
        assert not rig.arm.state.arm_moving


def pushes(bench, joint):
    """How hard the servo of ``joint`` pushes, in thousandths of its drive; its torque is on."""
    drive = bench.world.servo(joint).drive
    assert drive.torque == 1
    return abs(drive.demand)


@pytest.mark.parametrize("joint", ["shoulder_pan", "gripper"])
def test_what_follows_into_something_yields_and_keeps_its_torque(bench, joint):
    rig = bench.open()
    bench.advance(1.0)
    i, way = (0, -0.4) if joint == "shoulder_pan" else (5, 0.3)
    at = bench.world.q[i] + way
    bench.world.put_wall(joint, *((at, math.inf) if way < 0.0 else (-math.inf, at)))
    following = rig.arm.follow() if i == 0 else rig.gripper.follow()
    target = rig.arm.q - [1.0, 0.0, 0.0, 0.0, 0.0] if i == 0 else 1.0
    blocked = 0
    for _ in range(500):
        if not following.future.done():
            following.aim(target)
        bench.advance(0.01)
        blocked += pushes(bench, joint) > 400
    assert isinstance(following.future.exception(), FollowingError)
    assert blocked < 80, "an overload is 80 % of the drive for 2 s"
    assert pushes(bench, joint) < 150
    assert rig.arm.state.fault is None
