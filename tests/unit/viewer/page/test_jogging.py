"""Jogging the simulated arm: a held key moves it, a key that is no longer repeated stops it."""

import time

import numpy as np
import pytest
from so101_viewer.page.jogging import DEADMAN, PERIOD, SPEEDS, Jogging, read_held

from so101_motion.common.errors import Interrupted
from so101_motion.common.modes import Mode
from so101_motion.common.named_poses import POSES
from so101_motion.rig.simulated_rig import open_simulated

READY = next(pose.q for pose in POSES if pose.name == "ready")
PAN, X = np.array([1.0, 0, 0, 0, 0, 0, 0]), np.array([1.0, 0, 0, 0, 0, 0, 0])


class Hand:
    """A hand on the Jog tab, in simulated time."""

    def __init__(self, rig, clock):
        self.rig, self.clock = rig, clock
        self.target = None
        self.jogging = Jogging(rig, lambda: self.target)
        self.jogging.speed = "fast"

    def start(self, mode):
        self.jogging.start(mode)
        self.wait()

    def wait(self):
        ends = time.monotonic() + 60.0  # it loads its guard, which takes real time
        while not self.jogging.is_ready and time.monotonic() < ends:
            self.clock.advance(0.01)
        assert self.jogging.is_ready

    def hold(self, held, seconds):
        for _ in range(round(seconds / 0.025)):
            self.jogging.hold(held)
            self.clock.advance(0.025)

    @property
    def speed(self):
        return float(np.max(np.abs(self.rig.arm.state.qd_ref)))

    @property
    def slows_down(self):
        """Whether the next setpoint is slower, of the joint that is the fastest now."""
        before = self.rig.arm.state.qd_ref
        self.clock.advance(0.01)
        i = int(np.argmax(np.abs(before)))
        return bool(abs(self.rig.arm.state.qd_ref[i]) < abs(before[i]))


@pytest.fixture
def hand(clock):
    with open_simulated(clock=clock, q_start=READY) as rig:
        hand = Hand(rig, clock)
        yield hand
        hand.jogging.close()


@pytest.mark.parametrize("mode", ["joints", "base", "tool"])
def test_a_held_button_moves_and_without_repeats_stops_within_a_tenth_of_a_second(hand, mode):
    hand.jogging.speed = "medium"
    hand.hold(PAN, 0.5)
    np.testing.assert_array_equal(hand.rig.arm.state.q_ref, READY)  # it is not switched on
    hand.start(mode)
    hand.hold(PAN, 0.8)
    assert hand.speed > 0.1
    hand.clock.advance(DEADMAN + PERIOD)  # the window is lost: nothing more comes
    assert DEADMAN + PERIOD < 0.1
    assert hand.slows_down
    hand.clock.advance(1.0)
    assert hand.speed == 0.0
    hand.hold(PAN, 0.8)
    hand.jogging.release()  # let go: it stops at once
    hand.clock.advance(0.02)
    assert hand.slows_down


@pytest.mark.parametrize("mode", ["base", "tool"])
def test_the_tool_goes_along_the_axes_of_the_base_or_its_own_at_the_speed_chosen(hand, mode):
    hand.start(mode)
    hand.jogging.speed = "medium"
    hand.hold(X, 1.0)
    before = hand.rig.arm.T_base()
    axis = before.R[:, 0] if mode == "tool" else [1.0, 0.0, 0.0]
    hand.hold(X, 0.5)
    gone = hand.rig.arm.T_base().p - before.p
    np.testing.assert_allclose(gone, 0.5 * SPEEDS["medium"].going * np.array(axis), atol=0.002)


@pytest.mark.parametrize("mode", ["joints", "arrows"])
def test_no_joint_is_faster_than_the_speed_that_is_chosen(hand, mode):
    hand.jogging.speed = "slow"
    hand.target = READY
    hand.start(mode)
    for speed in ("slow", "medium"):
        if speed != hand.jogging.speed:
            hand.jogging.set_speed(speed)
            hand.wait()
        speeds = []
        for k in range(30):
            hand.target = READY + 0.02 * k
            hand.hold(PAN if mode == "joints" else np.zeros(7), 0.025)
            speeds.append(hand.speed)
        assert max(speeds) == pytest.approx(SPEEDS[speed].turning, rel=0.01)
        hand.clock.advance(1.0)
        hand.target = READY


def test_it_stops_before_the_floor_and_says_so(hand):
    hand.start("base")
    down = np.array([0, 0, -1.0, 0, 0, 0, 0])
    hand.hold(down, 6.0)
    assert any("floor" in each for each in hand.jogging.held_by)
    assert hand.speed < 0.01


def test_stop_switches_it_off_whatever_is_held(hand):
    hand.start("joints")
    hand.hold(PAN, 0.5)
    stopped = hand.rig.arm.start_stop()
    hand.hold(PAN, 1.0)
    assert stopped.done()
    assert hand.jogging.mode is None
    assert isinstance(hand.jogging.outcome, Interrupted)
    at = hand.rig.arm.state.q_ref
    hand.hold(PAN, 0.5)
    np.testing.assert_array_equal(hand.rig.arm.state.q_ref, at)
    assert hand.rig.arm.state.mode is Mode.HOLDING


def test_the_arm_follows_the_arrows_only_while_they_are_dragged(hand):
    hand.target = READY + 0.3
    hand.start("arrows")
    still = np.zeros(7)
    hand.hold(still, 0.5)  # the picture is turned, the target has not moved
    np.testing.assert_allclose(hand.rig.arm.state.q_ref, READY)
    hand.target = READY + 0.2
    hand.hold(still, 0.3)
    assert hand.speed > 0.0
    hand.clock.advance(2.0)  # let go on the way
    there = hand.rig.arm.state.q_ref
    assert hand.speed == 0.0
    assert 0.0 < np.max(np.abs(there - READY)) < 0.2


def test_the_jaw_closes_while_it_is_held(hand):
    hand.start("joints")
    opening = np.array([0, 0, 0, 0, 0, 0, 1.0])
    before = hand.rig.arm.state.q_jaw_ref
    hand.hold(opening, 0.3)
    assert hand.rig.arm.state.q_jaw_ref > before
    hand.clock.advance(1.0)
    at = hand.rig.arm.state.q_jaw_ref
    hand.clock.advance(0.5)
    assert hand.rig.arm.state.q_jaw_ref == at


@pytest.mark.parametrize(
    "text", ["", "3", "3 1 0 0", "3 1 0 0 0 0 0 nan", "3 2 0 0 0 0 0 0", "x y", "3 a 0 0 0 0 0 0"]
)
def test_a_browsers_message_is_read_and_nonsense_ignored(text):
    assert read_held(text) is None
    np.testing.assert_array_equal(read_held("12 1 0 0 -0.5 0 0 1"), [1, 0, 0, -0.5, 0, 0, 1])
