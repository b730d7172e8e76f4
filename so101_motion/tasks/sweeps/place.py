"""Judge bases for a task: is every pose reachable from there, and what does the whole task take.

Bases are screened first, which gives bounds, then the promising ones are planned; see
``mounted_arm.py``. Which those are is decided in ``placement.py``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple

import numpy as np

from so101_motion.common.attributes import SERVO_VOLTAGES
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array
from so101_motion.files.scene_file import scene_from
from so101_motion.planning.collision.scene import Scene
from so101_motion.tasks.sweeps.mounted_arm import CRITERIA, MountedArm, MountedCaps
from so101_motion.tasks.sweeps.mounting import Cell, FixedArm, Region
from so101_motion.tasks.sweeps.packed import Columns
from so101_motion.tasks.sweeps.placement_task import task_from

SCREENED, PLANNED = 64, 4
"""Bases of a shard. Chosen: some tenths of a second of work."""


@dataclass(frozen=True, kw_only=True)
class PlaceSweep:
    """Plain data that says which bases are judged.

    Attributes:
        task: As JSON text; see ``placement_task.task_text``.
        region: The lattice.
        cells: The bases; None for those of the region's first round.
        planned: Whether they are planned, or screened only.
        jittered: Whether bases near them are looked at as well, if they are planned.
        by: What is wanted most, one of ``CRITERIA``.
        scene: The cell, as the JSON text of a scene.
        others: Arms that stay where they stand in the cell.
        velocity: Cap of the joints [rad/s].
        acceleration: Likewise [rad/s^2].
        jerk: Likewise [rad/s^3].
        payload: What the hand carries, at the jaw's tip [kg].
        voltage: The servos' rated voltage [V].
    """

    task: str
    region: Region
    cells: tuple[Cell, ...] | None = None
    planned: bool = False
    jittered: bool = False
    by: str = "time"
    scene: str = '{"obstacles": []}'
    others: tuple[FixedArm, ...] = ()
    velocity: float = 3.0
    acceleration: float = 7.5
    jerk: float = 500.0
    payload: float = 0.0
    voltage: float = SERVO_VOLTAGES[0]

    def __post_init__(self) -> None:
        if self.by not in CRITERIA:
            raise ConfigError("by", self.by, f"must be one of {', '.join(CRITERIA)}")

    unit = "bases"

    @property
    def kind(self) -> str:
        """What is done with them."""
        return ("jitter" if self.jittered else "place") if self.planned else "screen"

    @property
    def items(self) -> int:
        """How many bases there are."""
        return len(self.bases)

    @property
    def shards(self) -> int:
        """Into how many shards they are cut."""
        return max(1, -(-self.items // self._of_a_shard))

    @property
    def bases(self) -> tuple[Cell, ...]:
        """All of them."""
        return tuple(self.region.cells()) if self.cells is None else self.cells

    @property
    def _of_a_shard(self) -> int:
        return PLANNED if self.planned else SCREENED

    def facts(self) -> Mapping[str, object]:
        """What is asked for."""
        parsed = {"task": json.loads(self.task), "scene": json.loads(self.scene)}
        return {**asdict(self), **parsed, "of_a_shard": self._of_a_shard}

    def open(self) -> Callable[[int], Columns]:
        """Load the arm and the task."""
        return _Judge(self).shard


class Screened(NamedTuple):
    """What screening says of a base.

    Attributes:
        cell: Which.
        time: No plan takes less [s]; infinite if a pose cannot be reached.
        clearance: No plan keeps more beyond the margins [m].
        torque_left: No plan leaves a larger share of what a servo may hold.
        missed: The first pose that cannot be reached; -1 for none, -2 if the base stands in
            something.
    """

    cell: Cell
    time: float
    clearance: float
    torque_left: float
    missed: int


class Placed(NamedTuple):
    """What planning says of a base.

    Attributes:
        cell: Which.
        time: Once around, pauses included, the jaw's own time left out [s]; infinite without plan.
        clearance: How far the arm stays away from contact beyond the margins, looked at every
            tenth of a second [m].
        torque_left: The least share of what a servo may hold that is left.
        robust: From how many of eight bases 5 mm and 2 degrees off every pose can still be had, 0
            to 1; not a number if that was not looked at.
        why: There is no plan; empty if there is one.
        q: The joint angles at each pose, shape (n, 5), [rad].
        way: Joints and jaw all the way around, shape (m, 6), [rad]; the last row may be repeated.
    """

    cell: Cell
    time: float
    clearance: float
    torque_left: float
    robust: float
    why: str
    q: Array
    way: Array

    @classmethod
    def nowhere(cls, cell: Cell, why: str, poses: int) -> Placed:
        """A base without a plan."""
        q, way = np.full((poses, 5), np.nan), np.full((1, 6), np.nan)
        return cls(cell, math.inf, -math.inf, -math.inf, 0.0, why, q, way)


class _Judge:
    """Judges bases for one sweep. Belongs to one thread."""

    def __init__(self, sweep: PlaceSweep) -> None:
        self._sweep, self._bases = sweep, sweep.bases
        arms = tuple(each.standing() for each in sweep.others)
        self._scene = replace(scene_from(json.loads(sweep.scene), folder=None), arms=arms)
        self._task = task_from(json.loads(sweep.task))
        self._arm = MountedArm(
            self._task,
            MountedCaps(
                sweep.velocity, sweep.acceleration, sweep.jerk, sweep.payload, sweep.voltage
            ),
            R_world_base=sweep.region.base((0, 0, 0, 0)).R,
            attached=self._scene.attached,
            by=sweep.by,
        )

    def shard(self, number: int) -> Columns:
        """The columns of a shard, one row for each base; the fields of the tuples below."""
        planned = self._sweep.planned
        count = PLANNED if planned else SCREENED
        cells = self._bases[number * count : (number + 1) * count]
        rows = [self._planned(each) if planned else self._screened(each) for each in cells]
        kind = Placed if planned else Screened
        columns = {name: [getattr(row, name) for row in rows] for name in kind._fields}
        if planned:
            longest = max(map(len, columns["way"]))
            columns["way"] = [
                np.pad(way, ((0, longest - len(way)), (0, 0)), mode="edge")
                for way in columns["way"]
            ]
        return {name: np.array(column) for name, column in columns.items()}

    def _seen(self, T_cell_base: SE3) -> Scene:
        return self._sweep.region.seen_from(self._scene, T_cell_base)

    def _screened(self, cell: Cell) -> Screened:
        T_cell_base = self._sweep.region.base(cell)
        choice, missed = self._arm.choice(T_cell_base, self._seen(T_cell_base))
        if choice is None:
            return Screened(cell, math.inf, -math.inf, -math.inf, missed)
        return Screened(cell, self._arm.least_time(choice), *choice.bounds(), missed)

    def _planned(self, cell: Cell) -> Placed:
        T_cell_base = self._sweep.region.base(cell)
        scene = self._seen(T_cell_base)
        choice, _ = self._arm.choice(T_cell_base, scene)
        found = "Unreachable" if choice is None else self._arm.planned(choice, scene)
        if isinstance(found, str):
            return Placed.nowhere(cell, found, len(self._task.poses))
        clearance, left = self._arm.figures(found, scene)
        robust, way = self._robust(T_cell_base), self._arm.way(found)
        return Placed(cell, found.time, clearance, left, robust, "", found.q, way)

    def _robust(self, T_cell_base: SE3) -> float:
        if not self._sweep.jittered:
            return math.nan
        jittered = list(self._sweep.region.jittered(T_cell_base))
        return sum(self._arm.reaches(T, self._seen(T)) for T in jittered) / len(jittered)
