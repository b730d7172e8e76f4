"""Find bases for two arms, each with a task of its own, that may work side by side.

Both repeat their cycles at their own speed, and neither waits: wherever one arm is on its path, it
keeps as far off every configuration of the other as planned arms do
(``planning/collision/apart_at_any_timing.py``). So two computers may run them without knowing of
each other.

How it works. Bases of each arm are screened and planned as for one (``placement.py``), some more
while they may still give better pairs. All pairs of planned bases are checked against each other,
the best first, until ten are found. Then the bases of each pair are refined, one arm after the
other, in steps of half the distance, a quarter and an eighth.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import islice, product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from so101_motion.common.errors import ConfigError, PlanningError
from so101_motion.common.units import to_mm
from so101_motion.files.scene_file import scene_from
from so101_motion.planning.collision.apart import ROOM
from so101_motion.planning.collision.apart_at_any_timing import never_meet
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.bodies import around_base
from so101_motion.planning.collision.scene import Scene, StandingArm
from so101_motion.tasks.sweeps.engine import WorkerPool
from so101_motion.tasks.sweeps.judged_bases import Base, JudgedBases, Key, first_of
from so101_motion.tasks.sweeps.mounting import COARSE, LatticeIndex
from so101_motion.tasks.sweeps.place import PlaceSweep
from so101_motion.tasks.sweeps.placement import (
    BATCH,
    BATCHES,
    BEST,
    OF_A_PLACE,
    OnStep,
    Placement,
    runner,
)
from so101_motion.tasks.sweeps.placement_task import task_from

_HELD = 5000
"""So many pairs are checked before more bases are planned. Chosen: a minute."""

Pair = tuple[LatticeIndex, LatticeIndex]


class BasePair(NamedTuple):
    """Bases of two arms that may work side by side.

    Attributes:
        bases: The base of the first arm and of the second.
        time: Cycle time of the slower of the two [s].
        clearance: The smaller one of both [m].
        torque_left: The smaller one of both.
        robust: The smaller one of both.
    """

    bases: tuple[Base, Base]
    time: float
    clearance: float
    torque_left: float
    robust: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairPlacement:
    """The result of a search for pairs.

    Attributes:
        best: The best pairs, the best first, at most ten.
        each: The result for each arm: its bases are those of the pairs, in their order.
        held: How many pairs were checked against each other.
        sha256: The SHA-256 of all steps, and of the pairs.
    """

    best: tuple[BasePair, ...]
    each: tuple[Placement, Placement]
    held: int
    sha256: str


def find_pairs(
    sweeps: tuple[PlaceSweep, PlaceSweep],
    folder: Path,
    *,
    workers: int | WorkerPool | None = None,
    executor: Executor | None = None,
    ahead: int | None = None,
    on_step: OnStep | None = None,
) -> PairPlacement:
    """Find the best pairs of bases for two tasks, or resume such a search.

    Args:
        sweeps: The parameters of each arm; both with the same criterion.
        folder: The folder for the steps.
        workers: As for ``find_bases``.
        executor: As for ``find_bases``.
        ahead: As for ``find_bases``.
        on_step: As for ``find_bases``.

    Raises:
        ConfigError: The folder belongs to another search, or cannot be written.
        PlanningError: No pair was found; the error says why.
        WorkerError: As for ``run_sweep``.
    """
    if sweeps[0].by != sweeps[1].by:
        raise ConfigError("by", sweeps[1].by, f"must be {sweeps[0].by}, as of the first arm")
    _refuse_same_places(sweeps)
    run = runner(workers, executor, ahead, on_step)
    arms = [JudgedBases(each, folder / str(n), run) for n, each in enumerate(sweeps, 1)]
    return _PairSearch(arms).go()


class _PairSearch:
    """One search."""

    def __init__(self, arms: Sequence[JudgedBases]) -> None:
        self._arms = arms
        self._by = arms[0].sweep.by
        scenes = [scene_from(json.loads(each.sweep.scene), folder=None) for each in arms]
        self._bodies = [bodies_of(each.attached) for each in scenes]
        self._known: dict[Pair, bool] = {}

    def go(self) -> PairPlacement:
        """Run all rounds."""
        first = [each.first_round() for each in self._arms]
        pairs: list[Pair] = []
        for _ in range(BATCHES):
            worst = self._key(pairs[-1]) if len(pairs) == BEST else (math.inf,)
            planned = 0
            for arm, screened in zip(self._arms, first, strict=True):
                promising = arm.promising((each.lattice_index for each in screened), worst)[:BATCH]
                arm.plan(promising)
                planned += len(promising)
            if not planned:
                break
            pairs = self._best(pairs)
        if not pairs:
            raise self._apart_nowhere()
        step = COARSE // 2
        while step:
            for which in (0, 1):
                self._closer(pairs, which, step)
            step //= 2
        pairs = self._distinct(sorted(set(pairs), key=self._key))
        if self._by != "robust":
            for which, arm in enumerate(self._arms):
                arm.plan((pair[which] for pair in pairs), jittered=True)
        placements = [
            Placement(
                best=tuple(arm.base(pair[which]) for pair in pairs),
                screened=first[which],
                planned=len(arm.placed),
                failed=arm.failed,
                sha256=arm.sha256,
            )
            for which, arm in enumerate(self._arms)
        ]
        text = json.dumps([pairs, [each.sha256 for each in placements]])
        return PairPlacement(
            best=tuple(self._pair(pair) for pair in pairs),
            each=(placements[0], placements[1]),
            held=len(self._known),
            sha256=hashlib.sha256(text.encode()).hexdigest(),
        )

    def _best(self, known: list[Pair]) -> list[Pair]:
        """The best ten pairs of planned bases, or those found in a limited number of checks."""
        looked = len(self._known) + _HELD
        able = islice(
            (pair for pair in self._in_order() if self._keep_apart(pair, looked)), 100 * BEST
        )
        found = self._distinct(able)
        return found if len(found) >= len(known) else known

    def _in_order(self) -> Iterator[Pair]:
        """All pairs of planned bases, the best first."""
        first, second = (arm.ranked(arm.placed) for arm in self._arms)
        yield from sorted(product(first, second), key=self._key)

    def _distinct(self, ranked: Iterable[Pair]) -> list[Pair]:
        """The first ten pairs that are not next to a better one with both bases."""
        chosen: list[Pair] = []
        for pair in ranked:
            if all(self._differ(pair, other) for other in chosen):
                chosen.append(pair)
            if len(chosen) == BEST:
                break
        return chosen

    def _differ(self, pair: Pair, other: Pair) -> bool:
        return any(
            arm.sweep.region.are_apart(a, b)
            for arm, a, b in zip(self._arms, pair, other, strict=True)
        )

    def _closer(self, pairs: list[Pair], which: int, step: int) -> None:
        """Move one arm of each pair to the best base ``step`` around it."""
        arm = self._arms[which]
        around = [list(arm.sweep.region.around(pair[which], step)) for pair in pairs]
        arm.screen(index for indices in around for index in indices)
        promising = []
        for pair, indices in zip(pairs, around, strict=True):
            promising += arm.promising(indices, self._key(pair))[:OF_A_PLACE]
        arm.plan(promising)
        for k, (pair, indices) in enumerate(zip(pairs, around, strict=True)):
            moved = [
                (index, pair[1]) if which == 0 else (pair[0], index)
                for index in arm.ranked(indices)
            ]
            better = sorted(
                (each for each in moved if self._key(each) < self._key(pair)), key=self._key
            )
            pairs[k] = next((each for each in better if self._keep_apart(each)), pair)

    def _keep_apart(self, pair: Pair, most: float = math.inf) -> bool:
        """Whether two arms there may work side by side; False once ``most`` pairs are checked."""
        if pair not in self._known:
            if len(self._known) >= most:
                return False
            self._known[pair] = self._proven_apart(pair)
        return self._known[pair]

    def _proven_apart(self, pair: Pair) -> bool:
        a, b = (arm.sweep.region.base(index) for arm, index in zip(self._arms, pair, strict=True))
        ways = [arm.placed[index].way for arm, index in zip(self._arms, pair, strict=True)]
        T = a.inverse @ b
        if not never_meet(self._bodies[0], self._bodies[1], T, ways[0], ways[1]):
            return False
        other = StandingArm(name="other", T_base_arm=T, q=ways[1][:1], room=ROOM)
        model = self._bodies[0].model
        return around_base(model, Scene(arms=(other,), floor_z=None)) is None

    def _pair(self, pair: Pair) -> BasePair:
        first, second = (arm.base(index) for arm, index in zip(self._arms, pair, strict=True))
        return BasePair((first, second), *self._figures(pair))

    def _figures(self, pair: Pair) -> tuple[float, float, float, float]:
        one, other = (arm.placed[index] for arm, index in zip(self._arms, pair, strict=True))
        return (
            max(one.time, other.time),
            min(one.clearance, other.clearance),
            min(one.torque_left, other.torque_left),
            min(one.robust, other.robust),
        )

    def _key(self, pair: Pair) -> Key:
        both = sum(arm.placed[index].time for arm, index in zip(self._arms, pair, strict=True))
        return (*first_of(self._by, *self._figures(pair)), both, *pair[0], *pair[1])

    def _apart_nowhere(self) -> PlanningError:
        bases = " and ".join(str(len(arm.ranked(arm.placed))) for arm in self._arms)
        return PlanningError(
            f"none of {len(self._known)} pairs of bases keeps the arms {to_mm(ROOM):.0f} mm apart"
            f" at any time (of {bases} bases that were planned); give regions that are further"
            " apart, or tasks that leave each other more room"
        )


def _refuse_same_places(sweeps: Sequence[PlaceSweep]) -> None:
    """Refuse tasks that have poses in the same place."""
    tasks = [task_from(json.loads(each.task)) for each in sweeps]
    for one, other in product(tasks[0].poses, tasks[1].poses):
        apart = float(np.linalg.norm(one.p - other.p))
        if tasks[0].frame == tasks[1].frame and apart < ROOM:
            raise PlanningError(
                f'"{one.name}" of the first task is {to_mm(apart):.0f} mm from "{other.name}" of'
                " the second: arms that do not wait for each other cannot both go there"
            )
