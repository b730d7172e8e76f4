"""A task for the placement search: poses of the tool in the cell, in order, with tolerances.

Lengths are millimetres in the frame of the cell. That is the base frame of an arm that stands on
the table at the origin, with z up, so a program that was taught on such an arm can be used as a
task. ``docs/sweeps.md`` has an example.

The position, of the ``frame`` ``"tool"`` or ``"jaw_tip"``, is kept exactly. ``approach`` is the
direction of the tool's z axis, ``rpy_deg`` the tool's orientation. Without ``roll_tolerance_deg``
the rotation about the approach is free; without ``approach`` and ``rpy_deg`` only the point counts.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from so101_motion.common.attributes import Attributes
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array, frame_along, freeze
from so101_motion.common.units import to_deg, to_m, to_mm, to_rad
from so101_motion.files import user_storage
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.program import Program, Waypoint
from so101_motion.tasks.program.files import OLDER
from so101_motion.tasks.program.files import SCHEMA as PROGRAM_SCHEMA
from so101_motion.tasks.program.files import read as read_program
from so101_motion.tasks.program.program import LONGEST_PAUSE

SCHEMA = "so101/task/1"

APPROACH_TOLERANCE = to_rad(10.0)  # of the tool's approach by default [rad]. Chosen.
FRAMES = ("tool", "jaw_tip")  # the frames that can be brought to a task's points

_ENDLESS = "endless"
_KNOWN = (
    "name",
    "position_mm",
    "approach",
    "rpy_deg",
    "approach_tolerance_deg",
    "roll_tolerance_deg",
    "aperture_percent",
    "pause_s",
    "pass",
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TaskPose:
    """A pose of the tool in the cell."""

    name: str  # its name in messages
    p: Array  # position of the task's frame, shape (3,), [m]
    R: Array | None = None  # orientation of the tool, shape (3, 3); None if only the point counts
    approach_tolerance: float = APPROACH_TOLERANCE  # how far its z axis may be off [rad]
    roll_tolerance: float | None = None  # about that axis [rad]; None if that is free
    aperture: float | None = None  # as in a program's waypoint
    pause: float = 0.0  # as in a program's waypoint [s]
    passes: bool = False  # as in a program's waypoint

    def __post_init__(self) -> None:
        freeze(self, p=(3,))
        if not np.all(np.isfinite(self.p)):
            raise ConfigError(self.name, self.p.tolist(), "must be a point [m]")
        if self.R is not None:
            freeze(self, R=(3, 3))
        self.waypoint(np.zeros(5))  # refuses what no waypoint can be

    def waypoint(self, q: Array) -> Waypoint:
        """This pose as a program's waypoint, with joint angles, shape (5,), [rad]."""
        return Waypoint(
            name=self.name, q=q, aperture=self.aperture, pause=self.pause, passes=self.passes
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacementTask:
    """Poses in the order in which they are visited."""

    poses: tuple[TaskPose, ...]  # at least two
    rounds: int | None = None  # as in a program; unless 1, the path back to the first counts
    frame: str = "tool"  # the frame that is brought to the points: ``"tool"`` or ``"jaw_tip"``

    def __post_init__(self) -> None:
        if len(self.poses) < 2:
            raise ConfigError("poses", len(self.poses), "must be at least two")
        self.program(np.zeros((len(self.poses), 5)))  # refuses what no program can be

    def program(self, q: Array) -> Program:
        """This task as a program, with the joint angles at each pose, shape (n, 5), [rad]."""
        waypoints = (pose.waypoint(each) for pose, each in zip(self.poses, q, strict=True))
        return Program.of_waypoints(waypoints, rounds=self.rounds)


def read_task(path: Path, *, approach_tolerance: float = APPROACH_TOLERANCE) -> PlacementTask:
    """Read a task, or a program as a task with this tolerance [rad]; raises ``ConfigError``."""
    largest, programs = user_storage.LARGEST_OF_ALL, (PROGRAM_SCHEMA, *OLDER)
    content = user_storage.read(path, schema=SCHEMA, also=programs, largest=largest)
    if content["schema"] in programs:
        return task_of(read_program(path), approach_tolerance=approach_tolerance)
    return task_from(content)


def task_of(program: Program, *, approach_tolerance: float = APPROACH_TOLERANCE) -> PlacementTask:
    """Make a task for an arm anywhere from a program that was taught on an arm at the origin.

    The tool goes to the same points with the same approach within ``approach_tolerance`` [rad]; the
    rotation about it is free. ``ConfigError`` if it has loops, or picks items.
    """
    for key, many in (("loops", program.loops), ("items", program.picking)):
        if many:
            reason = "are not possible in a task; save the program without them"
            raise ConfigError(key, len(many), reason)
    model = RobotModel.load()
    poses = []
    for each in program.waypoints:
        T = model.frame(each.q)
        poses.append(
            TaskPose(
                name=each.name, p=T.p, R=T.R, approach_tolerance=approach_tolerance,
                aperture=each.aperture, pause=each.pause, passes=each.passes,
            )
        )  # fmt: skip
    return PlacementTask(poses=tuple(poses), rounds=program.rounds)


def task_from(content: Mapping[str, object]) -> PlacementTask:
    """Make a task from the parsed JSON of a file; ``ConfigError`` names what is not valid."""
    given = Attributes(content, ("schema", "rounds", "frame", "poses"), kind="entry of a task")
    poses, rounds = content.get("poses"), content.get("rounds", _ENDLESS)
    if not isinstance(poses, list):
        raise ConfigError("poses", poses, "must be a list of poses")
    if rounds != _ENDLESS and (isinstance(rounds, bool) or not isinstance(rounds, int)):
        raise ConfigError("rounds", rounds, f'must be a whole number, or "{_ENDLESS}"')
    return PlacementTask(
        poses=tuple(_pose(number, each) for number, each in enumerate(poses, 1)),
        rounds=rounds if isinstance(rounds, int) else None,
        frame=given.choice("frame", FRAMES),
    )


def task_text(task: PlacementTask) -> str:
    poses = []
    for each in task.poses:
        entry: dict[str, object] = {"name": each.name, "position_mm": to_mm(each.p).tolist()}
        if each.R is not None:
            entry["rpy_deg"] = to_deg(SE3(each.R, each.p).rpy).tolist()
            entry["approach_tolerance_deg"] = to_deg(each.approach_tolerance)
        if each.roll_tolerance is not None:
            entry["roll_tolerance_deg"] = to_deg(each.roll_tolerance)
        if each.aperture is not None:
            entry["aperture_percent"] = 100.0 * each.aperture
        poses.append({**entry, "pause_s": each.pause, "pass": each.passes})
    rounds = _ENDLESS if task.rounds is None else task.rounds
    whole = {"schema": SCHEMA, "rounds": rounds, "frame": task.frame, "poses": poses}
    return json.dumps(whole, sort_keys=True)


def _pose(number: int, content: object) -> TaskPose:
    what = f"pose {number}"
    if not isinstance(content, Mapping):
        raise ConfigError(what, content, 'must be {"name": ..., "position_mm": [x, y, z]}')
    try:
        given = Attributes(content, _KNOWN, kind="entry of a pose")
        R = _rotation(given)
        roll = given.number("roll_tolerance_deg", 180.0, lower=0.0, upper=180.0, unit="deg")
        if given.given("roll_tolerance_deg") and not given.given("rpy_deg"):
            raise ConfigError("roll_tolerance_deg", roll, "needs rpy_deg, which says what it is of")
        approach = given.number(
            "approach_tolerance_deg", to_deg(APPROACH_TOLERANCE), lower=0.1, upper=90.0, unit="deg"
        )
        aperture = given.number("aperture_percent", 0.0, lower=0.0, upper=100.0, unit="%")
        return TaskPose(
            name=user_storage.checked_name(content.get("name", what), what="pose"),
            p=to_m(_three(given, "position_mm", 10_000.0)),
            R=R,
            approach_tolerance=to_rad(approach),
            roll_tolerance=to_rad(roll) if given.given("roll_tolerance_deg") else None,
            aperture=aperture / 100.0 if given.given("aperture_percent") else None,
            pause=given.number("pause_s", 0.0, lower=0.0, upper=LONGEST_PAUSE, unit="s"),
            passes=given.flag("pass", False),
        )
    except ConfigError as error:
        raise ConfigError(f"{what}: {error.key}", error.value, error.reason) from None


def _rotation(given: Attributes) -> Array | None:
    if given.given("approach") and given.given("rpy_deg"):
        raise ConfigError("approach", None, "rpy_deg says the same; leave one of them out")
    if given.given("rpy_deg"):
        return SE3.from_rpy(to_rad(_three(given, "rpy_deg", 360.0))).R
    if not given.given("approach"):
        return None
    axis = _three(given, "approach", 1e6)
    if math.hypot(*axis.tolist()) < 1e-6:
        raise ConfigError("approach", axis.tolist(), "must be a direction, such as [0, 0, -1]")
    return frame_along(axis)


def _three(given: Attributes, key: str, most: float) -> Array:
    numbers = given.numbers(key, count=3, lower=-most, upper=most)
    if len(numbers) != 3:
        raise ConfigError(key, list(numbers), "must be three numbers")
    return np.array(numbers)
