"""Limp joints that pull softly at the hand that leads them; emulated servos."""

import math

import numpy as np
import pytest

from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import NoReply
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.ticks import JointMap
from so101_motion.drivers.feetech.feetech_arm import JOINTS, FeetechArm
from so101_motion.drivers.feetech.hand_pull import Pull

MAPS = {joint: JointMap(servo_id=i) for i, joint in enumerate(JOINTS, start=1)}
SHARE = 0.15
TOWARD = (0.5, -0.5, 0.5, -0.5, 0.5)


class Limp:
    """A limp arm without weight, found by a driver."""

    def __init__(self, wired):
        self.clock = ManualClock()
        self.port = wired(now=self.clock.now)
        self.arm = FeetechArm(
            lambda: self.port,
            self.clock,
            MAPS,
            gravity=lambda q: np.zeros(6),
            speed=math.pi,
            acceleration=10.0,
            reply_timeout=0.0,
        )
        self.look(0.1)

    def look(self, seconds, dt=0.01):
        """Reads as the executor does, also in a fault; the most that a servo might use [0.1 %]."""
        most = 0
        for _ in range(round(seconds / dt)):
            try:
                self.arm.read()
            except Exception as error:
                self.raised = error
            self.clock.advance(dt)
            most = max(most, *self.shares())
        return most

    def pull(self, seconds=0.2):
        self.arm.pull(Pull(toward=TOWARD, share=SHARE, until=self.clock.now() + seconds))

    def shares(self):
        self.port.world.advance(self.clock.now())
        return [
            int(servo.drive.torque) * self.port.memory(i, reg.TORQUE_LIMIT)
            for i, servo in enumerate(self.port.world.servos, start=1)
        ]

    @property
    def limits(self):
        return [self.port.memory(i, reg.TORQUE_LIMIT) for i in range(1, 7)]


@pytest.fixture
def limp(wired):
    return Limp(wired)


def test_it_pulls_the_arm_joints_there_and_never_with_more_than_its_share(limp):
    before, most = limp.limits, 0
    for _ in range(40):
        limp.pull()
        most = max(most, limp.look(0.05))
    assert limp.shares() == [1000 * SHARE] * 5 + [0]
    assert most == 1000 * SHARE
    np.testing.assert_allclose(limp.port.world.q[:5], TOWARD, atol=0.05)
    assert limp.port.world.q[5] == pytest.approx(0.0, abs=0.01)
    limp.look(0.3)
    assert limp.shares() == [0] * 6, "nobody asks any more"
    assert limp.limits == before


def test_nothing_moves_by_its_beginning(limp):
    before = limp.port.world.q.copy()
    limp.pull()
    assert limp.shares() == [1000 * SHARE] * 5 + [0]
    np.testing.assert_allclose(limp.port.world.q, before, atol=0.002)


def test_where_two_readings_do_not_agree_no_torque_comes_on(limp):
    limp.port.faults.loss = 1.0
    limp.look(0.2)
    limp.port.faults.loss = 0.0
    with pytest.raises(NoReply):
        limp.pull()
    assert limp.shares() == [0] * 6


def rebooted(limp):
    limp.port.world.reboot(3)


def unplugged(limp):
    limp.port.unplugged = True
    limp.look(0.5)
    limp.port.unplugged = False


def forgotten(limp):
    pass


def let_go(limp):
    limp.arm.set_torque(False)


def closed(limp):
    limp.arm.close()


@pytest.mark.parametrize("trouble", [rebooted, unplugged, forgotten, let_go, closed])
def test_it_ends_with_the_joints_limp_and_their_limits_as_before(limp, trouble):
    before = limp.limits
    limp.pull()
    limp.look(0.1)
    trouble(limp)
    limp.look(3.0, 0.05)
    assert limp.shares() == [0] * 6
    assert limp.limits == before


def test_joints_that_are_held_from_then_on_have_all_their_strength(limp):
    before = limp.limits
    limp.pull()
    limp.look(0.1)
    reading = limp.arm.read()
    limp.arm.write(reading.q, reading.q_jaw)
    assert limp.shares() == [0] * 6
    limp.arm.set_torque(True)
    assert limp.shares() == before
    with pytest.raises(RuntimeError, match="held"):
        limp.pull()
