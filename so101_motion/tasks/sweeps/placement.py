"""Find the bases from which a task is done best: screen, plan the promising ones, look closer.

How it works. Round one screens a coarse lattice of bases. What screening says is a bound that no
plan can beat (``mounted_arm.py``), so bases are planned in the order of their bounds, until the
next bound is no better than the tenth best place that is planned. Each of the ten best then moves
by itself: its neighbours at half the distance are screened, those that may be better planned, and
the best of them takes its place, a few times; then at a quarter of the distance, and at an eighth.
The ten are ten places: none lies next to a better one.

Each step is a sweep with a folder of its own, ``01-screen``, ``02-place``, and so on: a search that
is interrupted goes on where it was. What is planned never depends on how many workers there are.
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

from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import Array
from so101_motion.tasks.sweeps.engine import Progress, SweepResult, WorkerPool, run_sweep
from so101_motion.tasks.sweeps.folder import SweepFolder
from so101_motion.tasks.sweeps.mounted_arm import GAIN
from so101_motion.tasks.sweeps.mounting import COARSE, Cell
from so101_motion.tasks.sweeps.place import Placed, PlaceSweep, Screened
from so101_motion.tasks.sweeps.placement_task import PlacementTask, task_from

BEST = 10
"""So many bases are kept."""

_BATCH = 48
"""So many bases are planned before the bounds are looked at again. Chosen: a few seconds' work."""

_MOST = 8
"""So many batches the first round has at the most. Chosen."""

_MOVES = 3
"""So often a place moves at the same distance to its neighbours. Chosen."""

_OF_A_PLACE, _CLOSER = 4, 2
"""So many neighbours of a place are planned before their bounds are looked at again, and so often.
Chosen."""


class Base(NamedTuple):
    """A base that was found, in the order in which they are compared.

    Attributes:
        cell: Its place on the lattice.
        x: Where it is in the cell [m].
        y: Likewise [m].
        z: Likewise [m].
        turn: Its turn about its own z axis [rad].
        time: Once around [s].
        clearance: Beyond the margins, on all of the way [m].
        torque_left: The least share of what a servo may hold that is left.
        robust: From how many of eight bases 5 mm and 2 degrees off all can still be reached.
        q: The joint angles at each pose, shape (n, 5), [rad].
    """

    cell: Cell
    x: float
    y: float
    z: float
    turn: float
    time: float
    clearance: float
    torque_left: float
    robust: float
    q: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placement:
    """What came of a search.

    Attributes:
        best: The best bases, the best first, at most ten.
        screened: What is known of every base of the first round.
        planned: How many bases were planned.
        failed: Why shards failed, by folder and number; then bases may be missing.
        sha256: Of all steps.
    """

    best: tuple[Base, ...]
    screened: tuple[Screened, ...]
    planned: int
    failed: dict[str, str]
    sha256: str


Key = tuple[float, ...]
"""What bases are compared by, the smaller the better."""


def find_bases(
    sweep: PlaceSweep,
    folder: Path,
    *,
    workers: int | WorkerPool | None = None,
    executor: Executor | None = None,
    ahead: int | None = None,
    on_step: Callable[[PlaceSweep], Callable[[Progress], None]] | None = None,
) -> Placement:
    """Find the best bases for a task, or go on with such a search.

    Args:
        sweep: What is asked for; its ``cells``, ``planned`` and ``jittered`` are the search's.
        folder: Where the steps go.
        workers: As for ``run_sweep``; a pool, for there are some dozens of steps.
        executor: Likewise.
        ahead: Likewise.
        on_step: Called with each step before it begins; what it returns is told its progress.

    Raises:
        ConfigError: The folder belongs to another search, or cannot be written.
        PlanningError: From no base of the first round all poses can be reached; says which is
            missed most.
        WorkerError: As for ``run_sweep``.
    """

    def run(step: PlaceSweep, place: Path) -> SweepResult:
        shown = None if on_step is None else on_step(step)
        return run_sweep(
            step, place, workers=workers, executor=executor, ahead=ahead, on_progress=shown
        )

    return _Search(sweep, folder, run).go()


class _Search:
    """One search."""

    def __init__(
        self, sweep: PlaceSweep, folder: Path, run: Callable[[PlaceSweep, Path], SweepResult]
    ) -> None:
        self._sweep, self._folder, self._run = sweep, folder, run
        self._steps = 0
        self._screened: dict[Cell, Screened] = {}
        self._placed: dict[Cell, Placed] = {}
        self._failed: dict[str, str] = {}
        self._ratio = math.inf  # the least time of a plan, by its bound
        self._digest = hashlib.sha256()

    def go(self) -> Placement:
        """All rounds."""
        self._screen(None)
        first = tuple(self._screened.values())
        if not any(math.isfinite(each.time) for each in first):
            raise _hopeless(first, task_from(json.loads(self._sweep.task)))
        self._plan([each.cell for each in first])
        middles = self._places(self._placed)
        step = COARSE // 2
        while step:
            moving = list(range(len(middles)))
            for _ in range(_MOVES):
                moving = self._closer(middles, moving, step)
            step //= 2
        if not middles:
            raise PlanningError("all poses can be reached from some bases, but not planned")
        best = self._places(self._placed)
        if self._sweep.by != "robust":
            self._plan_these(best, jittered=True)
        return Placement(
            best=tuple(self._base(cell) for cell in best),
            screened=first,
            planned=len(self._placed),
            failed=self._failed,
            sha256=self._digest.hexdigest(),
        )

    def _screen(self, cells: list[Cell] | None) -> None:
        if cells is not None:
            cells = [cell for cell in cells if cell not in self._screened]
        for row in self._rows(replace(self._sweep, cells=_tuple(cells), planned=False)):
            cell = _cell(row[0])
            self._screened[cell] = Screened(cell, *row[1:])

    def _plan(self, cells: list[Cell]) -> None:
        """Plan bases until none is left that may be among the best."""
        for _ in range(_MOST):
            best = self._places(self._placed)
            worst = self._key(best[-1]) if len(best) == BEST else (math.inf,)
            promising = self._promising(cells, worst)[:_BATCH]
            if not promising:
                return
            self._plan_these(promising)

    def _closer(self, middles: list[Cell], which: list[int], step: int) -> list[int]:
        """Move some middles to the best of what is ``step`` around them; those that moved."""
        around = {k: list(self._sweep.region.around(middles[k], step)) for k in which}
        self._screen(_without_repeats(cell for cells in around.values() for cell in cells))
        for _ in range(_CLOSER):
            promising = []
            for k, cells in around.items():
                best = self._key(self._ranked([middles[k], *cells])[0])
                promising += self._promising(cells, best)[:_OF_A_PLACE]
            if not promising:
                break
            self._plan_these(_without_repeats(promising))
        moved = []
        for k, cells in around.items():
            best_cell = self._ranked([middles[k], *cells])[0]
            if best_cell != middles[k]:
                middles[k] = best_cell
                moved.append(k)
        return moved

    def _promising(self, cells: list[Cell], than: Key) -> list[Cell]:
        """Bases not planned yet whose bounds are better than something, the best first."""
        left = [
            cell
            for cell in cells
            if cell not in self._placed
            and math.isfinite(self._screened[cell].time)
            and self._bound(cell) < than
        ]
        return sorted(left, key=self._bound)

    def _plan_these(self, cells: list[Cell], *, jittered: bool = False) -> None:
        jittered |= self._sweep.by == "robust"
        step = replace(self._sweep, cells=tuple(cells), planned=True, jittered=jittered)
        for row in self._rows(step):
            cell = _cell(row[0])
            self._placed[cell] = Placed(cell, *row[1:])
        for cell in cells:  # of shards that failed, as that is told at the end
            nothing = np.full((1, 5), np.nan)
            lost = Placed(cell, math.inf, -math.inf, -math.inf, 0.0, "failed", nothing)
            self._placed.setdefault(cell, lost)
        ratios = (self._placed[cell].time / self._screened[cell].time for cell in cells)
        self._ratio = min(self._ratio, *ratios)

    def _rows(self, step: PlaceSweep) -> Iterator[list[Any]]:
        """Run a step; its rows as plain values, but for arrays."""
        if step.cells is not None and not step.cells:
            return
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

    def _ranked(self, cells: Iterable[Cell]) -> list[Cell]:
        """Those that are planned, the best first."""
        good = [
            cell
            for cell in cells
            if cell in self._placed and math.isfinite(self._placed[cell].time)
        ]
        return sorted(good, key=self._key)

    def _places(self, cells: Iterable[Cell]) -> list[Cell]:
        """The best ten that are planned, none of them next to a better one."""
        chosen: list[Cell] = []
        for cell in self._ranked(cells):
            if all(self._sweep.region.are_apart(cell, other) for other in chosen):
                chosen.append(cell)
            if len(chosen) == BEST:
                break
        return chosen

    def _key(self, cell: Cell) -> Key:
        it = self._placed[cell]
        return (*_first(self._sweep.by, it.time, it.clearance, it.torque_left, it.robust), *cell)

    def _bound(self, cell: Cell) -> Key:
        it = self._screened[cell]
        # A base that cannot gain more than GAIN is not worth planning, nor one that would have to
        # come nearer to its bound than any has: where poses are passed, bounds are far off.
        time = it.time * (1.0 if self._ratio == math.inf else self._ratio) / (1.0 - GAIN)
        return _first(self._sweep.by, time, it.clearance, it.torque_left, 1.0)

    def _base(self, cell: Cell) -> Base:
        it, (x, y, z, turn) = self._placed[cell], self._sweep.region.place(cell)
        return Base(
            cell, x, y, z, turn, it.time, it.clearance, it.torque_left, it.robust, np.array(it.q)
        )


def _first(by: str, time: float, clearance: float, left: float, robust: float) -> Key:
    if by == "clearance":
        return -clearance, time
    if by == "torque":
        return -left, time
    if by == "robust":
        return -robust, time
    return (time,)


def _hopeless(screened: tuple[Screened, ...], task: PlacementTask) -> PlanningError:
    further = max(each.missed for each in screened)
    if further < 0:
        return PlanningError(
            f"each of {len(screened)} bases would stand in something; give another region"
        )
    return PlanningError(
        f"from none of {len(screened)} bases all poses can be reached; the best ones miss pose"
        f" {further + 1} ({task.poses[further].name}); give another region, or wider tolerances"
    )


def _without_repeats(cells: Iterable[Cell]) -> list[Cell]:
    return list(dict.fromkeys(cells))


def _tuple(cells: list[Cell] | None) -> tuple[Cell, ...] | None:
    return None if cells is None else tuple(cells)


def _cell(row: NDArray[np.int64]) -> Cell:
    x, y, z, turn = row.tolist()
    return x, y, z, turn
