"""Screen and plan bases of one arm in a search, and rank them.

Each step is a sweep with a folder of its own, ``01-screen``, ``02-place``, and so on, so that an
interrupted search resumes where it was.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import Array
from so101_motion.tasks.sweeps.engine import SweepResult
from so101_motion.tasks.sweeps.folder import SweepFolder
from so101_motion.tasks.sweeps.mounted_arm import GAIN
from so101_motion.tasks.sweeps.mounting import LatticeIndex
from so101_motion.tasks.sweeps.place import Placed, PlaceSweep, Screened
from so101_motion.tasks.sweeps.placement_task import task_from

Key = tuple[float, ...]
"""Sort key of bases; smaller is better."""

RunStep = Callable[[PlaceSweep, Path], SweepResult]
"""Runs a step of a search in a folder."""


class Base(NamedTuple):
    """A base that was found.

    Attributes:
        lattice_index: Its place on the lattice.
        x: Its position in the cell [m].
        y: Its position in the cell [m].
        z: Its position in the cell [m].
        turn: Its turn about its own z axis [rad].
        time: Time of one cycle [s].
        clearance: Smallest clearance beyond the margins on the whole path [m].
        torque_left: Smallest share of the servos' holding torque that is left.
        robust: Share of eight bases, 5 mm and 2 degrees off, from which all can still be reached.
        q: The joint angles at each pose, shape (n, 5), [rad].
    """

    lattice_index: LatticeIndex
    x: float
    y: float
    z: float
    turn: float
    time: float
    clearance: float
    torque_left: float
    robust: float
    q: Array


class JudgedBases:
    """The bases of one arm.

    Args:
        sweep: The parameters of the search.
        folder: The folder for the steps.
        run: Runs a step.

    Attributes:
        sweep: The parameters of the search.
        screened: The result of each base that was screened.
        placed: The result of each base that was planned.
        failed: Why shards failed, by folder and number.
    """

    def __init__(self, sweep: PlaceSweep, folder: Path, run: RunStep) -> None:
        self.sweep, self._folder, self._run = sweep, folder, run
        self._steps = 0
        self.screened: dict[LatticeIndex, Screened] = {}
        self.placed: dict[LatticeIndex, Placed] = {}
        self.failed: dict[str, str] = {}
        self._ratio = math.inf  # the least time of a plan, by its bound
        self._digest = hashlib.sha256()

    @property
    def sha256(self) -> str:
        """The SHA-256 of the results of all steps."""
        return self._digest.hexdigest()

    def first_round(self) -> tuple[Screened, ...]:
        """Screen the bases of the region's first round.

        Raises:
            PlanningError: From no base all poses can be reached; names the pose that is missed.
        """
        self._screened_by(self.sweep)
        first = tuple(self.screened.values())
        if not any(math.isfinite(each.time) for each in first):
            task = task_from(json.loads(self.sweep.task))
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

    def screen(self, indices: Iterable[LatticeIndex]) -> None:
        """Screen the bases that have not been screened."""
        new = tuple(dict.fromkeys(index for index in indices if index not in self.screened))
        if new:
            self._screened_by(replace(self.sweep, indices=new))

    def _screened_by(self, sweep: PlaceSweep) -> None:
        for row in self._rows(replace(sweep, planned=False)):
            index = _index(row[0])
            self.screened[index] = Screened(index, *row[1:])

    def promising(self, indices: Iterable[LatticeIndex], than: Key) -> list[LatticeIndex]:
        """Bases not planned yet whose bounds are better than a key, the best first."""
        left = [
            index
            for index in indices
            if index not in self.placed
            and math.isfinite(self.screened[index].time)
            and self._bound(index) < than
        ]
        return sorted(left, key=self._bound)

    def plan(self, indices: Iterable[LatticeIndex], *, jittered: bool = False) -> None:
        """Plan bases, again if they have been planned."""
        wanted = tuple(dict.fromkeys(indices))
        if not wanted:
            return
        jittered |= self.sweep.by == "robust"
        for row in self._rows(replace(self.sweep, indices=wanted, planned=True, jittered=jittered)):
            index = _index(row[0])
            self.placed[index] = Placed(index, *row[1:])
        for index in wanted:  # of shards that failed; those are reported at the end
            self.placed.setdefault(index, Placed.nowhere(index, "failed", 1))
        ratios = (self.placed[index].time / self.screened[index].time for index in wanted)
        self._ratio = min(self._ratio, *ratios)

    def ranked(self, indices: Iterable[LatticeIndex]) -> list[LatticeIndex]:
        """The bases that have a plan, the best first."""
        good = [
            index
            for index in indices
            if index in self.placed and math.isfinite(self.placed[index].time)
        ]
        return sorted(good, key=self.key)

    def key(self, index: LatticeIndex) -> Key:
        """The sort key of a planned base."""
        it = self.placed[index]
        return (*_first_of(self.sweep.by, it.time, it.clearance, it.torque_left, it.robust), *index)

    def base(self, index: LatticeIndex) -> Base:
        """A planned base with its place."""
        it, (x, y, z, turn) = self.placed[index], self.sweep.region.place(index)
        return Base(
            index, x, y, z, turn, it.time, it.clearance, it.torque_left, it.robust, np.array(it.q)
        )

    def _bound(self, index: LatticeIndex) -> Key:
        it = self.screened[index]
        # A base is not worth planning if it cannot gain more than GAIN, or if its plan would have
        # to be nearer to its bound than any plan is: with passed poses, bounds are far off.
        time = it.time * (1.0 if self._ratio == math.inf else self._ratio) / (1.0 - GAIN)
        return _first_of(self.sweep.by, time, it.clearance, it.torque_left, 1.0)

    def _rows(self, step: PlaceSweep) -> Iterator[list[Any]]:
        """Run a step and yield its rows, as plain values and arrays."""
        self._steps += 1
        place = self._folder / f"{self._steps:02d}-{step.kind}"
        result = self._run(step, place)
        self._digest.update(f"{result.sha256}\n".encode())
        for number, why in result.failed.items():
            self.failed[f"{place.name}, shard {number}"] = why
        names = (Placed if step.planned else Screened)._fields
        for number in range(step.shards):
            shard = SweepFolder(place).read(number)
            if shard is not None:
                columns = (
                    of if of.ndim > 1 else of.tolist() for of in (shard[name] for name in names)
                )
                yield from map(list, zip(*columns, strict=True))


def _first_of(by: str, time: float, clearance: float, left: float, robust: float) -> Key:
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
