"""What a hand feels that guides the arm, where the arm stays, and what the walls keep it off.

Arms whose servos differ (spread 0.2) are guided by a hand that is a spring of limited torque, one
joint after the other. First in free space, there and back: the torque with which the hand leads the
joint at 30 deg/s, and how far the joint moves in the two seconds after it was let go. Then among
random obstacles, each time along a joint on whose way the arm would be in contact: how near it
came to that, for hands of different strength, and without walls. Distances are those of the true
joints. Pretended time.

The servos are emulated: fitted on recordings of one real servo, see ``docs/emulator.md``.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.drivers.emulator.hand import Hand, Waypoint
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Scene

SPEED = math.radians(30.0)
"""How fast the hand leads [rad/s]."""

FREE = math.radians(20.0)
"""How far it leads a joint there and back in free space [rad]."""

LEADING = 2.0 * FREE / SPEED
"""How long that takes [s]."""

BEYOND = math.radians(25.0)
"""How far beyond the first contact a hand wants to go [rad]."""

FARTHEST = math.radians(60.0)
"""Contact is looked for on the first part of a joint's way [rad]."""

AFTER = 2.0
"""How long a joint is watched once it is let go [s]."""

ROOM = 0.015
"""Least distance of the arm from the obstacles when a case begins [m]."""

READY = np.radians([0.0, -45.0, 45.0, 60.0, 0.0])
"""A configuration that is clear of everything."""

STRENGTHS = (1.5, 2.0, 4.0)
"""Torque of the hands that lead the arm into contact [N m]."""

_following: Any = _common.from_tests("harness.path_following")
_harness: Any = _common.from_tests("harness.emulated_rig")
_scenes: Any = _common.from_tests("harness.random_scenes")
_referee: Any = _common.from_tests("referee")


class FeltHand(Hand):
    """A hand that notes how hard it pulls."""

    def __init__(self, script: list[Waypoint], t: float, strength: float) -> None:
        super().__init__(script, t, strength=strength)
        self.pulls: list[tuple[float, float]] = []  # time [s], torque [N m]

    def torque(self, joint: str, t: float, q: float, qd: float) -> float:
        """As ``Hand.torque``."""
        pull = super().torque(joint, t, q, qd)
        if pull:
            self.pulls.append((t, pull))
        return pull


class Guided:
    """An arm that a hand guides."""

    def __init__(self, bench: Any) -> None:
        self.bench, self.rig = bench, bench.open()
        bench.advance(1.0)

    @property
    def q(self) -> Array:
        """Where the arm truly is, shape (5,), [rad]."""
        return np.asarray(np.radians(self.bench.arm_deg(self.rig)))

    def lead(self, i: int, ways: list[float], strength: float) -> tuple[FeltHand, list[Array]]:
        """Lead joint ``i`` by the ``ways`` [rad] from where it is, one after the other, and let go.

        Returns:
            The hand, and where the arm truly was, every 0.01 s; the last ``AFTER`` of it alone.
        """
        self.bench.emulator.advance()
        joint, here, t = ARM_JOINTS[i], float(self.bench.world.q[i]), 0.1
        script, at = [Waypoint(t=t, joint=joint)], 0.0
        for way in ways:
            t, at = t + abs(way - at) / SPEED, way
            script.append(Waypoint(t=t, joint=joint, q=here + way))
        script.append(Waypoint(t=t + 0.5, joint=joint, release=True))
        hand = FeltHand(script, self.bench.clock.now(), strength)
        self.bench.world.hand = hand
        places = []
        for _ in range(round((t + 0.5 + AFTER) / 0.01)):
            self.bench.advance(0.01)
            places.append(self.q)
        return hand, places


@contextmanager
def guided_arm(seed: int) -> Iterator[Guided]:
    """An emulated arm that differs from all others, watched by the referee."""
    with (
        _referee.refereed(("motion",)),
        tempfile.TemporaryDirectory() as folder,
        _harness.hardware_bench(Path(folder), reply_timeout=2.0, spread=0.2, seed=seed) as bench,
    ):
        yield Guided(bench)


Felt = tuple[str, float, float]
"""A joint, the torque of the hand that leads it [N m], how far it moved once let go [rad]."""


def in_free_space(seed: int, poses: int) -> list[Felt]:
    """Lead each joint there and back, in random poses."""
    found: list[Felt] = []
    with guided_arm(seed) as guided:
        for k in range(poses):
            for i, joint in enumerate(ARM_JOINTS):
                number = 1000 * seed + 5 * k + i
                plan, _ = _following.random_plan(guided.rig, number, waypoints=1)
                guided.bench.finish(guided.rig.arm.start_execute(plan), at_most=60.0)
                guided.rig.arm.set_manual(True, replace(guided.rig.arm.compliance, wall=0.0))
                hand, places = guided.lead(i, [FREE, 0.0], 5.0)
                begin = hand.pulls[0][0]
                leading = [abs(pull) for t, pull in hand.pulls if 0.3 < t - begin < LEADING]
                let_go = places[-round(AFTER / 0.01)]
                found.append((joint, float(np.median(leading)), abs(places[-1][i] - let_go[i])))
                guided.rig.arm.set_manual(False)
    return found


Led = tuple[float, float, float]
"""The least distance on the way, that at the end [m], how far the joint went back [rad]."""


def into_contact(seed: int, cases: int, strength: float, *, walls: bool) -> list[Led]:
    """Lead a joint of an arm among random obstacles beyond its first contact."""
    found: list[Led] = []
    rng = np.random.default_rng(seed)
    with guided_arm(seed) as guided:
        arm = guided.rig.arm
        while len(found) < cases:
            arm.scene = Scene()
            number = int(rng.integers(1 << 30))
            plan, _ = _following.random_plan(guided.rig, number, waypoints=1)
            guided.bench.finish(arm.start_execute(plan), at_most=60.0)
            guided.bench.advance(0.5)
            i, way, collision = _way_into_contact(guided, rng)
            arm.scene = collision.scene
            arm.set_manual(True, arm.compliance if walls else replace(arm.compliance, wall=0.0))
            _, places = guided.lead(i, [way], strength)
            rooms = [_room(collision, q, arm.state.q_jaw) for q in places]
            let_go = places[-round(AFTER / 0.01)]
            found.append((min(rooms), rooms[-1], float(abs(places[-1][i] - let_go[i]))))
            arm.set_manual(False)
            guided.bench.finish(arm.start_unguarded_retarget(READY))  # out of contact
    return found


def _way_into_contact(guided: Guided, rng: Any) -> tuple[int, float, CollisionModel]:
    """A joint, a way [rad] at whose end the arm would be in contact, and what with."""
    arm, q = guided.rig.arm, guided.q
    while True:
        collision = CollisionModel(arm.model, _scenes.random_scene(rng, count=4))
        i, side = int(rng.integers(5)), float(rng.choice([-1.0, 1.0]))
        if _room(collision, q, arm.state.q_jaw) < ROOM:
            continue
        for way in np.arange(0.0, FARTHEST, math.radians(1.0)):
            led = q.copy()
            led[i] += side * way
            if not arm.model.lower[i] < led[i] < arm.model.upper[i]:
                break
            if _room(collision, led, arm.state.q_jaw) < 0.0:
                return i, side * (way + BEYOND), collision


def _room(collision: CollisionModel, q: Array, q_jaw: float) -> float:
    return float(collision.distances(q, q_jaw).min())


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arms", type=int, default=4)
    parser.add_argument("--poses", type=int, default=3)
    parser.add_argument("--cases", type=int, default=25, help="for each arm and hand")
    asked = parser.parse_args()
    run = partial(_common.in_pieces, "bench_guide")
    arms = range(asked.arms)
    felt = [
        each
        for arm in run({f"free {k}": partial(in_free_space, k, asked.poses) for k in arms})
        for each in arm
    ]
    rows: list[dict[str, Any]] = []
    for joint in ARM_JOINTS:
        pulls, moved = zip(*(each[1:] for each in felt if each[0] == joint), strict=True)
        rows.append(
            {
                "what": f"{joint} led at 30 deg/s in free space",
                "hand, median [N m]": float(np.median(pulls)),
                "hand, most [N m]": max(pulls),
                "moved once let go, most [deg]": math.degrees(max(moved)),
            }
        )
    for strength, walls in (*((each, True) for each in STRENGTHS), (STRENGTHS[0], False)):
        name = f"a hand of {strength:g} N m, " + ("walls" if walls else "no walls")
        pieces = {
            f"{name} {k}": partial(into_contact, k, asked.cases, strength, walls=walls)
            for k in arms
        }
        led = np.array([each for arm in run(pieces) for each in arm])
        rows.append(
            {
                "what": f"led into contact by {name}",
                "cases": len(led),
                "in contact on the way": int(np.sum(led[:, 0] < 0.0)),
                "in contact at the end": int(np.sum(led[:, 1] < 0.0)),
                "least distance, median [mm]": 1000.0 * float(np.median(led[:, 0])),
                "least distance [mm]": 1000.0 * float(led[:, 0].min()),
                "went back once let go, most [deg]": math.degrees(float(led[:, 2].max())),
            }
        )
    _common.write("bench_guide", rows)


if __name__ == "__main__":
    main()
