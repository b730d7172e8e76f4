"""Random actions to the plugin's LeRobot robot, with faults among them, on emulated servos.

The plugin's robot is sent one action after another, some like the one before, while simulated time
passes. Laws: no two bodies touch, as commanded and as the joints truly are; nothing is raised but a
``ConnectionError``, after which the robot can be connected anew; no call takes more than
``LONGEST``; the arm rests within a second after the last action; the referee finds nothing.

The jaw stays as it is: its own motions are not checked for contact.
"""

import math
import random

import numpy as np
from harness.emulated_rig import MIDDLES_DEG
from harness.lerobot_bench import READY, action, lerobot_bench

from campaign.targets import REST, Outcome
from so101_motion.planning.collision.collision import CollisionModel

LONGEST = 70.0  # [s] of the arm's time; a way to the park pose may take 60
JAW = READY[5]


class Client:
    """Sends actions of a kind; each returns how long it waits afterwards [s]."""

    def __init__(self, bench, robot, rng, outcome):
        self.bench, self.robot, self.rng, self.outcome = bench, robot, rng, outcome
        self.kinds = [getattr(self, name) for name in sorted(dir(self)) if name.startswith("to_")]
        self.kinds += 3 * [self.to_places_60_deg_apart, self.to_a_place]  # most of them are these

    def place(self):
        lower, upper = (-110, -100, -95, -95, -160), (110, 95, 90, 95, 160)
        return [self.rng.uniform(*each) for each in zip(lower, upper, strict=True)]

    def here(self):
        values = self.call(self.robot.get_observation) or self.robot.get_observation()
        return np.array(list(values.values())[:5])

    def send(self, *values):
        self.call(lambda: self.robot.send_action(action(*values)))

    def call(self, what):
        begin = self.bench.clock.now()
        try:
            return what()
        except ConnectionError:
            self.outcome.refused += 1
            self.anew()
        finally:
            took = self.bench.clock.now() - begin
            self.outcome.longest = max(self.outcome.longest, took)

    def anew(self):
        """What a person does after an error: plug it in, and start the command again."""
        self.bench.emulator.plug()
        if self.robot.is_connected:
            self.robot.disconnect()
        self.bench.advance(0.5)
        self.robot.connect(calibrate=False)

    # Each: the how many-th of its bout, a place

    def to_a_place(self, k, there):
        self.send(*there, JAW)

    def to_places_60_deg_apart(self, k, there):
        here = self.here()
        self.send(*(here + 60.0 * np.sign(there) * (-1) ** (k // 5)), JAW)

    def to_what_is_no_number(self, k, there):
        there[k % 5] = (math.nan, math.inf, -math.inf, None, "far")[k % 5]
        self.send(*there, JAW)

    def to_a_place_of_some_joints(self, k, there):
        some = self.rng.sample(list(action(*there, JAW).items())[:5], k=self.rng.randint(0, 4))
        self.call(lambda: self.robot.send_action(dict(some)))

    def to_a_place_after_a_stall(self, k, there):
        self.bench.advance(self.rng.choice((0.1, 0.3, 1.0)))
        self.send(*there, JAW)

    def to_a_late_chunk_at_once(self, k, there):
        here = self.here()
        for share in np.linspace(0.0, 1.0, 20):
            self.send(*(here + share * (there - here)), JAW)

    def to_the_table(self, k, there):
        self.send(there[0], 75.0, -20.0, 60.0, there[4], JAW)

    def to_itself(self, k, there):
        self.send(there[0], -95.0, 90.0, 95.0, there[4], JAW)

    def to_places_out_of_range(self, k, there):
        self.send(*(100.0 * np.array(there)), JAW)

    def to_a_place_while_the_cable_is_out(self, k, there):
        if k % 15 == 0:
            self.bench.emulator.unplug()
            self.bench.advance(self.rng.choice((0.02, 0.1, 0.3)))
            self.bench.emulator.plug()
        self.send(*there, JAW)

    def to_a_place_and_gone(self, k, there):
        """The client ends in mid-motion, in order or by an exception, and comes again."""
        self.send(*there, JAW)
        if k % 30 == 7:
            self.bench.advance(0.2)
            self.call(self.robot.disconnect)
            self.bench.advance(0.3)
            self.robot.connect(calibrate=False)


def attack(folder, *, seed, count):
    """Send ``count`` actions or a few more; what came of them."""
    outcome, rng = Outcome(), random.Random(seed)
    start = np.radians(np.add(READY[:5], MIDDLES_DEG))
    with lerobot_bench(folder, q_start=(*start, 0.5)) as bench:
        robot = bench.connected()
        collision = CollisionModel(bench.rig.arm.model)
        client, q_before = Client(bench, robot, rng, outcome), bench.rig.arm.state.q_ref
        while outcome.sent.total() < count and not outcome.broken:
            kind = rng.choice(client.kinds)
            there = client.place()
            for k in range(rng.randint(1, 40)):
                try:
                    kind(k, list(there) if k % 20 else client.place())
                except Exception as error:
                    outcome.broken.append(f"{kind.__name__}: {error!r}")
                    break
                outcome.sent[kind.__name__] += 1
                bench.advance(rng.choice((0.01, 0.02, 0.03)))
                q_before = outcome.look(collision, bench, bench.rig, kind.__name__, q_before)
        bench.advance(REST + robot.config.stale_after_s)
        if np.any(bench.rig.arm.state.qd_ref):
            outcome.broken.append("it does not rest though nobody leads it")
        if outcome.longest > LONGEST:
            outcome.broken.append(f"a call took {outcome.longest:.1f} s")
    return outcome
