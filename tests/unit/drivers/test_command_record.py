"""The record of commands gets every command as it is sent."""

import math

import numpy as np
import pytest

from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.ticks import JointMap
from so101_motion.drivers.feetech.feetech_arm import JOINTS, FeetechArm
from so101_motion.drivers.simulated import SimArm

MAPS = {joint: JointMap(servo_id=i) for i, joint in enumerate(JOINTS, start=1)}


@pytest.fixture
def port(clock, wired):
    return wired(now=clock.now)


@pytest.fixture
def arm(clock, port):
    return FeetechArm(
        lambda: port,
        clock,
        MAPS,
        gravity=lambda q: np.array([0.0, -0.9, 0.0, 0.0, 0.0, 0.0]),
        speed=math.pi,
        acceleration=10.0,
        reply_timeout=0.0,
    )


def test_goals_that_make_up_for_weight_are_shown_beside_the_bare_command(clock, port, arm):
    seen = []
    arm.on_command = seen.append
    reading = arm.read()
    arm.write(reading.q, reading.q_jaw)
    arm.set_torque(True)
    assert [(one.is_seed, list(one.goals)) for one in seen] == [(True, [i]) for i in range(1, 7)]
    clock.advance(0.01)
    arm.write(np.full(5, 0.002), 0.0)
    last = seen[-1]
    assert (last.t, last.q_cmd, last.q_jaw_cmd) == (clock.now(), (0.002,) * 5, 0.0)
    assert last.goals == {i: port.memory(i, reg.GOAL_POSITION) for i in range(1, 7)}
    assert last.goals[2] < last.goals[1] == 2049
    assert not last.is_seed
    assert not last.is_guided


def test_a_simulated_arm_shows_its_commands_too(clock):
    seen = []
    arm = SimArm(clock)
    arm.on_command = seen.append
    arm.write(np.zeros(5), 0.1)
    arm.set_torque(True)
    clock.advance(0.01)
    arm.write(np.full(5, 0.002), 0.1)
    assert [(one.t, one.q_cmd, one.q_jaw_cmd, one.is_seed) for one in seen] == [
        (0.0, (0.0,) * 5, 0.1, True),
        (0.01, (0.002,) * 5, 0.1, False),
    ]
