"""What a hand feels that guides the arm, where the arm stays, and what the walls keep it off.

Arms whose servos differ (spread 0.2) are guided by a hand that is a spring of limited torque, one
joint after the other. First in free space, there and back: the torque with which the hand leads the
joint at 30 deg/s, and how far the joint moves in the two seconds after it was let go. Then as far
as a joint goes, with something in the jaws that the arm does not know, and once that was taken
away. Then among random obstacles, each time along a joint on whose way the arm would be in contact:
how near it came to that, for hands of different strength, and without walls. Then the same beside
another arm that faces it and rests in a random pose. Distances are those of the true joints.
Simulated time.

The servos are emulated: fitted on recordings of one real servo, see ``docs/emulator.md``.
``--only-arms`` measures only the part with two arms and keeps the file's other rows.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common
from so101_motion.arm.cell import Cell
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.drivers.emulator.hand import Hand, Waypoint
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Scene
from so101_motion.rig.simulated_rig import open_simulated

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

DRAWN = 100
"""How often something is drawn around an arm before it goes elsewhere; chosen."""

ROOM = 0.015
"""Least distance of the arm from the obstacles when a case begins [m]."""

READY = np.radians([0.0, -45.0, 45.0, 60.0, 0.0])
"""A configuration that is clear of everything."""

STRENGTHS = (1.5, 2.0, 4.0)
"""Torque of the hands that lead the arm into contact [N m]."""

_following: Any = _common.from_tests("harness.path_following")
_facing: Any = _common.from_tests("harness.facing_arms")
_harness: Any = _common.from_tests("harness.emulated_rig")
_scenes: Any = _common.from_tests("harness.random_scenes")
_referee: Any = _common.from_tests("referee.official")


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
def guided_arm(seed: int, held_kg: float = 0.0) -> Iterator[Guided]:
    """An emulated arm that differs from all others, watched by the referee."""
    options = dict(reply_timeout=2.0, spread=0.2, seed=seed, held_kg=held_kg)
    with (
        _referee.refereed(("motion",)),
        tempfile.TemporaryDirectory() as folder,
        _harness.hardware_bench(Path(folder), **options) as bench,
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
                guided.bench.finish(guided.rig.arm.move(plan, wait=False), at_most=60.0)
                guided.rig.arm.set_manual(True, replace(guided.rig.arm.compliance, wall=0.0))
                hand, places = guided.lead(i, [FREE, 0.0], 5.0)
                begin = hand.pulls[0][0]
                leading = [abs(pull) for t, pull in hand.pulls if 0.3 < t - begin < LEADING]
                let_go = places[-round(AFTER / 0.01)]
                found.append((joint, float(np.median(leading)), abs(places[-1][i] - let_go[i])))
                guided.rig.arm.set_manual(False)
    return found


LOADS = (0.0, 0.1, 0.2, 0.3)
"""Masses in the jaws, which the arms do not know [kg]."""


def guided_far(seed: int, cases: int, held_kg: float, *, taken: bool) -> list[tuple[float, float]]:
    """Lead a joint of an arm anywhere within its limits, with something in the jaws or after it.

    Returns:
        How far any joint moved untouched once manual mode had begun, and once it was let go [rad].
    """
    found: list[tuple[float, float]] = []
    rng = np.random.default_rng(seed)
    for k in range(cases):
        with guided_arm(1000 * seed + k, held_kg) as guided:
            arm = guided.rig.arm
            plan, _ = _following.random_plan(guided.rig, int(rng.integers(1 << 30)), waypoints=1)
            guided.bench.finish(arm.move(plan, wait=False), at_most=60.0)
            guided.bench.advance(1.0)
            arm.set_manual(True, replace(arm.compliance, wall=0.0))
            guided.bench.advance(0.3)
            if taken:
                guided.bench.world.gravity = arm.model.gravity_torque
            before = guided.q
            guided.bench.advance(AFTER)
            untouched = float(np.abs(guided.q - before).max())
            i = int(rng.integers(5))
            wanted = rng.uniform(arm.model.lower[i] + 0.1, arm.model.upper[i] - 0.1)
            _, places = guided.lead(i, [wanted - guided.q[i]], STRENGTHS[1])
            after = np.abs(np.array(places[-round(AFTER / 0.01) :]) - places[-round(AFTER / 0.01)])
            found.append((untouched, float(after.max())))
    return found


class Obstacles:
    """Random obstacles around a guided arm, which it knows."""

    def __init__(self, guided: Guided) -> None:
        self._guided, self._drawn = guided, Scene()

    def clear(self) -> None:
        """Take them away."""
        self._guided.rig.arm.scene = Scene()

    def draw(self, rng: Any) -> Callable[[Array], float]:
        """Draw others; how far they, or the arm itself, are at a configuration [m]."""
        arm = self._guided.rig.arm
        self._drawn = _scenes.random_scene(rng, count=4)
        return partial(_room, CollisionModel(arm.model, self._drawn), q_jaw=arm.state.q_jaw)

    def put(self) -> None:
        """Put there what was drawn."""
        self._guided.rig.arm.scene = self._drawn

    def is_in_the_way(self, q: Array) -> bool:
        """Always: the table and the arm itself count as well."""
        return True


class OtherArm:
    """A simulated arm that faces a guided arm, in one cell with it, each time in another pose."""

    def __init__(self, guided: Guided, other: Any, seed: int) -> None:
        self._guided, self._other, self._cell = guided, other, Cell()
        self._itself = CollisionModel(guided.rig.arm.model, Scene())
        self._cell.add("guided", guided.rig, SE3.identity())
        self._poses, self._drawn, self._is_there = _facing.Facing(seed), READY, False

    def clear(self) -> None:
        """Take it away."""
        if self._is_there:
            self._cell.remove("other", self._other)
        self._is_there = False

    def draw(self, _rng: Any) -> Callable[[Array], float]:
        """Draw a pose; how far it is from a configuration of the guided arm [m]."""
        self._drawn = self._poses.near()
        q_jaw = self._guided.rig.arm.state.q_jaw
        q_other = np.append(self._drawn, self._other.arm.state.q_jaw)
        return lambda q: float(_facing.distance(bodies_of(), np.append(q, q_jaw), q_other))

    def put(self) -> None:
        """Put the other arm there."""
        self._guided.bench.finish(self._other.arm.retarget(self._drawn, guard=None))
        self._cell.add("other", self._other, _facing.T_LEFT_RIGHT)
        self._is_there = True

    def is_in_the_way(self, q: Array) -> bool:
        """Whether nothing else would be touched, such as the table."""
        return _room(self._itself, q, self._guided.rig.arm.state.q_jaw) > 0.0


@contextmanager
def beside_another(seed: int) -> Iterator[tuple[Guided, OtherArm]]:
    """An emulated arm that a hand guides, and a simulated one that faces it."""
    with (
        guided_arm(seed) as guided,
        open_simulated(clock=guided.bench.clock, speed=math.pi, acceleration=8.0) as other,
    ):
        yield guided, OtherArm(guided, other, seed)


@contextmanager
def among_obstacles(seed: int) -> Iterator[tuple[Guided, Obstacles]]:
    """An emulated arm that a hand guides among random obstacles."""
    with guided_arm(seed) as guided:
        yield guided, Obstacles(guided)


Contact = tuple[float, float, float]
"""The least distance on the way, that at the end [m], how far the joint went back [rad]."""


def into_contact(
    place: Callable[[int], Any], seed: int, cases: int, strength: float, *, walls: bool
) -> list[Contact]:
    """Lead a joint of an arm beyond its first contact with what is around it."""
    found: list[Contact] = []
    rng = np.random.default_rng(seed)
    with place(seed) as (guided, around):
        arm = guided.rig.arm
        while len(found) < cases:
            around.clear()
            number = int(rng.integers(1 << 30))
            plan, _ = _following.random_plan(guided.rig, number, waypoints=1)
            guided.bench.finish(arm.move(plan, wait=False), at_most=60.0)
            guided.bench.advance(0.5)
            found_way = _way_into_contact(guided, around, rng)
            if found_way is None:
                continue
            i, way, room = found_way
            around.put()
            arm.set_manual(True, arm.compliance if walls else replace(arm.compliance, wall=0.0))
            _, places = guided.lead(i, [way], strength)
            rooms = [room(q) for q in places]
            let_go = places[-round(AFTER / 0.01)]
            found.append((min(rooms), rooms[-1], float(abs(places[-1][i] - let_go[i]))))
            arm.set_manual(False)
            around.clear()
            guided.bench.finish(arm.retarget(READY, guard=None))  # out of contact
    return found


def _way_into_contact(
    guided: Guided, around: Any, rng: Any
) -> tuple[int, float, Callable[[Array], float]] | None:
    """A joint, a way [rad] at whose end the arm would be in contact, and the distance from that.

    None if nothing is within reach from where the arm is now.
    """
    arm, q = guided.rig.arm, guided.q
    for _ in range(DRAWN):
        room = around.draw(rng)
        i, side = int(rng.integers(5)), float(rng.choice([-1.0, 1.0]))
        if room(q) < ROOM:
            continue
        for way in np.arange(0.0, FARTHEST, math.radians(1.0)):
            q_guided = q.copy()
            q_guided[i] += side * way
            inside = arm.model.lower[i] < q_guided[i] < arm.model.upper[i]
            if not inside or not around.is_in_the_way(q_guided):
                break
            if room(q_guided) < 0.0:
                return i, side * (way + BEYOND), room
    return None


def _room(collision: CollisionModel, q: Array, q_jaw: float) -> float:
    return float(collision.distances(q, q_jaw).min())


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arms", type=int, default=4)
    parser.add_argument("--poses", type=int, default=3)
    parser.add_argument("--cases", type=int, default=25, help="for each arm and hand")
    parser.add_argument("--only-arms", action="store_true")
    asked = parser.parse_args()
    beside = guided_into_contact("another arm", beside_another, asked.arms, asked.cases)
    if asked.only_arms:
        _common.update("bench_guide", beside)
        return
    felt = felt_in_free_space(asked.arms, asked.poses)
    far = guided_anywhere(asked.arms, asked.cases)
    among = guided_into_contact("obstacles", among_obstacles, asked.arms, asked.cases)
    _common.write("bench_guide", [*felt, *far, *among, *beside])


def felt_in_free_space(arms: int, poses: int) -> list[dict[str, Any]]:
    """A row for each joint."""
    run = partial(_common.in_pieces, "bench_guide")
    felt = [
        each
        for arm in run({f"free {k}": partial(in_free_space, k, poses) for k in range(arms)})
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
    return rows


def guided_anywhere(arms: int, cases: int) -> list[dict[str, Any]]:
    """A row for each mass in the jaws, and for one that was taken away."""
    rows: list[dict[str, Any]] = []
    for held_kg, taken in (*((each, False) for each in LOADS), (LOADS[-1], True)):
        name = f"led anywhere with {held_kg:g} kg" + (", which was taken away" if taken else "")
        pieces = {
            f"{name} {k}": partial(guided_far, k, cases, held_kg, taken=taken) for k in range(arms)
        }
        found = [each for arm in _common.in_pieces("bench_guide", pieces) for each in arm]
        untouched, let_go = zip(*found, strict=True)
        rows.append(
            {
                "what": name,
                "cases": len(found),
                "moved untouched, most [deg]": math.degrees(max(untouched)),
                "moved once let go, most [deg]": math.degrees(max(let_go)),
            }
        )
    return rows


def guided_into_contact(
    what: str, place: Callable[[int], Any], arms: int, cases: int
) -> list[dict[str, Any]]:
    """A row for each hand."""
    rows: list[dict[str, Any]] = []
    for strength, walls in (*((each, True) for each in STRENGTHS), (STRENGTHS[0], False)):
        name = f"{what} by a hand of {strength:g} N m, " + ("walls" if walls else "no walls")
        pieces = {
            f"{name} {k}": partial(into_contact, place, k, cases, strength, walls=walls)
            for k in range(arms)
        }
        found = np.array([each for arm in _common.in_pieces("bench_guide", pieces) for each in arm])
        rows.append(
            {
                "what": f"led into {name}",
                "cases": len(found),
                "in contact on the way": int(np.sum(found[:, 0] < 0.0)),
                "in contact at the end": int(np.sum(found[:, 1] < 0.0)),
                "least distance, median [mm]": 1000.0 * float(np.median(found[:, 0])),
                "least distance [mm]": 1000.0 * float(found[:, 0].min()),
                "went back once let go, most [deg]": math.degrees(float(found[:, 2].max())),
            }
        )
    return rows


if __name__ == "__main__":
    main()
