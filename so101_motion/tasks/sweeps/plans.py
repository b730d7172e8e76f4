"""Sweep that plans many random motions as a data set, with LeRobot's names and units.

The result depends only on the seed and the problem's number. So a search ends after an amount of
work, not after a time, and each shard begins with a fresh planner, which counts work in batches
that continue from plan to plan.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.attributes import SERVO_VOLTAGES, LoadConfig
from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_deg, to_mm
from so101_motion.files.scene_file import scene_from
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Plan, Planner, PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Payload, Strength, carried
from so101_motion.tasks.sweeps.folder import SweepFolder
from so101_motion.tasks.sweeps.reach import STEPS
from so101_motion.tasks.sweeps.sweep import NEVER, Columns, WorkBudget

_SCATTER = 1  # keeps the random numbers of scenes different from those of problems
PROBLEMS = 100  # of a shard. Chosen: a second or two of work, some hundred kilobytes

NAMES = tuple(f"{joint}.pos" for joint in (*ARM_JOINTS, GRIPPER_JOINT))
"""Names of the columns of ``action``, as in LeRobot."""

_LOOKS = 2000  # checkpoints after which a plan is given up. Chosen: some seconds.
_TRIES = 100_000  # A scene is refused if so many random configurations are not free. Chosen.
SOLVED = ""  # the value of ``why`` for a problem that has a motion


@dataclass(frozen=True, kw_only=True)
class PlansSweep:
    """The motions to plan and the parameters, as plain data."""

    count: int  # number of problems
    seed: int = 0  # seed of the random numbers
    scenes: tuple[str, ...] = ('{"obstacles": []}',)  # JSON texts; shards take them in turn
    scatter: float = 0.0  # how far each obstacle is moved at most, differently in each shard [m]
    velocity: float = 3.0  # velocity cap of the joints [rad/s]
    acceleration: float = 10.0  # acceleration cap [rad/s^2]
    jerk: float = 500.0  # jerk cap [rad/s^3]
    fps: int = 30  # setpoints a second in the data set
    payload: float = 0.0  # mass in the hand, at the jaw's tip [kg]
    voltage: float | None = SERVO_VOLTAGES[0]  # of the servos [V]; None to ignore torques

    def __post_init__(self) -> None:
        if not self.scenes:
            raise ConfigError("scenes", self.scenes, "must have at least one scene")
        bounds = (("count", 1, 10**9), ("fps", 1, 100), ("seed", 0, 2**63), ("scatter", 0, 1))
        for key, least, most in bounds:
            value = getattr(self, key)
            if not least <= value <= most:
                raise ConfigError(key, value, f"must be {least} to {most}")

    kind = "plans"
    unit = "plans"

    @property
    def items(self) -> int:
        return self.count

    @property
    def shards(self) -> int:
        return -(-self.count // PROBLEMS)

    def facts(self) -> Mapping[str, object]:
        scenes = [json.loads(scene) for scene in self.scenes]
        names = {"action_names": NAMES, "action_units": "degrees, gripper per cent"}
        return {**asdict(self), "scenes": scenes, **names, "problems_of_a_shard": PROBLEMS}

    def open(self) -> Callable[[int], Columns]:
        return _Source(self).shard


def scene_of_shard(
    scenes: Sequence[Mapping[str, Any]], scatter: float, seed: int, shard: int
) -> Mapping[str, Any]:
    """The scene of a shard, as JSON values; obstacles are moved by up to ``scatter`` [m]."""
    scene = scenes[shard % len(scenes)]
    if scatter == 0.0:
        return scene
    random = np.random.default_rng((seed, shard, _SCATTER))
    obstacles = []
    for each in scene.get("obstacles", ()):
        x, y, z = each.get("position_mm", (0.0, 0.0, 0.0))
        dx, dy = to_mm(random.uniform(-scatter, scatter, 2)).tolist()
        obstacles.append({**each, "position_mm": [x + dx, y + dy, z]})
    return {**scene, "obstacles": obstacles}


class _Source:
    """Draws problems and plans them, for one sweep. Belongs to one thread."""

    def __init__(self, sweep: PlansSweep) -> None:
        self._sweep, self._model = sweep, RobotModel.load()
        self._limits = MotionLimits.uniform(
            velocity=sweep.velocity, acceleration=sweep.acceleration, jerk=sweep.jerk
        )
        self._strength = None if sweep.voltage is None else Strength.of_servos(sweep.voltage)
        self._payload = Payload.of(LoadConfig(mass=sweep.payload), self._model)
        self._scenes = [json.loads(each) for each in sweep.scenes]
        self._patience = WorkBudget(_LOOKS)

    def shard(self, number: int) -> Columns:
        """The columns of a shard.

        Of each of n problems: ``problem`` (its number), ``start``, ``goal`` (n, 5) [rad], ``why``
        there is no motion (empty if there is one), ``duration`` [s], ``room``: beyond the margins,
        how far all setpoints stay away from contact, in the steps of ``reach.STEPS`` [m], and
        ``frames``, how many rows of ``action`` are its own. Of all motions, one after the other:
        ``action`` (m, 6), named as in ``NAMES``; ``velocity`` (m, 5) [deg/s]; ``timestamp`` [s].
        """
        sweep = self._sweep
        scene = scene_from(
            scene_of_shard(self._scenes, sweep.scatter, sweep.seed, number), folder=None
        )
        planner = Planner(self._model, self._patience)
        collision = CollisionModel(self._model, scene)
        held = carried(self._payload, scene.attached)
        loaded = self._model if held is None else self._model.with_payload(held.mass, held.com)
        first = number * PROBLEMS
        problems = range(first, min(first + PROBLEMS, sweep.count))
        made = []
        for problem in problems:
            random = np.random.default_rng((sweep.seed, problem))
            start, goal = (self._drawn(random, collision, loaded) for _ in range(2))
            made.append(self._planned(planner, collision, scene, problem, start, goal))
        return {
            "problem": np.arange(problems.start, problems.stop, dtype=np.int64),
            **{name: np.array([getattr(each, name) for each in made]) for name in _OF_PROBLEM},
            **{name: np.concatenate([getattr(each, name) for each in made]) for name in _OF_FRAMES},
        }

    def _drawn(
        self, random: np.random.Generator, collision: CollisionModel, loaded: RobotModel
    ) -> Array:
        """A random configuration, free and bearable, shape (5,), [rad]."""
        for _ in range(_TRIES):
            q = random.uniform(self._model.lower, self._model.upper)
            if not collision.is_free(q):
                continue
            if self._strength is None:
                return q
            if np.abs(loaded.holding_torques(q[None])).max() <= self._strength.holding:
                return q
        raise ConfigError("scene", None, "leaves the arm no free configuration")

    def _planned(
        self,
        planner: Planner,
        collision: CollisionModel,
        scene: Scene,
        problem: int,
        start: Array,
        goal: Array,
    ) -> _Motion:
        request = PlanRequest(
            q_start=start,
            goal=JointGoal(q=goal),
            limits=self._limits,
            scene=scene,
            payload=self._payload,
            strength=self._strength,
            seed=problem,
            time_budget=NEVER,
            route_effort=1,  # a sweep wants many motions
        )
        self._patience.reset()
        try:
            plan = planner.plan(request)
        except So101Error as error:
            return _Motion.none(start, goal, type(error).__name__)
        return self._resampled(plan, collision)

    def _resampled(self, plan: Plan, collision: CollisionModel) -> _Motion:
        trajectory = plan.trajectory
        clear = [step for step in STEPS if not collision.touching(trajectory.q, extra=step).any()]
        fps = self._sweep.fps
        # The last one is at or after the end, where the arm rests.
        t = np.arange(int(np.ceil(plan.duration * fps - 1e-9)) + 1) / fps
        q, qd, _ = trajectory.at(np.minimum(t, plan.duration))
        return _Motion(
            start=plan.q_start,
            goal=plan.q_goal,
            why=SOLVED,
            duration=plan.duration,
            room=max(clear, default=0.0),
            frames=len(t),
            action=np.column_stack([to_deg(q), np.zeros(len(q))]).astype(np.float32),
            velocity=to_deg(qd).astype(np.float32),
            timestamp=t.astype(np.float32),
        )


class _Motion(NamedTuple):
    """A problem and its result; see ``_Source.shard``."""

    start: Array
    goal: Array
    why: str
    duration: float
    room: float
    frames: int
    action: NDArray[np.float32]
    velocity: NDArray[np.float32]
    timestamp: NDArray[np.float32]

    @classmethod
    def none(cls, start: Array, goal: Array, why: str) -> _Motion:
        action, velocity, timestamp = (np.zeros(shape, np.float32) for shape in ((0, 6), (0, 5), 0))
        return cls(start, goal, why, np.nan, np.nan, 0, action, velocity, timestamp)


_OF_FRAMES = ("action", "velocity", "timestamp")
_OF_PROBLEM = tuple(name for name in _Motion._fields if name not in _OF_FRAMES)


class Episode(NamedTuple):
    """A motion of the data set."""

    problem: int
    action: NDArray[np.float32]  # as in ``NAMES``, shape (m, 6), [deg], the gripper [%]
    velocity: NDArray[np.float32]  # shape (m, 5), [deg/s]
    timestamp: NDArray[np.float32]  # shape (m,), [s]
    room: float  # beyond the margins, how far all setpoints stay away from contact at least [m]


def episodes(folder: Path | str) -> Iterator[Episode]:
    """Read the motions in the folder of a sweep of plans, one by one, complete or not."""
    for shard in _shards(folder):
        ends = np.cumsum(shard["frames"])
        for k in np.flatnonzero(shard["frames"]):
            rows = slice(ends[k] - shard["frames"][k], ends[k])
            yield Episode(
                problem=int(shard["problem"][k]),
                action=shard["action"][rows],
                velocity=shard["velocity"][rows],
                timestamp=shard["timestamp"][rows],
                room=float(shard["room"][k]),
            )


def plans_summary(folder: Path | str) -> dict[str, float]:
    """Problems, solved, failures; durations [s]; room [m]; frames of a sweep of plans."""
    whys: Counter[str] = Counter()
    durations, rooms, frames = [], [], 0
    for shard in _shards(folder):
        whys.update(shard["why"].tolist())
        solved = shard["frames"] > 0
        durations.append(shard["duration"][solved])
        rooms.append(shard["room"][solved])
        frames += int(shard["frames"].sum())
    solved_count = whys.pop(SOLVED, 0)
    figures: dict[str, float] = {
        "problems": solved_count + whys.total(),
        "solved": solved_count,
        "frames": frames,
        **{f"failed_{why}": count for why, count in sorted(whys.items())},
    }
    if solved_count:
        duration, room = np.concatenate(durations), np.concatenate(rooms)
        for name, share in (("min", 0.0), ("median", 0.5), ("max", 1.0)):
            figures[f"duration_{name}_s"] = float(np.quantile(duration, share))
        for step in STEPS:
            figures[f"room_{round(step * 1e3)}_mm"] = int((room >= step).sum())
    return figures


def _shards(folder: Path | str) -> Iterator[dict[str, NDArray[Any]]]:
    place = SweepFolder(Path(folder))
    manifest = place.manifest()
    if manifest.get("kind") != "plans":
        raise ConfigError("plans", str(folder), f"is a sweep of {manifest.get('kind')}")
    for number in range(int(manifest["shards"])):
        shard = place.read(number)
        if shard is not None:
            yield shard
