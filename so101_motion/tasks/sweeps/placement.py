"""Find the bases from which a task is done best: screen, plan the promising ones, refine.

How it works. The first round screens a coarse lattice of bases. Screening gives a bound that no
plan can beat (``mounted_arm.py``), so bases are planned in the order of their bounds, until the
next bound is no better than the tenth best planned base. Each of the ten best is then refined: its
neighbours at half the distance are screened, the promising ones are planned, and the best of them
takes its place, a few times; then at a quarter of the distance, and at an eighth. None of the ten
lies next to a better one. The result does not depend on the number of workers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

from so101_motion.common.errors import PlanningError
from so101_motion.tasks.sweeps.engine import Progress, SweepResult, run_sweep
from so101_motion.tasks.sweeps.judged_bases import Base, JudgedBases
from so101_motion.tasks.sweeps.mounting import COARSE, LatticeIndex
from so101_motion.tasks.sweeps.place import PlaceSweep, Screened

BEST = 10
"""How many bases are kept."""

_BATCH = 48
"""How many bases are planned before the bounds are compared again. Chosen: a few seconds' work."""

_BATCHES = 8
"""Most batches of the first round. Chosen."""

_MOVES = 3
"""How often a base moves at most at the same distance to its neighbours. Chosen."""

_OF_A_PLACE, _CLOSER = 4, 2
"""How many neighbours of a base are planned before their bounds are compared again, and how often.
Chosen."""

OnStep = Callable[[PlaceSweep], Callable[[Progress], None]]
"""Called with a step before it begins; returns the function that is called with its progress."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placement:
    """The result of a search.

    Attributes:
        best: The best bases, the best first, at most ten.
        screened: The result of every base of the first round.
        planned: How many bases were planned.
        failed: Why shards failed, by folder and number; then bases may be missing.
        sha256: The SHA-256 of all steps.
    """

    best: tuple[Base, ...]
    screened: tuple[Screened, ...]
    planned: int
    failed: dict[str, str]
    sha256: str


def find_bases(
    sweep: PlaceSweep,
    folder: Path,
    *,
    executor: Executor | None = None,
    ahead: int = 32,
    on_step: OnStep | None = None,
) -> Placement:
    """Find the best bases for a task, or resume such a search.

    Args:
        sweep: The parameters; the search sets ``indices``, ``planned`` and ``jittered`` itself.
        folder: The folder for the steps.
        executor: As for ``run_sweep``, such as a ``WorkerPool``.
        ahead: As for ``run_sweep``.
        on_step: Called before each step.

    Raises:
        ConfigError: The folder belongs to another search, or cannot be written.
        PlanningError: From no base all poses can be reached; names the pose that is missed.
        WorkerError: As for ``run_sweep``.
    """

    def run(step: PlaceSweep, place: Path) -> SweepResult:
        shown = None if on_step is None else on_step(step)
        return run_sweep(step, place, executor=executor, ahead=ahead, on_progress=shown)

    return _Search(JudgedBases(sweep, folder, run)).go()


class _Search:
    """One search."""

    def __init__(self, bases: JudgedBases) -> None:
        self._bases, self._region = bases, bases.sweep.region

    def go(self) -> Placement:
        """Run all rounds."""
        bases = self._bases
        first = bases.first_round()
        self._plan([each.lattice_index for each in first])
        middles = self._places()
        step = COARSE // 2
        while step:
            moving = list(range(len(middles)))
            for _ in range(_MOVES):
                moving = self._closer(middles, moving, step)
            step //= 2
        if not middles:
            raise PlanningError("some bases reach all poses, but no plan between them was found")
        best = self._places()
        if bases.sweep.by != "robust":
            bases.plan(best, jittered=True)
        return Placement(
            best=tuple(bases.base(index) for index in best),
            screened=first,
            planned=len(bases.placed),
            failed=bases.failed,
            sha256=bases.sha256,
        )

    def _plan(self, indices: list[LatticeIndex]) -> None:
        """Plan bases until no other one can be among the best."""
        for _ in range(_BATCHES):
            best = self._places()
            worst = self._bases.key(best[-1]) if len(best) == BEST else (math.inf,)
            promising = self._bases.promising(indices, worst)[:_BATCH]
            if not promising:
                return
            self._bases.plan(promising)

    def _closer(self, middles: list[LatticeIndex], which: list[int], step: int) -> list[int]:
        """Move some bases to the best one ``step`` around them; returns those that moved."""
        bases = self._bases
        around = {k: list(self._region.around(middles[k], step)) for k in which}
        bases.screen(index for indices in around.values() for index in indices)
        for _ in range(_CLOSER):
            promising = []
            for k, indices in around.items():
                best = bases.key(bases.ranked([middles[k], *indices])[0])
                promising += bases.promising(indices, best)[:_OF_A_PLACE]
            if not promising:
                break
            bases.plan(promising)
        moved = []
        for k, indices in around.items():
            moved_to = bases.ranked([middles[k], *indices])[0]
            if moved_to != middles[k]:
                middles[k] = moved_to
                moved.append(k)
        return moved

    def _places(self) -> list[LatticeIndex]:
        """The best ten planned bases, none of them next to a better one."""
        chosen: list[LatticeIndex] = []
        for each in self._bases.ranked(self._bases.placed):
            if all(self._region.are_apart(each, other) for other in chosen):
                chosen.append(each)
            if len(chosen) == BEST:
                break
        return chosen
