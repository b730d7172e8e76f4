"""Sweep that computes which points of a grid the arm reaches, and how well.

The best of a point's free configurations is stored: the servos can hold it, farther from contact
(in ``STEPS``), more torque left, in this order. Points are whole multiples of the spacing in the
base frame, so that atlases of different size share them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.attributes import SERVO_VOLTAGES, LoadConfig
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_deg, to_mm
from so101_motion.files.scene_file import arms_from, arms_to, scene_from, scene_to
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.kinematics.batch_ik import (
    angles_between,
    configurations,
    facing,
    hands,
    pitch_towards,
)
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.torque import Payload, Strength
from so101_motion.tasks.sweeps.sweep import Columns

POINTS = 4096  # of a shard. Chosen: a quarter of a second of work, and some fifty kilobytes

_AT_ONCE = 256
"""Points that are computed together. Chosen: their arrays fit in the caches, and little memory is
returned to the system each time, which takes a tenth of a Dask worker's time at 1,024."""

PITCHES = 24  # pitches that are tried at a point, all around. Chosen: 15 degrees apart.

STEPS = (0.005, 0.01, 0.02, 0.04)
"""Steps of clearance beyond the margins by which configurations are compared [m]. Chosen."""

FINEST, COARSEST = 0.001, 0.2  # bounds of the spacing [m]

BRANCH_BITS = {("front", True): 1, ("front", False): 2, ("back", True): 4, ("back", False): 8}
"""The bit of each branch: side of the pan, and whether the elbow is up."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Points in a box, whole multiples of the spacing, x counting fastest."""

    spacing: float  # distance between neighbours [m]
    first: tuple[int, int, int]  # the smallest multiples, x, y, z
    counts: tuple[int, int, int]  # how many along x, y, z

    @property
    def size(self) -> int:
        return math.prod(self.counts)

    def steps(self, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """How many points along x, y, z lie before points, by their numbers, shape (n, 3)."""
        return np.stack(np.unravel_index(numbers, self.counts, order="F"), axis=1)

    def points(self, numbers: NDArray[np.int64]) -> Array:
        """Points by their numbers, shape (n, 3), [m]."""
        return np.asarray((self.steps(numbers) + np.array(self.first)) * self.spacing)


@dataclass(frozen=True, kw_only=True)
class ReachSweep:
    """The parameters of an atlas, as plain data."""

    spacing: float  # distance between the points of the grid [m]
    scene: str = '{"obstacles": []}'  # what is around the arm; see ``scene_text``
    frame: str = "tool"  # the frame of the gripper that is brought to the points
    approach: tuple[float, float, float] | None = None  # of the tool's z axis; None for any
    tolerance: float = math.radians(5.0)  # how far the approach may be off [rad]
    payload: float = 0.0  # what the hand carries, at the jaw's tip [kg]
    voltage: float = SERVO_VOLTAGES[0]  # the servos' rated voltage [V]

    def __post_init__(self) -> None:
        if not FINEST <= self.spacing <= COARSEST:
            known = f"must be {to_mm(FINEST):g} to {to_mm(COARSEST):g} mm"
            raise ConfigError("spacing", self.spacing, known)
        if self.approach is not None and not 1e-6 < math.hypot(*self.approach) < math.inf:
            raise ConfigError("approach", self.approach, "must be a direction, such as 0,0,-1")

    kind = "reach"
    unit = "points"

    @property
    def items(self) -> int:
        return self.grid.size

    @property
    def shards(self) -> int:
        return -(-self.grid.size // POINTS)

    @cached_property
    def grid(self) -> Grid:
        """The grid: all points that the arm is long enough for, whatever its joint limits."""
        model = RobotModel.load()
        structure = IkSolver(model).structure
        model.check_gripper_frame(self.frame)
        measures = structure.measures
        longest = structure.longest[self.frame]
        out = longest + abs(measures.shoulder[0])
        middle = np.array([*measures.pan, measures.shoulder[1]])
        reach = np.array([out, out, longest])
        first = np.ceil((middle - reach) / self.spacing).astype(int)
        last = np.floor((middle + reach) / self.spacing).astype(int)
        x, y, z = first.tolist()
        nx, ny, nz = (last - first + 1).tolist()
        return Grid(self.spacing, (x, y, z), (nx, ny, nz))

    def facts(self) -> Mapping[str, object]:
        fields = asdict(self)
        return {
            **fields,
            "scene": json.loads(self.scene),
            "grid_first": self.grid.first,
            "grid_counts": self.grid.counts,
            "pitches": PITCHES,
            "points_of_a_shard": POINTS,
        }

    def open(self) -> Callable[[int], Columns]:
        return _Fan(self).shard


def scene_text(scene: Scene) -> str:
    arms = {"arms": arms_to(scene.arms)} if scene.arms else {}
    return json.dumps({**scene_to(scene), **arms}, sort_keys=True)


def scene_in(text: str) -> Scene:
    """The scene of a text that ``scene_text`` made."""
    content = json.loads(text)
    arms = arms_from(content.pop("arms", []))
    return replace(scene_from(content, folder=None), arms=arms)


class _Ways(NamedTuple):
    """Configurations at points, within the joint limits."""

    q: Array  # joint angles, shape (n, 5), [rad]
    point: NDArray[np.int64]  # number of the point of each, shape (n,); ascending
    bit: NDArray[np.uint8]  # the bit of its branch, shape (n,)


class _Fan:
    """Computes points for one sweep. Belongs to one thread."""

    def __init__(self, sweep: ReachSweep) -> None:
        self._sweep, self._grid = sweep, sweep.grid
        model = RobotModel.load()
        payload = Payload.of(LoadConfig(mass=sweep.payload), model)
        self._collision = CollisionModel(model, scene_from(json.loads(sweep.scene), folder=None))
        self._structure = IkSolver(model).structure
        self._chain = ArmChain(model, sweep.frame)
        self._loaded = model if payload is None else model.with_payload(payload.mass, payload.com)
        self._holding = Strength.of_servos(sweep.voltage).holding
        pitches = 2.0 * math.pi / PITCHES * np.arange(PITCHES, dtype=np.float64) - math.pi
        if sweep.approach is not None:
            pitches = pitches[:1]  # it follows from the approach
        self._pitch = pitches[None, None]
        self._roll: Array = np.zeros_like(self._pitch)
        self._hands = hands(self._structure, sweep.frame, self._roll)
        self._bits = np.array([[1, 2], [4, 8]], dtype=np.uint8)[None, :, None, :]

    def shard(self, number: int) -> Columns:
        """The columns of a shard, one row for each point within the joint limits.

        ``point`` is its number in the grid; ``limits`` and ``branches`` are the bits of the
        branches within the joint limits, and of those that are free of contact as well; ``ways``
        counts the free configurations. The figures are those of the best one, ``q`` (n, 5) [rad]:
        ``clearance`` [m], ``torque_left`` (share of the servos' holding torque),
        ``manipulability`` [m^3/rad^3], the volume of the tool's velocity ellipsoid by Yoshikawa
        (1985). NaN without a free configuration.
        """
        begin = number * POINTS
        end = min(begin + POINTS, self._grid.size)
        parts = [
            self._look(np.arange(k, min(k + _AT_ONCE, end))) for k in range(begin, end, _AT_ONCE)
        ]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _look(self, numbers: NDArray[np.int64]) -> dict[str, NDArray[np.generic]]:
        ways = self._ways(numbers)
        points, place = np.unique(ways.point, return_inverse=True)
        n = len(points)
        limits, branches = np.zeros(n, np.uint8), np.zeros(n, np.uint8)
        np.bitwise_or.at(limits, place, ways.bit)
        free = np.logical_not(self._collision.touching(ways.q))
        q, place = ways.q[free], place[free]
        np.bitwise_or.at(branches, place, ways.bit[free])
        counts = np.bincount(place, minlength=n)
        left = (
            1.0 - np.abs(self._loaded.holding_torques(q)).max(axis=1, initial=0.0) / self._holding
        )
        level = np.zeros(len(q))
        for step in STEPS:
            level -= self._collision.touching(q, extra=step)
        order = np.lexsort((-left, -level, left < 0.0, place))
        best = order[np.unique(place[order], return_index=True)[1]]
        return {
            "point": points,
            "limits": limits,
            "branches": branches,
            "ways": counts.astype(np.uint16),
            **self._figures(n, place[best], q[best], left[best]),
        }

    def _figures(
        self, n: int, place: NDArray[np.int64], q: Array, left: Array
    ) -> dict[str, NDArray[np.generic]]:
        """The columns of the best configurations; ``place`` has the row of each, of ``n``."""
        J = self._chain.positions_and_jacobians(q)[1]
        volumes = np.sqrt(np.maximum(np.linalg.det(J @ J.transpose(0, 2, 1)), 0.0))
        clearances = np.array([self._collision.clearance(each).distance for each in q])
        columns = {}
        for name, values in (
            ("clearance", clearances),
            ("torque_left", left),
            ("manipulability", volumes),
            ("q", q),
        ):
            whole = np.full((n, *np.shape(values)[1:]), np.nan, dtype=np.float32)
            whole[place] = values.reshape(-1, *whole.shape[1:])
            columns[name] = whole
        return columns

    def _ways(self, numbers: NDArray[np.int64]) -> _Ways:
        p = self._grid.points(numbers)
        m = self._structure.measures
        ahead = np.maximum(np.hypot(p[:, 0] - m.pan[0], p[:, 1] - m.pan[1]) - abs(m.shoulder[0]), 0)
        near = np.hypot(ahead, p[:, 2] - m.shoulder[1]) < self._structure.longest[self._sweep.frame]
        numbers, p = numbers[near], p[near]
        target = facing(self._structure, p, self._hands.lateral)
        pitch = self._pitch
        allowed: NDArray[np.bool_] | bool = True
        if self._sweep.approach is not None:
            axis = np.array(self._sweep.approach) / math.hypot(*self._sweep.approach)
            pitch = pitch_towards(self._structure, target.pan, np.broadcast_to(axis, p.shape))
            azimuth = m.azimuth + m.pan_sign * target.pan
            elevation = m.approach_elevation - pitch
            along = np.stack(
                [
                    np.cos(elevation) * np.cos(azimuth),
                    np.cos(elevation) * np.sin(azimuth),
                    np.sin(elevation),
                ],
                axis=-1,
            )
            allowed = (angles_between(along, axis) <= self._sweep.tolerance)[..., None]
        found = configurations(self._structure, target, self._hands, pitch, self._roll)
        there = (found.excess <= 0.0) & allowed
        bits = np.broadcast_to(self._bits, there.shape)
        return _Ways(found.q[there], numbers[np.nonzero(there)[0]], bits[there])


def in_words(sweep: ReachSweep) -> str:
    nx, ny, nz = sweep.grid.counts
    held = f", {sweep.payload * 1e3:g} g in the hand" if sweep.payload else ""
    approach = ""
    if sweep.approach is not None:
        towards = ", ".join(f"{each:g}" for each in sweep.approach)
        approach = f", approach ({towards}) within {to_deg(sweep.tolerance):g} deg"
    return (
        f"{sweep.frame} to {sweep.items} points, {nx} x {ny} x {nz},"
        f" {to_mm(sweep.spacing):g} mm apart{approach}{held}"
    )
