"""Let two guarded arms that face each other at 350 mm follow targets into each other.

Two leaders move at random, and two guarded followings in one cell follow them. Contact is judged by
other means than the guard (``solids.py``), at every tick: polytopes around the official solids, and
how near hulls and drawn triangles come, because the polytopes are a few millimetres too large.

What the guard costs: processor time of both arms in a tick, inside the four calls by which a
following asks its guard and its cell. Beside it the whole of both setpoints, and the same for
followings of the same kind with nothing to keep them off anything. As in the module, the garbage
collector ignores what was there before. A busy machine makes some answers late, so where one took
long the same is asked again: the quickest answer is what the question costs.

What a hand costs that guides one arm into another, in the call by which the driver asks how far it
may lead the joints (``GuidingWall``): while the arms are apart, near each other, and overlap. In
the same run, what it takes to prove that the arm may stop there, which the wall once asked for.

The same with emulated arms (``emulated_followings.py``): the referee of the tests listens on both
wires and objects to nothing, and distances are those of the true poses of the joints.
``--emulated`` says for how many ticks; ``--only-emulated`` and ``--only-guided``, which is the
hand, do nothing else and keep the file's other rows.

    python -m benchmarks.bench_arms_apart --ticks 100000
"""

from __future__ import annotations

import argparse
import gc
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import numpy as np

from benchmarks._common import from_tests, single_thread, summary, update, write
from benchmarks.bench_cell import T_LEFT_RIGHT, Tasks
from benchmarks.emulated_followings import emulated_followings
from benchmarks.solids import Solids
from so101_motion.arm.arm import SCENE
from so101_motion.arm.cell import Cell
from so101_motion.arm.cell_member import CellMember
from so101_motion.arm.motion_handle import Motion
from so101_motion.arm.open_ended_motions import GuidingWall
from so101_motion.common.clock import ManualClock
from so101_motion.common.geometry import SE3
from so101_motion.control.following import Following
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.differential.guard import Guard
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Setpoint
from so101_motion.rig.rig import Rig
from so101_motion.rig.simulated_rig import open_simulated

BARE_TICKS = 10_000

LONG, TIMES = 1e-4, 4
"""What takes longer than this [s] is asked again, so many times in all; chosen."""

WAY, TREMBLE = 300, 1e-3
"""Ticks in which a hand leads an arm from one configuration to another, and how unevenly [rad]."""

PROOFS = 10
"""Ticks after which it is measured what a proof would take instead."""

ASKED = ((Guard, "within_reach"), (Guard, "admits"), (CellMember, "near"), (CellMember, "admits"))
"""What a following asks its guard and its cell in a tick."""


def followings(ticks: int, seed: int) -> list[dict[str, object]]:
    """Two leaders drive two guarded followings into each other."""
    both, bare = FollowingPair(seed, guarded=True), FollowingPair(seed, guarded=False)
    both.go(ticks)
    bare.go(min(ticks, BARE_TICKS))
    guarded, alone, asking = map(_of_both, (both.spent, bare.spent, both.asking))
    quickest = _of_both(both.quickest)
    solids = both.solids
    return [
        {
            "what": f"two guarded followings, seed {seed}",
            "ticks": ticks,
            "touching": both.touching,
            "hulls nearest [mm]": 1e3 * solids.nearest_hulls,
            "triangles nearest [mm]": 1e3 * solids.nearest_triangles,
            "held by the other": both.held / (2 * ticks),
        },
        {"what": f"both setpoints of a tick, unguarded, seed {seed}, CPU", **summary(alone)},
        {"what": f"both setpoints of a tick, guarded, seed {seed}, CPU", **summary(guarded)},
        {
            "what": f"inside the guard, both arms, seed {seed}, CPU",
            **summary(asking),
            "bar": 0.0005,
        },
        {
            "what": f"inside the guard, asked again where it took long, seed {seed}, CPU",
            **summary(quickest),
            "bar": 0.0005,
            "longest, in medians of both setpoints, unguarded": max(quickest) / np.median(alone),
        },
    ]


def guided(ticks: int, seed: int) -> list[dict[str, object]]:
    """A hand leads an arm again and again into another that faces it."""
    tasks, facing, bodies = Tasks(seed), from_tests("harness.facing_arms"), bodies_of()
    took = {how: list[list[float]]() for how in ("apart", "within 20 mm", "overlapping")}
    proof = {how: list[float]() for how in took}
    with ExitStack() as stack:
        arms = facing.FacingArms(stack).arms
        arm, clock = arms["left"], arms["right"].cell_member.clock
        guard = Guard(CollisionModel(arm.model, arm.scene), lambda: arm.state.q_jaw_ref)
        wall = GuidingWall(guard, arm.cell_member)
        gc.collect()
        gc.freeze()
        while sum(map(len, took.values())) < ticks:
            _finish(clock, arms["right"].retarget(tasks.near(), guard=None))
            q_jaw, other = arm.state.q_jaw_ref, arms["right"].state
            q_other = np.append(other.q_ref, other.q_jaw_ref)
            for k, q in enumerate(np.linspace(facing.ASIDE, tasks.near(), WAY)):
                q_guided = q + tasks.random.normal(0.0, TREMBLE, (2, 5))  # as the driver asks
                times = _asked_again(wall, q, q_guided)
                room = facing.distance(bodies, np.append(q, q_jaw), q_other)
                how = "overlapping" if room <= 0.0 else "within 20 mm" if room < 0.02 else "apart"
                took[how].append(times)
                if k % PROOFS == 0:
                    proof[how] += _asked_again(arm.cell_member.admits, np.array([q, q]), 0.01)[:1]
    return [
        {
            "what": f"a wall before another arm, {how}, seed {seed}, CPU",
            **summary([each[0] for each in times]),
            "bar": 0.0005,
            "longest, asked again [ms]": 1e3 * max(map(min, times)),
            "a proof takes, median [ms]": 1e3 * float(np.median(proof[how])),
            "a proof takes, p99 [ms]": 1e3 * float(np.percentile(proof[how], 99.0)),
        }
        for how, times in took.items()
    ]


def _finish(clock: ManualClock, motion: Motion) -> None:
    while not motion.future.done():
        clock.advance(0.01)


def _asked_again(ask: Callable[..., object], *args: object, **options: object) -> list[float]:
    """How long it takes to ask, the first time and again if that was long [s]."""
    times = list[float]()
    while not times or (times[0] > LONG and len(times) < TIMES):
        begin = time.thread_time()
        ask(*args, **options)
        times.append(time.thread_time() - begin)
    return times


def _of_both(spent: list[list[float]]) -> list[float]:
    return [one + other for one, other in zip(*spent, strict=False)]


class FollowingPair:
    """Two leaders draw random motions that two followings take up.

    Attributes:
        spent: Processor time of each arm's setpoints, one of each in every tick [s].
        asking: How much of it was spent inside the guard [s].
        quickest: The same, if each question that took long took as long as the quickest time.
        touching: In how many ticks polytopes touched.
        held: How often an arm was held by the other.
    """

    def __init__(self, seed: int, *, guarded: bool) -> None:
        self._tasks, self._guarded = Tasks(seed), guarded
        self.solids = Solids(SE3.identity(), T_LEFT_RIGHT)
        self.spent: list[list[float]] = [[], []]
        self.asking: list[list[float]] = [[], []]
        self.quickest: list[list[float]] = [[], []]
        self.touching = self.held = 0

    def go(self, ticks: int) -> None:
        """Go on for so many ticks."""
        clock, (starts, _) = ManualClock(), self._tasks.draw()
        with (
            open_simulated(clock=clock, q_start=starts[0]) as one,
            open_simulated(clock=clock, q_start=starts[1]) as other,
        ):
            if self._guarded:
                cell = Cell()
                cell.add("left", one, SE3.identity())
                cell.add("right", other, T_LEFT_RIGHT)
            rigs = one, other
            followings = [self._opened(rig, clock) for rig in rigs]
            lists = zip(followings, self.spent, self.asking, self.quickest, strict=True)
            for following, *each in lists:
                following.sample = _timed(following.sample, *each)  # type: ignore
            gc.collect()
            gc.freeze()
            left_for = [0, 0]
            for _ in range(ticks):
                for k, following in enumerate(followings):
                    if left_for[k] == 0:
                        following.aim(self._tasks.near())
                        left_for[k] = int(self._tasks.random.integers(10, 120))
                    left_for[k] -= 1
                    self.held += any("'s " in each for each in following.held_by)
                clock.advance(0.01)
                if self._guarded:
                    q = [np.append(rig.arm.state.q_ref, rig.arm.state.q_jaw) for rig in rigs]
                    self.touching += self.solids.touch(*q)
                    self.solids.measure(*q)
            for following in followings:
                following.close()

    def _opened(self, rig: Rig, clock: ManualClock) -> Following:
        caps = MotionLimits.uniform(velocity=np.pi, acceleration=8.0, jerk=150.0)
        guard = SCENE if self._guarded else None
        with ThreadPoolExecutor(1) as threads:
            done = threads.submit(
                rig.arm.follow, limits=caps, guard=guard, stale_after=None, gate=10.0
            )
            while not done.done():
                clock.advance(0.01)
        return done.result()


class _Asking(threading.local):
    """Processor time inside the guard in this thread's present setpoint [s]."""

    spent = quickest = again = 0.0


_ASKING = _Asking()


def _timed(
    sample: Callable[[int], Setpoint],
    spent: list[float],
    asking: list[float],
    quickest: list[float],
) -> Callable[[int], Setpoint]:
    def timed(k: int) -> Setpoint:
        _ASKING.spent = _ASKING.quickest = _ASKING.again = 0.0
        begin = time.thread_time()
        try:
            return sample(k)
        finally:
            spent.append(time.thread_time() - begin - _ASKING.again)
            asking.append(_ASKING.spent)
            quickest.append(_ASKING.quickest)

    return timed


def _time_asking(owner: type, name: str) -> None:
    ask = getattr(owner, name)

    def timed(*args: object, **options: object) -> object:
        answers = list[object]()
        times = _asked_again(lambda: answers.append(ask(*args, **options)))
        _ASKING.spent += times[0]
        _ASKING.quickest += min(times)
        _ASKING.again += sum(times[1:])
        return answers[-1]

    setattr(owner, name, timed)


def main() -> None:
    """Measure them, simulated with two seeds, and emulated."""
    single_thread()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ticks", type=int, default=100_000)
    parser.add_argument("--emulated", type=int, default=50_000)
    parser.add_argument("--only-emulated", action="store_true")
    parser.add_argument("--guided", type=int, default=20_000)
    parser.add_argument("--only-guided", action="store_true")
    asked = parser.parse_args()
    if asked.only_guided:
        update(
            "bench_arms_apart", [row for seed in (1, 2) for row in guided(asked.guided // 2, seed)]
        )
        return
    if asked.only_emulated:
        update("bench_arms_apart", emulated_followings(asked.emulated))
        return
    for owner, name in ASKED:
        _time_asking(owner, name)
    rows = [row for seed in (1, 2) for row in followings(asked.ticks // 2, seed)]
    by_hand = [row for seed in (1, 2) for row in guided(asked.guided // 2, seed)]
    write("bench_arms_apart", [*rows, *by_hand, *emulated_followings(asked.emulated)])


if __name__ == "__main__":
    main()
