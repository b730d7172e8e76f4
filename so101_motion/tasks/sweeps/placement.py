"""Find the bases from which a task is done best: screen, plan the promising ones, refine.

Bases of a coarse lattice are planned in the order of their bounds, until the next bound is no
better than the tenth best base. Then each of the ten moves to better neighbours, at ever smaller
distances. None of them lies next to a better one.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.errors import PlanningError, WorkerError
from so101_motion.common.geometry import Array
from so101_motion.tasks.sweeps.engine import Progress, SweepResult, run_sweep
from so101_motion.tasks.sweeps.folder import SweepFolder
from so101_motion.tasks.sweeps.mounted_arm import GAIN
from so101_motion.tasks.sweeps.place import COARSE, LatticeIndex, Placed, PlaceSweep, Screened
from so101_motion.tasks.sweeps.placement_task import task_from

BEST = 10  # how many bases are kept
_BATCH = 48  # bases that are planned before bounds are compared again. Chosen: seconds' work.
_BATCHES = 8  # most batches of the first round. Chosen.
_MOVES = 3  # how often a base moves at most at the same distance to its neighbours. Chosen.

_OF_A_PLACE, _CLOSER = 4, 2
"""How many neighbours of a base are planned before their bounds are compared again, and how often.
Chosen."""

OnStep = Callable[[PlaceSweep], Callable[[Progress], None]]
"""Called with a step before it begins; returns the function that is called with its progress."""


_Key = tuple[float, ...]  # sort key of bases; smaller is better


class Base(NamedTuple):
    """A base that was found."""

    lattice_index: LatticeIndex  # its place on the lattice
    x: float  # its position in the cell [m]
    y: float  # its position in the cell [m]
    z: float  # its position in the cell [m]
    turn: float  # its turn about its own z axis [rad]
    time: float  # time of one cycle [s]
    clearance: float  # smallest clearance beyond the margins on the whole path [m]
    torque_left: float  # smallest share of the servos' holding torque that is left
    robust: float  # share of eight bases, 5 mm and 2 degrees off, that reach all as well
    q: Array  # the joint angles at each pose, shape (n, 5), [rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placement:
    """The result of a search."""

    best: tuple[Base, ...]  # the best bases, the best first, at most ten
    screened: tuple[Screened, ...]  # the result of every base of the first round
    planned: int  # how many bases were planned
    failed: dict[str, str]  # why shards failed, by folder and number; then bases may be missing
    sha256: str  # the SHA-256 of all steps


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

    return _Search(sweep, folder, run).go()


class _Search:
    """One search. Each step is a sweep with a folder of its own, ``01-screen``, ``02-place`` ..."""

    def __init__(
        self, sweep: PlaceSweep, folder: Path, run: Callable[[PlaceSweep, Path], SweepResult]
    ) -> None:
        self._sweep, self._folder, self._run = sweep, folder, run
        self._steps = 0
        self._screened: dict[LatticeIndex, Screened] = {}
        self._placed: dict[LatticeIndex, Placed] = {}
        self._failed: dict[str, str] = {}
        self._ratio = math.inf  # the least time of a plan, by its bound
        self._digest = hashlib.sha256()

    def go(self) -> Placement:
        first = self._first_round()
        self._plan_best([each.lattice_index for each in first])
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
        if self._sweep.by != "robust":
            self._plan(best, jittered=True)
        return Placement(
            best=tuple(self._base(index) for index in best),
            screened=first,
            planned=len(self._placed),
            failed=self._failed,
            sha256=self._digest.hexdigest(),
        )

    def _plan_best(self, indices: list[LatticeIndex]) -> None:
        """Plan bases until no other one can be among the best."""
        for _ in range(_BATCHES):
            best = self._places()
            worst = self._key(best[-1]) if len(best) == BEST else (math.inf,)
            promising = self._promising(indices, worst)[:_BATCH]
            if not promising:
                return
            self._plan(promising)

    def _closer(self, middles: list[LatticeIndex], which: list[int], step: int) -> list[int]:
        """Move some bases to the best one ``step`` around them; returns those that moved."""
        around = {k: list(self._sweep.region.around(middles[k], step)) for k in which}
        self._screen(index for indices in around.values() for index in indices)
        for _ in range(_CLOSER):
            promising = []
            for k, indices in around.items():
                best = self._key(self._ranked([middles[k], *indices])[0])
                promising += self._promising(indices, best)[:_OF_A_PLACE]
            if not promising:
                break
            self._plan(promising)
        moved = []
        for k, indices in around.items():
            moved_to = self._ranked([middles[k], *indices])[0]
            if moved_to != middles[k]:
                middles[k] = moved_to
                moved.append(k)
        return moved

    def _places(self) -> list[LatticeIndex]:
        """The best ten planned bases, none of them next to a better one."""
        chosen: list[LatticeIndex] = []
        for each in self._ranked(self._placed):
            if all(self._sweep.region.are_apart(each, other) for other in chosen):
                chosen.append(each)
            if len(chosen) == BEST:
                break
        return chosen

    # Steps

    def _first_round(self) -> tuple[Screened, ...]:
        """Screen the first round; ``PlanningError`` if from no base all poses can be reached."""
        self._note_screened(self._sweep)
        first = tuple(self._screened.values())
        if not first:
            raise WorkerError(f"no base could be judged: {'; '.join(self._failed.values())}")
        if not any(math.isfinite(each.time) for each in first):
            task = task_from(json.loads(self._sweep.task))
            further = max(each.missed for each in first)
            if further < 0:
                raise PlanningError(
                    f"each of {len(first)} bases would be inside an obstacle; give another region"
                )
            raise PlanningError(
                f"from none of {len(first)} bases all poses can be reached; the best ones miss pose"
                f" {further + 1} ({task.poses[further].name}); give another region, or wider"
                " tolerances"
            )
        return first

    def _screen(self, indices: Iterable[LatticeIndex]) -> None:
        new = tuple(dict.fromkeys(index for index in indices if index not in self._screened))
        if new:
            self._note_screened(replace(self._sweep, indices=new))

    def _note_screened(self, sweep: PlaceSweep) -> None:
        for row in self._rows(replace(sweep, planned=False)):
            index = _index(row[0])
            self._screened[index] = Screened(index, *row[1:])

    def _promising(self, indices: Iterable[LatticeIndex], than: _Key) -> list[LatticeIndex]:
        """Bases not planned yet whose bounds are better than a key, the best first."""
        left = [
            index
            for index in indices
            if index not in self._placed
            and math.isfinite(self._screened[index].time)
            and self._bound(index) < than
        ]
        return sorted(left, key=self._bound)

    def _plan(self, indices: Iterable[LatticeIndex], *, jittered: bool = False) -> None:
        wanted = tuple(dict.fromkeys(indices))
        if not wanted:
            return
        jittered |= self._sweep.by == "robust"
        for row in self._rows(
            replace(self._sweep, indices=wanted, planned=True, jittered=jittered)
        ):
            index = _index(row[0])
            self._placed[index] = Placed(index, *row[1:])
        for index in wanted:  # of shards that failed; those are reported at the end
            self._placed.setdefault(index, Placed.nowhere(index, "failed", 1))
        ratios = (self._placed[index].time / self._screened[index].time for index in wanted)
        self._ratio = min(self._ratio, *ratios)

    def _ranked(self, indices: Iterable[LatticeIndex]) -> list[LatticeIndex]:
        """The bases that have a plan, the best first."""
        good = [
            index
            for index in indices
            if index in self._placed and math.isfinite(self._placed[index].time)
        ]
        return sorted(good, key=self._key)

    def _key(self, index: LatticeIndex) -> _Key:
        it = self._placed[index]
        return (
            *_first_of(self._sweep.by, it.time, it.clearance, it.torque_left, it.robust),
            *index,
        )

    def _base(self, index: LatticeIndex) -> Base:
        it, (x, y, z, turn) = self._placed[index], self._sweep.region.place(index)
        return Base(
            index, x, y, z, turn, it.time, it.clearance, it.torque_left, it.robust, np.array(it.q)
        )

    def _bound(self, index: LatticeIndex) -> _Key:
        it = self._screened[index]
        # A base is not worth planning if it cannot gain more than GAIN, or if its plan would have
        # to be nearer to its bound than any plan is: with passed poses, bounds are far off.
        time = it.time * (1.0 if self._ratio == math.inf else self._ratio) / (1.0 - GAIN)
        return _first_of(self._sweep.by, time, it.clearance, it.torque_left, 1.0)

    def _rows(self, step: PlaceSweep) -> Iterator[list[Any]]:
        """Run a step and yield its rows, as plain values and arrays."""
        self._steps += 1
        place = self._folder / f"{self._steps:02d}-{step.kind}"
        result = self._run(step, place)
        self._digest.update(f"{result.sha256}\n".encode())
        for number, why in result.failed.items():
            self._failed[f"{place.name}, shard {number}"] = why
        names = (Placed if step.planned else Screened)._fields
        for number in range(step.shards):
            shard = SweepFolder(place).read(number)
            if shard is not None:
                columns = (
                    of if of.ndim > 1 else of.tolist() for of in (shard[name] for name in names)
                )
                yield from map(list, zip(*columns, strict=True))


def _first_of(by: str, time: float, clearance: float, left: float, robust: float) -> _Key:
    """The figures to compare, that of the criterion first; smaller is better."""
    if by == "clearance":
        return -clearance, time
    if by == "torque":
        return -left, time
    if by == "robust":
        return -robust, time
    return (time,)


def _index(row: NDArray[np.int64]) -> LatticeIndex:
    x, y, z, turn = row.tolist()
    return x, y, z, turn
