"""A session of two simulated arms on one clock that the test drives."""

from concurrent.futures import wait
from contextlib import contextmanager

import numpy as np
import pytest
from harness.facing_arms import in_time

from so101_motion.common.clock import ManualClock
from so101_motion.common.modes import Mode
from so101_motion.planning.goals import JointGoal
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.tasks.teleop import LocalArm, LocalFollower, LocalLeader, Teleop
from so101_motion.tasks.teleop.pilot import Phase

pytestmark = pytest.mark.usefixtures("planning_process")

AWAY = np.radians([30.0, -20.0, 10.0, 10.0, 20.0])


class Pair:
    """Two simulated arms, and a session."""

    def __init__(self, *, lets_go=True, guarded=False, **options):
        self.clock = ManualClock()
        self.leader, self.follower = (open_simulated(clock=self.clock) for _ in range(2))
        leading, following = (
            LocalArm(station=rig, jaw=rig) for rig in (self.leader, self.follower)
        )
        self.teleop = Teleop(
            LocalLeader(leading, lets_go=lets_go),
            LocalFollower(following, guarded=guarded),
            self.clock,
            **options,
        )

    @property
    def phase(self):
        return self.teleop.status.phase

    def push(self, q, q_jaw=None):
        """Move the limp leader by hand."""
        self.leader.executor.call(lambda arm: arm.push(q, q_jaw))

    def advance(self, seconds):
        for _ in range(round(seconds / 0.01)):
            self.clock.advance(0.01)
            if self.teleop.job is not None:
                wait([self.teleop.job], timeout=0.01)

    def until_ended_by(self, what):
        """Let time pass until the session's own thread has ended it and says why."""
        end = self.clock.now() + 20.0
        while self.teleop.status.is_running or not self.teleop.status.reason:
            assert self.clock.now() < end, "it does not end"
            self.advance(0.01)
        assert self.teleop.status.reason == f"ended by {what} of the follower"

    def start(self):
        """Start the session, in no time if it needs none."""
        self.run(self.teleop.start, patience=0.1)

    def run(self, call, patience=0.001):
        return in_time(self.clock, call, patience=patience)

    def close(self):
        self.run(self.teleop.close)
        self.teleop.close()
        self.leader.close()
        self.follower.close()


@contextmanager
def pair(**options):
    both = Pair(**options)
    try:
        yield both
    finally:
        both.close()


def test_the_follower_comes_mirrors_and_holds():
    with pair() as both:
        both.start()
        assert both.leader.arm.state.mode is Mode.LIMP
        both.advance(0.05)  # the leader has been read before somebody leads it
        both.push(AWAY, 0.5)
        both.advance(0.2)
        assert both.phase is Phase.WAITING, "so far so quickly: nobody leads like that"
        both.run(both.teleop.stop)
        both.start()
        both.advance(0.1)
        assert both.phase is Phase.APPROACHING
        cycles = both.teleop.status.cycles
        both.start()  # twice is once
        both.advance(3.0)
        assert both.teleop.status.cycles > cycles
        assert both.phase is Phase.MIRRORING
        assert both.follower.arm.state.q == pytest.approx(AWAY, abs=1e-3)
        assert both.follower.gripper.q_jaw == pytest.approx(0.5, abs=1e-3)
        both.run(both.teleop.stop)
        assert both.phase is Phase.STOPPED
        assert both.leader.arm.state.mode is Mode.HOLDING
        assert both.follower.arm.state.mode is Mode.HOLDING


def test_a_leader_that_is_not_let_go_of_may_be_moved_by_a_program():
    with pair(lets_go=False) as both:
        both.start()
        both.advance(0.2)
        assert not both.teleop.status.leader_is_limp
        motion = both.leader.arm.retarget(0.5 * AWAY)
        both.advance(3.0)
        assert motion.future.done()
        assert both.phase is Phase.MIRRORING
        assert both.follower.arm.state.q == pytest.approx(0.5 * AWAY, abs=2e-3)
        both.run(both.teleop.stop)
        assert both.leader.arm.state.mode is Mode.HOLDING


@pytest.mark.parametrize("planned", [False, True])
def test_another_motion_of_the_follower_ends_the_session(planned):
    with pair() as both:
        both.start()
        both.advance(0.2)
        arm, q = both.follower.arm, 0.3 * AWAY
        motion = arm.move(JointGoal(q=q), wait=False) if planned else arm.retarget(q)
        while not motion.future.done():
            both.advance(0.05)
        assert motion.future.exception() is None
        both.until_ended_by("a newer motion")
        assert arm.state.q == pytest.approx(q, abs=1e-3)


def test_a_stop_ends_a_session_whose_follower_waits_where_something_held_it_up():
    with pair() as both:
        driver = both.run(lambda: both.follower.executor.call(lambda driver: driver).result())
        both.start()
        both.advance(0.05)
        driver.jam("shoulder_pan")
        for share in np.linspace(0.0, 0.6, 60):
            both.push(share * AWAY)
            both.advance(0.02)
        both.advance(0.5)
        assert both.phase is Phase.WAITING
        both.run(both.follower.arm.stop)
        both.until_ended_by("stop")
