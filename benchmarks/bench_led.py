"""Lead two guarded arms that face each other at 350 mm into each other.

Two leaders move at random, and two guarded followings in one cell follow them. Contact is judged by
other means than the guard (``solids.py``), at every tick: polytopes around the official solids, and
how near hulls and drawn triangles come, because the polytopes are a few millimetres too large.

What the guard costs: processor time of both arms' setpoints in a tick, less the median of that of
followings that are led alike with nothing to keep them off anything.

    python -m benchmarks.bench_led --ticks 100000
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from benchmarks._common import single_thread, summary, write
from benchmarks.bench_cell import T_LEFT_RIGHT, Tasks
from benchmarks.solids import Solids
from so101_motion.arm.cell import Cell
from so101_motion.common.clock import ManualClock
from so101_motion.common.geometry import SE3
from so101_motion.control.following import Following
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Setpoint
from so101_motion.rig.hardware_rig import Rig, open_simulated

BARE_TICKS = 10_000


def followings(ticks: int, seed: int) -> list[dict[str, object]]:
    """Two leaders drive two guarded followings into each other."""
    led, bare = Led(seed, guarded=True), Led(seed, guarded=False)
    led.go(ticks)
    bare.go(min(ticks, BARE_TICKS))
    guarded, alone = ([a + b for a, b in zip(*each.spent, strict=False)] for each in (led, bare))
    usual = float(np.median(alone))
    solids = led.solids
    return [
        {
            "what": f"two guarded followings, seed {seed}",
            "ticks": ticks,
            "touching": led.touching,
            "hulls nearest [mm]": 1e3 * solids.nearest_hulls,
            "triangles nearest [mm]": 1e3 * solids.nearest_triangles,
            "held by the other": led.held / (2 * ticks),
        },
        {"what": f"both setpoints of a tick, unguarded, seed {seed}, CPU", **summary(alone)},
        {"what": f"both setpoints of a tick, guarded, seed {seed}, CPU", **summary(guarded)},
        {
            "what": f"the guard adds for both arms, seed {seed}, CPU",
            **{key: value - usual for key, value in summary(guarded).items() if key != "n"},
            "bar": 0.0005,
        },
    ]


class Led:
    """Two leaders draw random motions that two followings take up.

    Attributes:
        spent: Processor time of each arm's setpoints, one of each in every tick [s].
        touching: In how many ticks polytopes touched.
        held: How often an arm was held by the other.
    """

    def __init__(self, seed: int, *, guarded: bool) -> None:
        self._tasks, self._guarded = Tasks(seed), guarded
        self.solids = Solids(SE3.identity(), T_LEFT_RIGHT)
        self.spent: list[list[float]] = [[], []]
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
            led = [self._opened(rig, clock) for rig in rigs]
            for following, times in zip(led, self.spent, strict=True):
                following.sample = _timed(following.sample, times)  # type: ignore
            left_for = [0, 0]
            for _ in range(ticks):
                for k, following in enumerate(led):
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
            for following in led:
                following.close()

    def _opened(self, rig: Rig, clock: ManualClock) -> Following:
        caps = MotionLimits.uniform(velocity=np.pi, acceleration=8.0, jerk=150.0)
        how = rig.arm.open_following if self._guarded else rig.arm.open_unguarded_following
        with ThreadPoolExecutor(1) as threads:
            done = threads.submit(how, limits=caps, stale_after=None, gate=10.0)
            while not done.done():
                clock.advance(0.01)
        return done.result()


def _timed(sample: Callable[[int], Setpoint], times: list[float]) -> Callable[[int], Setpoint]:
    def timed(k: int) -> Setpoint:
        begin = time.thread_time()
        try:
            return sample(k)
        finally:
            times.append(time.thread_time() - begin)

    return timed


def main() -> None:
    """Lead them, with two seeds."""
    single_thread()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ticks", type=int, default=100_000)
    asked = parser.parse_args()
    write("bench_led", [row for seed in (1, 2) for row in followings(asked.ticks // 2, seed)])


if __name__ == "__main__":
    main()
