"""Check a program in another scene, or with another calibration: which waypoints and paths fail.

A program is planned again whenever it runs. So this checks whether each waypoint can still be
reached and whether there still is a path to it. A shard is the path to one stop, or back to where a
loop begins. The path to the first stop of a program that runs once begins wherever the arm is, so
only its waypoints are checked.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.common.attributes import SERVO_VOLTAGES
from so101_motion.common.errors import ConfigError, PlanningError
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_deg
from so101_motion.files.scene_file import scene_from
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Payload, Strength, place_in_hand
from so101_motion.tasks.program.files import program_from, program_to
from so101_motion.tasks.program.program import Program
from so101_motion.tasks.program.rehearsal import plan_leg
from so101_motion.tasks.sweeps.folder import SweepFolder
from so101_motion.tasks.sweeps.joint_reading import JointReading
from so101_motion.tasks.sweeps.packed import Columns
from so101_motion.tasks.sweeps.scene_legs import SceneLegs, jaw_angles


@dataclass(frozen=True, kw_only=True)
class ProgramCheckSweep:
    """A check of a program, as plain data.

    Attributes:
        program: The program as JSON text; see ``program_text``.
        scene: What is around the arm now, as the JSON text of a scene.
        reading: Converts its joint angles to those of the present calibration; None if it is the
            same.
        velocity: Velocity cap of the joints [rad/s].
        acceleration: Acceleration cap [rad/s^2].
        jerk: Jerk cap [rad/s^3].
        payload: Mass in the hand, at the jaw's tip [kg].
        voltage: The servos' rated voltage [V].
    """

    program: str
    scene: str
    reading: JointReading | None = None
    velocity: float = 3.0
    acceleration: float = 7.5
    jerk: float = 500.0
    payload: float = 0.0
    voltage: float = SERVO_VOLTAGES[0]

    kind = "check-program"
    unit = "stops"

    @cached_property
    def taught(self) -> Program:
        """The program."""
        return program_from(json.loads(self.program))

    @property
    def items(self) -> int:
        """How many paths from stop to stop it has."""
        return len(_paths(self.taught))

    shards = items

    def facts(self) -> Mapping[str, object]:
        """Its parameters."""
        parsed = {"program": json.loads(self.program), "scene": json.loads(self.scene)}
        return {**asdict(self), **parsed}

    def open(self) -> Callable[[int], Columns]:
        """Load the arm, the scene and the program."""
        return _Check(self).shard


def program_text(program: Program) -> str:
    """A program as plain text, for a sweep."""
    return json.dumps(program_to(program), sort_keys=True)


class _Check:
    """Checks the paths of a program. Belongs to one thread."""

    def __init__(self, sweep: ProgramCheckSweep) -> None:
        self._reading, program = sweep.reading, sweep.taught
        if self._reading is not None:
            q = self._reading.angles(np.array([each.q for each in program.waypoints]))
            moved = zip(program.waypoints, q, strict=True)
            program = replace(program, waypoints=tuple(replace(each, q=of) for each, of in moved))
        self._program, self._paths = program, _paths(program)
        self._model, self._sweep = RobotModel.load(), sweep
        self._scene = scene_from(json.loads(sweep.scene), folder=None)
        self._collision = CollisionModel(self._model, self._scene)
        apertures = [each.aperture for each in program.waypoints]
        self._jaws = jaw_angles(apertures, goes_around=program.rounds != 1)

    def shard(self, number: int) -> Columns:
        """The columns of a shard: n waypoints up to a stop, and the path to it.

        Of the waypoints, shape (n,): ``waypoint``, the index in the program; ``waypoint_problem``,
        why the arm cannot be there, empty if it can. Of the path, shape (1,): ``path_problem``, why
        there is no path, empty if there is one or none was planned because a waypoint has a
        problem; ``duration`` of the motion [s], 0 without a path.
        """
        origin, indices = self._paths[number]
        waypoint_problems = [
            self._blocked(index, before)
            for index, before in zip(indices, (origin, *indices), strict=False)
        ]
        path_problem, duration = "", 0.0
        # Where the arm comes from is not known if the program runs once.
        begin, leg = (indices[0], indices[1:]) if origin is None else (origin, indices)
        if len(leg) and not any(waypoint_problems) and not self._blocked(begin, None):
            path_problem, duration = self._planned(
                leg, self._program.waypoints[begin].q, self._jaws[begin]
            )
        return {
            "waypoint": np.array(indices, dtype=np.int64),
            "waypoint_problem": np.array(waypoint_problems, dtype="U200"),
            "path_problem": np.array([path_problem], dtype="U200"),
            "duration": np.array([duration]),
        }

    def _blocked(self, index: int, before: int | None) -> str:
        q = self._program.waypoints[index].q
        if self._reading is not None and (beyond := self._reading.beyond(q)) is not None:
            joint, over = beyond
            return f"{joint} would be {to_deg(over):.1f} deg beyond its travel"
        try:
            self._model.check_limits(q)
        except PlanningError as error:
            return str(error)
        arrives = index if before is None else before  # with the jaw as it is there
        for jaw in {self._jaws[arrives], self._jaws[index]}:
            if self._collision.touching(q[None], jaw).any():
                return self._collision.clearance(q, jaw).message()
        return ""

    def _planned(self, indices: range, q_start: Array, q_jaw: float) -> tuple[str, float]:
        sweep = self._sweep
        limits = MotionLimits.uniform(
            velocity=sweep.velocity, acceleration=sweep.acceleration, jerk=sweep.jerk
        )
        payload = None
        if sweep.payload > 0.0:
            x, y, z = place_in_hand(self._model).tolist()
            payload = Payload(mass=sweep.payload, com=(x, y, z))
        strength = Strength.of_servos(sweep.voltage)
        legs = SceneLegs(self._model, self._scene, limits, payload=payload, strength=strength)
        try:
            plan = plan_leg(legs, self._program, indices, q_start, q_jaw).plan
        except PlanningError as error:
            return str(error), 0.0
        return "", 0.0 if plan is None else plan.duration


def _paths(program: Program) -> list[tuple[int | None, range]]:
    """The paths of a program: the stop that each begins at, and the waypoints on it.

    The stop is None for the arm's own position; a program of several rounds comes from its last
    stop.
    """
    first = None if program.rounds == 1 else len(program) - 1
    paths = ((each.origin, each.indices) for each in program.visits(most=2))
    return [*dict.fromkeys((first if origin is None else origin, each) for origin, each in paths)]


def program_check_summary(
    folder: Path, program: Program
) -> tuple[dict[str, float], dict[str, str]]:
    """Count the waypoints and paths of a check and those that fail; and list the reasons.

    Raises:
        ConfigError: The folder has no such sweep.
    """
    place = SweepFolder(folder)
    manifest: dict[str, Any] = place.manifest()
    if manifest.get("kind") != ProgramCheckSweep.kind:
        raise ConfigError("check", str(folder), f"is a sweep of {manifest.get('kind')}")
    waypoints, stops, duration, failed = set[int](), 0, 0.0, dict[str, str]()
    for number in range(int(manifest["shards"])):
        shard = place.read(number)
        if shard is None:
            continue
        waypoints, stops = waypoints | {*shard["waypoint"].tolist()}, stops + 1
        duration += float(shard["duration"][0])
        indices, problems = shard["waypoint"].tolist(), shard["waypoint_problem"].tolist()
        for index, problem in zip(indices, problems, strict=True):
            if problem:
                failed[program.called(index)] = problem
        if shard["path_problem"][0]:
            failed[f"the path to {program.called(indices[-1])}"] = str(shard["path_problem"][0])
    figures: dict[str, float] = {
        "waypoints": len(waypoints),
        "stops": stops,
        "failed": len(failed),
        "planned motion [s]": round(duration, 3),
    }
    return figures, failed
