"""How many correct answers the driver doubts on a clean bus while the joints are treated roughly.

An arm with its weight is led fast by hand, limp and in manual mode, let fall, pushed while it
holds and held fast in mid-motion. The driver asks again for each answer that it does not believe,
which shows on the wire as a question to fewer than all six servos.
"""

import random

import numpy as np
from harness.direct_port import DirectPort

from campaign.torn_answers import POSITION, SYNC_READ, Joints
from so101_motion.common.clock import ManualClock
from so101_motion.common.compliance import Compliance
from so101_motion.common.errors import So101Error
from so101_motion.common.modes import Mode
from so101_motion.drivers.emulator.bus import Bus as EmulatedBus
from so101_motion.drivers.emulator.emulator import EmulatorOptions, build_world
from so101_motion.drivers.emulator.hand import Hand, parse_script
from so101_motion.planning.kinematics.model import RobotModel

GUIDED = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")


class CountingPort(DirectPort):
    """Counts positions that were sent, and asked for ``again``; the ``fastest`` joint [deg/s]."""

    name = "/dev/clean"

    def __init__(self, clock, gravity):
        self.world = build_world(EmulatorOptions(), t=clock.now(), gravity=gravity)
        super().__init__(EmulatedBus(self.world), clock.now)
        self.answers = self.again = 0
        self.fastest, self._seen = 0.0, (0.0, np.zeros(6))

    def passed(self, request, replies):
        if request[4] == SYNC_READ and request[5] == POSITION:
            self.answers += len(replies)
            self.again += len(replies) if len(request) - 8 < 6 else 0
            t, q = self._now(), np.degrees(self.world.q)
            if t > self._seen[0]:
                speed = np.max(np.abs(q - self._seen[1])) / (t - self._seen[0])
                self.fastest = max(self.fastest, float(speed))
            self._seen = t, q
        return super().passed(request, replies)


class RoughHandling(Joints):
    """One arm for some seconds."""

    def __init__(self, seed, gravity):
        self._rng, clock = random.Random(seed), ManualClock()
        super().__init__(CountingPort(clock, gravity), clock, gravity)

    def play(self):
        for act in self._rng.sample((self._fall, self._lead_limp, self._guide, self._blocked), 4):
            try:
                act()
            except So101Error:
                self.ticks(10)
            self.port.world.hand = Hand()
            if self._control.mode is not Mode.HOLDING and not self._control.is_moving:
                self.ticks(20)
                self._control.hold()
            while self._control.is_moving:
                self.ticks(1)

    def _fall(self):
        self._move(self._rng.choice(([0, -0.9, 0.9, 0, 0], [0, 0.8, -0.8, 0, 0])), 3.0)
        self._control.release()
        self.ticks(100, self._rng.choice((0.01, 0.05)))

    def _lead_limp(self):
        self._control.release()
        self._take_hold()
        self.ticks(150)

    def _guide(self):
        self._control.guide(Compliance())
        self._take_hold()
        self.ticks(150)

    def _blocked(self):
        joint = self._rng.choice(GUIDED)
        self._hand(f"0.1 {joint} start\n1.5 {joint} release")
        self._move([self._rng.uniform(-0.8, 0.8) for _ in range(5)], 2.0)

    def _take_hold(self):
        joint, speed = self._rng.choice(GUIDED), self._rng.uniform(50.0, 400.0)
        goal = self._rng.choice((-1, 1)) * self._rng.uniform(20.0, 60.0)
        t = 0.2 + 2.0 * abs(goal) / speed
        self._hand(
            f"0.1 {joint} start\n{0.1 + abs(goal) / speed} {joint} {goal}\n{t} {joint} {-goal}\n"
            f"{t + 0.1} {joint} release"
        )

    def _hand(self, script):
        self.port.world.advance(self._clock.now())
        self.port.world.hand = Hand(parse_script(script), self._clock.now())

    def _move(self, goal, velocity):
        self.begin(np.array(goal, dtype=float), velocity=velocity, acceleration=8.7, jerk=87.0)
        while self._control.is_moving:
            self.ticks(1)


def run(answers, seed):
    """Handle arms roughly until so many positions were sent: how many, doubted ones, top speed."""
    gravity, seen, again, fastest, episode = RobotModel.load().gravity_torque, 0, 0, 0.0, 0
    while seen < answers:
        handling = RoughHandling(seed * 1_000_000 + episode, gravity)
        handling.play()
        seen, again = seen + handling.port.answers, again + handling.port.again
        fastest, episode = max(fastest, handling.port.fastest), episode + 1
    return seen, again, fastest
