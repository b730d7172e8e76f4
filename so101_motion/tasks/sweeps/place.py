"""The lattice of places for a base, and what each is worth: reach, time, clearance, torque left."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple

import numpy as np

from so101_motion.common.attributes import SERVO_VOLTAGES
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array, rot_x, rot_y, rot_z
from so101_motion.planning.collision.scene import FLOOR_Z, Box, Obstacle, Scene
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.tasks.sweeps.mounted_arm import CRITERIA, MountedArm
from so101_motion.tasks.sweeps.placement_task import task_from
from so101_motion.tasks.sweeps.reach import scene_in
from so101_motion.tasks.sweeps.sweep import Columns

COARSE = 8  # the first round uses every so many steps of the lattice. A power of two.
TABLE = "table"  # name of the table in messages, for an arm that does not stand on it
MOUNTS = ("table", "wall", "upside-down")  # standing, on a wall, hanging from above
JITTER, JITTER_TURN = 0.005, math.radians(2.0)  # how inexactly bases are mounted [m], [rad]
_MOST = 100_000  # most bases in the first round. Chosen: some minutes' work.

_TABLE_SIZE = np.array([3.0, 3.0, 0.05])

LatticeIndex = tuple[int, int, int, int]  # steps along x, y, z and of the turn


@dataclass(frozen=True, kw_only=True)
class Region:
    """Where a base may be mounted, as plain data."""

    x: tuple[float, float]  # smallest and largest x in the cell [m]
    y: tuple[float, float]  # the same for y
    z: tuple[float, float] = (0.0, 0.0)  # the same for z; 0 is on the table
    # the same for the turn about the base's own z axis [rad]; 0 faces along the cell's x
    turn: tuple[float, float] = (-math.pi, math.pi)
    mount: str = "table"  # one of ``MOUNTS``
    facing: float = 0.0  # direction of a wall's normal, counted from x towards y [rad]
    spacing: float = 0.04  # distance between the bases of the first round [m]
    turn_step: float = math.radians(30.0)  # turn between the bases of the first round [rad]

    def __post_init__(self) -> None:
        for key in ("x", "y", "z", "turn"):
            low, high = getattr(self, key)
            if not (math.isfinite(low) and math.isfinite(high) and low <= high):
                raise ConfigError(key, [low, high], "must be two numbers, the smaller one first")
        if self.mount not in MOUNTS:
            raise ConfigError("mount", self.mount, f"must be {' or '.join(MOUNTS)}")
        for key, least, most in (("spacing", 0.004, 1.0), ("turn_step", 0.01, math.pi)):
            if not least <= getattr(self, key) <= most:
                raise ConfigError(key, getattr(self, key), f"must be {least:g} to {most:.3g}")
        if math.prod(self._counts()) > _MOST:
            raise ConfigError(
                "spacing", self.spacing,
                f"makes more than {_MOST} bases; take a wider one, or a smaller region",
            )  # fmt: skip

    def first_round(self) -> Iterator[LatticeIndex]:
        for x, y, z, turn in itertools.product(*(range(count) for count in self._counts())):
            yield COARSE * x, COARSE * y, COARSE * z, COARSE * turn

    def around(self, index: LatticeIndex, step: int) -> Iterator[LatticeIndex]:
        """The bases of the region next to one, ``step`` steps away along some of the axes."""
        counts = self._counts()
        ways = [(0,) if count == 1 else (-step, 0, step) for count in counts]
        for offsets in itertools.product(*ways):
            moved = [at + by for at, by in zip(index, offsets, strict=True)]
            if self._whole_turn:
                moved[3] %= COARSE * counts[3]
            last = (COARSE * (count - 1) for count in counts[:3])
            inside = all(0 <= at <= end for at, end in zip(moved, last, strict=False))
            turns = self._whole_turn or 0 <= moved[3] <= COARSE * (counts[3] - 1)
            if inside and turns and tuple(moved) != index:
                yield moved[0], moved[1], moved[2], moved[3]

    def are_apart(self, index: LatticeIndex, other: LatticeIndex) -> bool:
        """Whether two bases are more than a step of the first round apart, along any axis."""
        off = [abs(a - b) for a, b in zip(index, other, strict=True)]
        if self._whole_turn:
            off[3] = min(off[3], COARSE * self._counts()[3] - off[3])
        return max(off) > COARSE

    def place(self, index: LatticeIndex) -> tuple[float, float, float, float]:
        """Position of a base of the lattice, x, y, z [m], and its turn [rad]."""
        ends = (self.x, self.y, self.z, self.turn)
        steps = (self.spacing,) * 3 + (self.turn_step,)
        x, y, z, turn = (
            (low if self._whole_turn and axis == 3 else 0.5 * (low + high - (count - 1) * step))
            + at * step / COARSE
            for axis, ((low, high), count, step, at) in enumerate(
                zip(ends, self._counts(), steps, index, strict=True)
            )
        )
        return x, y, z, math.remainder(turn, 2.0 * math.pi)

    def base(self, index: LatticeIndex) -> SE3:
        """``T_cell_base`` of a base of the lattice."""
        *p, turn = self.place(index)
        return SE3(self._R_mount @ rot_z(turn), np.array(p))

    def jittered(self, T_cell_base: SE3) -> Iterator[SE3]:
        """A base as it may be mounted in practice: 5 mm off along both axes, and 2 degrees."""
        for x, y, turn in itertools.product((-1.0, 1.0), repeat=3):
            off = np.array([x * JITTER, y * JITTER, 0.0])
            yield T_cell_base @ SE3(rot_z(turn * JITTER_TURN), off)

    def seen_from(self, scene: Scene, T_cell_base: SE3) -> Scene:
        """The scene of the cell in the frame of a base.

        For a standing arm the floor is the table, however high its base. An arm on a wall or
        overhead has that surface as its floor, and the table as an obstacle.
        """
        T_base_cell = T_cell_base.inverse
        obstacles = [
            replace(each, T_base_obstacle=T_base_cell @ each.T_base_obstacle)
            for each in scene.obstacles
        ]
        arms = tuple(replace(each, T_base_arm=T_base_cell @ each.T_base_arm) for each in scene.arms)
        scene = replace(scene, arms=arms)
        if self.mount == "table":
            floor_z = scene.floor_z
            if floor_z is not None:
                floor_z -= float(T_cell_base.p[2])
            return replace(scene, obstacles=tuple(obstacles), floor_z=floor_z)
        if scene.floor_z is not None:
            x, y, _ = T_cell_base.p.tolist()
            middle = SE3.from_translation((x, y, scene.floor_z - 0.5 * float(_TABLE_SIZE[2])))
            table = Box(size=_TABLE_SIZE)
            obstacles.append(
                Obstacle(name=TABLE, shape=table, T_base_obstacle=T_base_cell @ middle)
            )
        return replace(scene, obstacles=tuple(obstacles), floor_z=FLOOR_Z)

    @property
    def _whole_turn(self) -> bool:
        return self.turn[1] - self.turn[0] >= 2.0 * math.pi - 1e-6

    @property
    def _R_mount(self) -> Array:
        if self.mount == "upside-down":
            return rot_x(math.pi)
        if self.mount == "wall":  # z along the normal, x up
            return rot_z(self.facing) @ rot_y(0.5 * math.pi) @ rot_z(math.pi)
        return np.eye(3)

    def _counts(self) -> tuple[int, int, int, int]:
        def along(ends: tuple[float, float], step: float) -> int:
            return int((ends[1] - ends[0]) / step + 1e-9) + 1

        turns = along(self.turn, self.turn_step)
        if self._whole_turn:
            turns = max(1, round(2.0 * math.pi / self.turn_step))
        x, y, z = (along(ends, self.spacing) for ends in (self.x, self.y, self.z))
        return x, y, z, turns


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
    # the cell, as ``scene_text`` writes it, with its other arms; plans keep clear of those in each
    # of their configurations, but not between them
    scene: str = '{"obstacles": []}'
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
        self._scene = scene_in(sweep.scene)
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
