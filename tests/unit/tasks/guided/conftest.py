"""A simulated arm that a hand leads, on a clock that the test drives."""

from concurrent.futures import wait

import numpy as np
import pytest

from so101_motion.rig.simulated_rig import open_simulated


@pytest.fixture(scope="package", autouse=True)
def planned(planning_process):
    """All tests here plan."""


class Guest:
    """A rig and the hand that leads it.

    Attributes:
        rig: A simulated arm.
        goals: What it was sent: rows of time, five joints and the jaw [rad].
    """

    def __init__(self, rig, clock):
        self.rig, self.clock = rig, clock
        self.goals = []
        rig.executor.listen(self._note)

    def _note(self, state):
        if not self.goals or state.t > self.goals[-1][0]:
            self.goals.append((state.t, *state.q_ref, state.q_jaw_ref))

    def lead(self, *way_deg, seconds=1.0):
        """The hand leads the arm along corners [deg], each in so many seconds."""
        here = self.rig.arm.state.q
        for corner in way_deg:
            there = np.radians(np.array(corner, dtype=float))
            for share in np.linspace(0.0, 1.0, round(seconds / 0.01))[1:]:
                q = here + share * (there - here)
                self.rig.executor.call(lambda driver, q=q: driver.push(q))
                self.clock.advance(0.01)
            here = there

    def finish(self, motion, at_most=60.0):
        """Let time pass until a motion is over."""
        begin = self.clock.now()
        # While nothing moves, its own thread or a planner may be at work, in real time.
        arm = self.rig.arm
        while not wait([motion.future], timeout=0.0005 if arm.state.arm_moving else 0.01).done:
            assert self.clock.now() - begin < at_most, "it never ended"
            self.clock.advance(0.01)
        motion.result()

    def sent(self, since):
        """Times, arm joints [deg] and jaw [rad] sent since then."""
        rows = np.array([row for row in self.goals if row[0] >= since - 1e-9])
        return rows[:, 0], np.degrees(rows[:, 1:6]), rows[:, 6]


@pytest.fixture
def guest(clock):
    with open_simulated(clock=clock) as rig:
        yield Guest(rig, clock)
