"""Judge where an arm may be mounted for a task: reach, cycle time, clearance and torque left."""

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
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.tasks.sweeps.mounted_arm import CRITERIA, MountedArm
from so101_motion.tasks.sweeps.mounting import FixedArm, LatticeIndex, Region
from so101_motion.tasks.sweeps.placement_task import task_from
from so101_motion.tasks.sweeps.sweep import Columns

SCREENED, PLANNED = 64, 4  # how many bases a shard has. Chosen: some tenths of a second of work.


@dataclass(frozen=True, kw_only=True)
class PlaceSweep:
    """The bases to judge and the parameters, as plain data."""

    task: str  # the task as JSON text; see ``placement_task.task_text``
    region: Region  # the lattice
    indices: tuple[LatticeIndex, ...] | None = None  # None for the region's first round
    planned: bool = False  # whether they are planned, or only screened
    jittered: bool = False  # whether bases near them are judged as well, if they are planned
    by: str = "time"  # the criterion, one of ``CRITERIA``
    scene: str = '{"obstacles": []}'  # the cell, as the JSON text of a scene
    others: tuple[FixedArm, ...] = ()  # other arms in the cell, as obstacles
    velocity: float = 3.0  # velocity cap of the joints [rad/s]
    acceleration: float = 7.5  # acceleration cap [rad/s^2]
    jerk: float = 500.0  # jerk cap [rad/s^3]
    payload: float = 0.0  # mass in the hand, at the jaw's tip [kg]
    voltage: float = SERVO_VOLTAGES[0]  # the servos' rated voltage [V]

    def __post_init__(self) -> None:
        if self.by not in CRITERIA:
            raise ConfigError("by", self.by, f"must be one of {', '.join(CRITERIA)}")

    unit = "bases"

    @property
    def kind(self) -> str:
        return ("jitter" if self.jittered else "place") if self.planned else "screen"

    @property
    def items(self) -> int:
        return len(self.bases)

    @property
    def shards(self) -> int:
        return max(1, -(-self.items // self._of_a_shard))

    @property
    def bases(self) -> tuple[LatticeIndex, ...]:
        return tuple(self.region.first_round()) if self.indices is None else self.indices

    @property
    def _of_a_shard(self) -> int:
        return PLANNED if self.planned else SCREENED

    def facts(self) -> Mapping[str, object]:
        parsed = {"task": json.loads(self.task), "scene": json.loads(self.scene)}
        return {**asdict(self), **parsed, "of_a_shard": self._of_a_shard}

    def open(self) -> Callable[[int], Columns]:
        return _Judge(self).shard


class Screened(NamedTuple):
    """The result of screening a base: bounds that no plan can beat."""

    lattice_index: LatticeIndex  # the base's place on the lattice
    time: float  # lower bound on the cycle time [s]; infinite if a pose cannot be reached
    clearance: float  # upper bound on the clearance beyond the margins [m]
    torque_left: float  # upper bound on the share of the servos' holding torque that is left
    # the first pose that cannot be reached; -1 for none, -2 if the base is inside an obstacle
    missed: int


class Placed(NamedTuple):
    """The result of planning a base."""

    lattice_index: LatticeIndex  # the base's place on the lattice
    time: float  # cycle time with pauses, without the jaw's own time [s]; infinite without a plan
    clearance: float  # smallest clearance beyond the margins, measured every tenth of a second [m]
    torque_left: float  # smallest share of the servos' holding torque that is left
    # share of eight bases, 5 mm and 2 degrees off, from which every pose can still be reached, 0 to
    # 1; NaN if that was not checked
    robust: float
    why: str  # the name of the error if there is no plan; empty if there is one
    q: Array  # the joint angles at each pose, shape (n, 5), [rad]

    @classmethod
    def nowhere(cls, index: LatticeIndex, why: str, poses: int) -> Placed:
        return cls(index, math.inf, -math.inf, -math.inf, 0.0, why, np.full((poses, 5), np.nan))


class _Judge:
    """Judges bases for one sweep. Belongs to one thread."""

    def __init__(self, sweep: PlaceSweep) -> None:
        self._sweep, self._bases = sweep, sweep.bases
        arms = tuple(each.standing() for each in sweep.others)
        self._scene = replace(scene_from(json.loads(sweep.scene), folder=None), arms=arms)
        self._task = task_from(json.loads(sweep.task))
        self._arm = MountedArm(
            self._task,
            MotionLimits.uniform(
                velocity=sweep.velocity, acceleration=sweep.acceleration, jerk=sweep.jerk
            ),
            payload=sweep.payload,
            voltage=sweep.voltage,
            R_world_base=sweep.region.base((0, 0, 0, 0)).R,
            attached=self._scene.attached,
            by=sweep.by,
        )

    def shard(self, number: int) -> Columns:
        """The columns of a shard, one row a base: the fields of ``Screened`` or ``Placed``."""
        planned = self._sweep.planned
        count = PLANNED if planned else SCREENED
        indices = self._bases[number * count : (number + 1) * count]
        rows = [self._planned(each) if planned else self._screened(each) for each in indices]
        kind = Placed if planned else Screened
        columns = {name: [getattr(row, name) for row in rows] for name in kind._fields}
        return {name: np.array(column) for name, column in columns.items()}

    def _seen(self, T_cell_base: SE3) -> Scene:
        return self._sweep.region.seen_from(self._scene, T_cell_base)

    def _screened(self, index: LatticeIndex) -> Screened:
        T_cell_base = self._sweep.region.base(index)
        choice, missed = self._arm.choice(T_cell_base, self._seen(T_cell_base))
        if choice is None:
            return Screened(index, math.inf, -math.inf, -math.inf, missed)
        return Screened(index, self._arm.least_time(choice), *choice.bounds(), missed)

    def _planned(self, index: LatticeIndex) -> Placed:
        T_cell_base = self._sweep.region.base(index)
        scene = self._seen(T_cell_base)
        choice, _ = self._arm.choice(T_cell_base, scene)
        found = "Unreachable" if choice is None else self._arm.planned(choice, scene)
        if isinstance(found, str):
            return Placed.nowhere(index, found, len(self._task.poses))
        clearance, left = self._arm.figures(found, scene)
        robust = self._robust(T_cell_base)
        return Placed(index, found.time, clearance, left, robust, "", found.q)

    def _robust(self, T_cell_base: SE3) -> float:
        if not self._sweep.jittered:
            return math.nan
        jittered = list(self._sweep.region.jittered(T_cell_base))
        return sum(self._arm.reaches(T, self._seen(T)) for T in jittered) / len(jittered)
