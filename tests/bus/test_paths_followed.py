"""Paths through waypoints, planned and played by the real rig on emulated servos with weight,
friction and play: the arm stays near the path, passes every waypoint, and ends at the goal.
"""

import math

import pytest
from harness.path_following import follow, random_plan

from so101_motion.drivers.emulator import registers as emu

# Time stands still while an answer is waited for; an emulator that the machine kept waiting must
# not be taken for a wire that lost it.
pytestmark = pytest.mark.emulated(reply_timeout=2.0)


def opened(bench, speed, acceleration):
    rig = bench.open()
    bench.advance(1.0)  # the weight is taken up
    rig.arm.set_speed(math.radians(speed))
    rig.arm.set_acceleration(math.radians(acceleration))
    return rig


def assert_followed(followed):
    assert followed.error < 3.0
    assert followed.final <= 0.4
    assert followed.missed < 3.0
    assert followed.lag < 0.02, "it is made up for at every speed"


def test_the_arm_stays_within_3_deg_of_its_path_at_full_speed(bench):
    """At its usual speed: tests/contract/test_arm.py."""
    rig = opened(bench, 180, 500)
    assert_followed(follow(bench, rig, *random_plan(rig, 2)))


def test_servos_that_another_program_left_with_more_acceleration_are_sent_no_further(bench):
    for servo in bench.world.servos:
        servo.memory.keep(emu.MAX_ACCELERATION, 254)
    rig = opened(bench, 180, 500)
    assert_followed(follow(bench, rig, *random_plan(rig, 3)))


@pytest.mark.emulated(reply_timeout=0.1)
def test_a_path_is_followed_on_a_bad_wire(bench):
    rig = opened(bench, 90, 300)
    bench.emulator.bus.faults.loss, bench.emulator.bus.faults.corrupt = 0.05, 0.02
    assert_followed(follow(bench, rig, *random_plan(rig, 4, waypoints=2)))
    health = rig.servos.health
    bench.emulator.bus.faults.loss = bench.emulator.bus.faults.corrupt = 0.0
    assert sum(one.lost + one.corrupt for one in health) > 20
