"""Limp joints that pull softly at the hand that leads them; emulated servos."""

import numpy as np
import pytest

from so101_motion.common.errors import NoReply
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.feetech.hand_pull import Pull

SHARE = 0.15
TOWARD = (0.5, -0.5, 0.5, -0.5, 0.5)


@pytest.fixture
def limp(stand):
    """A limp arm without weight, found by a driver."""
    stand.look(0.1)
    return stand


def pull(limp):
    limp.arm.pull(Pull(toward=TOWARD, share=SHARE, until=limp.clock.now() + 0.2))


def limits(limp):
    return [limp.memory(i, reg.TORQUE_LIMIT) for i in range(1, 7)]


def shares(limp):
    """What each servo may use [0.1 %]."""
    return [int(on) * limit for on, limit in zip(limp.torque(), limits(limp), strict=True)]


def test_it_pulls_the_arm_joints_there_and_never_with_more_than_its_share(limp):
    before, most = limits(limp), 0
    for k in range(200):
        if k % 5 == 0:
            pull(limp)
        limp.look(0.01, 0.01)
        most = max(most, *shares(limp))
    assert shares(limp) == [1000 * SHARE] * 5 + [0]
    assert most == 1000 * SHARE
    np.testing.assert_allclose(limp.port.world.q[:5], TOWARD, atol=0.05)
    assert limp.port.world.q[5] == pytest.approx(0.0, abs=0.01)
    limp.look(0.3, 0.01)
    assert shares(limp) == [0] * 6, "nobody asks any more"
    assert limits(limp) == before


def test_nothing_moves_by_its_beginning(limp):
    before = limp.q.copy()
    pull(limp)
    assert shares(limp) == [1000 * SHARE] * 5 + [0]
    np.testing.assert_allclose(limp.port.world.q, before, atol=0.002)


def test_where_two_readings_do_not_agree_no_torque_comes_on(limp):
    limp.port.faults.loss = 1.0
    limp.look(0.2, 0.01)
    limp.port.faults.loss = 0.0
    with pytest.raises(NoReply):
        pull(limp)
    assert shares(limp) == [0] * 6


def rebooted(limp):
    limp.port.world.reboot(3)


def unplugged(limp):
    limp.port.unplugged = True
    limp.look(0.5, 0.01)
    limp.port.unplugged = False


def forgotten(limp):
    pass


def let_go(limp):
    limp.arm.set_torque(False)


def closed(limp):
    limp.arm.close()


@pytest.mark.parametrize("trouble", [rebooted, unplugged, forgotten, let_go, closed])
def test_it_ends_with_the_joints_limp_and_their_limits_as_before(limp, trouble):
    before = limits(limp)
    pull(limp)
    limp.look(0.1, 0.01)
    trouble(limp)
    limp.look(3.0, 0.05)
    assert shares(limp) == [0] * 6
    assert limits(limp) == before


def test_joints_that_are_held_from_then_on_have_all_their_strength(limp):
    before = limits(limp)
    pull(limp)
    limp.look(0.1, 0.01)
    reading = limp.arm.read()
    limp.arm.write(reading.q, reading.q_jaw)
    assert shares(limp) == [0] * 6
    limp.arm.set_torque(True)
    assert shares(limp) == before
    with pytest.raises(RuntimeError, match="held"):
        pull(limp)
