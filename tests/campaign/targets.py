"""Targets of every kind for an arm that follows them, on emulated servos and simulated time.

The real rig, with one target or more in each control cycle. Laws: no two bodies touch, as commanded
and as the joints truly are; every refusal is one of ours; the following goes on to the end, and the
arm rests within a second after it; the referee objects to nothing.
"""

import math
import random
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from harness.emulated_rig import hardware_bench

from so101_motion.common.errors import So101Error
from so101_motion.control.following import APPROACH
from so101_motion.planning.collision.collision import CollisionModel

READY = np.radians([0.0, -45.0, 45.0, 60.0, 0.0])
REST = 1.0  # [s], within which the arm must rest after the last target
SETTLED = 3.0  # [s], within which it must say so: friction may hold a joint off its place for two


@dataclass
class Outcome:
    """What came of an attack.

    Attributes:
        sent: How many targets of each kind were sent.
        refused: How many were refused.
        contacts: What touched what.
        broken: Other laws that were broken.
        nearest: The smallest distance of two bodies, as commanded [m].
        travelled: How far the joint that moved most has gone, over all cycles [deg].
        seconds: How much time passed for the arm [s].
    """

    sent: Counter = field(default_factory=Counter)
    refused: int = 0
    contacts: list = field(default_factory=list)
    broken: list = field(default_factory=list)
    nearest: float = math.inf
    travelled: float = 0.0
    seconds: float = 0.0

    def look(self, collision, bench, rig, kind, q_before):
        """Note how far the arm has gone, and what touches what; where it is wanted now."""
        state = rig.arm.state
        self.travelled += math.degrees(np.abs(state.q_ref - q_before).max())
        distances = collision.distances(state.q_ref, state.q_jaw)
        self.nearest = min(self.nearest, float(distances.min()))
        true = np.radians(bench.arm_deg(rig))
        for how, q in (("commanded", state.q_ref), ("true", true)):
            clearance = collision.clearance(q, state.q_jaw)
            if clearance.distance <= 0.0:
                self.contacts.append(f"{kind}, {how}: {clearance.message('is')}")
        return state.q_ref


class Leader:
    """Makes up targets, some cycles of one kind after some of another."""

    def __init__(self, seed, lower, upper):
        self._rng, self._lower, self._upper = random.Random(seed), lower, upper
        self._kinds = [
            getattr(self, name) for name in sorted(vars(Leader)) if name.startswith("to_")
        ]

    def bout(self):
        """A kind, and a function that makes its targets from where the arm is wanted."""
        kind = self._rng.choice(self._kinds)
        places = [self._place(), self._place()]
        return kind.__name__, self._rng.randint(1, 60), lambda k, q: kind(k, q, *places)

    def _place(self):
        return np.array(
            [self._rng.uniform(*each) for each in np.stack((self._lower, self._upper), axis=1)]
        )

    # Each: the cycle, where the arm is wanted, two places -> targets of this cycle

    def to_a_place(self, k, q, there, other):
        return [there]

    def to_places_60_deg_apart(self, k, q, there, other):
        return [q + np.radians(60.0) * np.sign(other) * (-1) ** (k // 10)]

    def to_two_places_in_turn(self, k, q, there, other):
        return [(there, other)[k % 2]]

    def to_places_all_over(self, k, q, there, other):
        return [self._place() for _ in range(self._rng.randint(1, 3))]

    def to_places_out_of_range(self, k, q, there, other):
        return [10.0**3 * there, 2.0 * other]

    def to_the_table(self, k, q, there, other):
        return [np.array([there[0], *np.radians([75.0, -20.0, 60.0]), there[4]])]

    def to_itself(self, k, q, there, other):
        return [np.array([there[0], *np.radians([-95.0, 90.0, 95.0]), there[4]])]

    def to_nowhere_in_motion(self, k, q, there, other):
        return [there] if k < 8 else []

    def to_what_is_no_place(self, k, q, there, other):
        wrong = there.copy()
        wrong[k % 5] = (math.nan, math.inf, -math.inf)[k % 3]
        return [there, wrong, there[:4], None]

    def to_a_place_that_races(self, k, q, there, other):
        return [(there, 50.0 * other)]

    def to_a_place_that_sways(self, k, q, there, other):
        s, c = 0.4 * np.sin(0.05 * k), 0.4 * np.cos(0.05 * k)
        return [(there + s, np.full(5, 5.0 * c), np.full(5, -25.0 * s))]

    def to_a_place_that_says_what_is_not_so(self, k, q, there, other):
        return [(q + 0.05 * other, 2.0 * other, 1e3 * (-1) ** k * other)]

    def to_and_fro_nearby(self, k, q, there, other):
        return [q + [self._rng.gauss(0.0, 0.1) for _ in range(5)]]


def attack(folder, *, seed, count, fast=False):
    """Send ``count`` targets or a few more; what came of them.

    ``fast``: at the highest caps that can be configured, and without an approach.
    """
    outcome = Outcome()
    with hardware_bench(folder) as bench:
        rig = bench.open()
        bench.advance(0.5)
        bench.finish(bench.go(rig, *np.degrees(READY)))
        arm, collision = rig.arm, CollisionModel(rig.arm.model)
        leader = Leader(seed, *arm.range)
        if fast:
            arm.set_speed(math.pi)
            arm.set_acceleration(math.radians(500.0))
        following = arm.follow(approach=arm.limits if fast else APPROACH)
        begin, q_before = bench.clock.now(), arm.state.q_ref
        while sum(outcome.sent.values()) < count and not outcome.broken:
            kind, cycles, targets = leader.bout()
            for k in range(cycles):
                for target in targets(k, arm.state.q_ref):
                    _send(following, kind, target, outcome)
                bench.advance(0.01)
                q_before = outcome.look(collision, bench, rig, kind, q_before)
            if following.future.done():
                outcome.broken.append(f"it ended: {following.future.exception()!r}")
        bench.advance(REST)
        outcome.seconds = bench.clock.now() - begin
        if np.any(arm.state.qd_ref):
            outcome.broken.append("it does not rest though nobody leads it")
        ending = following.close()
        bench.advance(SETTLED)
        if not ending.done() or ending.exception() is not None:
            outcome.broken.append(f"it does not close: {ending.done() and ending.exception()!r}")
    return outcome


def _send(following, kind, target, outcome):
    outcome.sent[kind] += 1
    try:
        taken = following.aim(*target if isinstance(target, tuple) else (target,), most=math.inf)
    except So101Error:
        outcome.refused += 1
    else:
        if not np.all(np.isfinite(taken)):
            outcome.broken.append(f"{target} was taken as {taken}")
