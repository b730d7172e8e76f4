"""Find the configurations of a mounted arm at a task's poses, and the fastest cycle through them.

No motion takes less time than the joint that turns farthest: such times bound any plan. The legs of
the cheapest cycle are planned, their durations replace the bounds, and so on until all legs of the
cheapest are planned.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from so101_motion.arm.cell_member import Stand
from so101_motion.arm.gripper import JAW_CLOSED, JAW_OPEN
from so101_motion.common.attributes import LoadConfig
from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.bodies import around_base
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Attached, Scene
from so101_motion.planning.goals import JointGoal, PathGoal
from so101_motion.planning.kinematics.batch_ik import (
    angles_between,
    configurations_at,
    facing_turned,
    pitch_towards,
    roll_for,
)
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Plan, Planner, PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Payload, Strength, carried
from so101_motion.tasks.program.program import ARM
from so101_motion.tasks.program.rehearsal import PASSING, plan_leg
from so101_motion.tasks.sweeps.placement_task import PlacementTask, TaskPose
from so101_motion.tasks.sweeps.reach import STEPS
from so101_motion.tasks.sweeps.sweep import NEVER, WorkBudget

MOST = 24  # how many configurations of a pose are kept, evenly spread. Chosen.
_PITCHES: Array = 2.0 * math.pi / 16 * np.arange(-8.0, 8.0)  # tried if only the point counts [rad]
_ROLLS = np.radians(3 * [-90.0, 0.0, 90.0])[None, None]
"""Rolls that are tried if it is free, and the tilts of the approach, of its tolerance. Chosen."""
_SHARES = np.repeat([-0.9, 0.0, 0.9], 3)
_EXACT = 1e-5  # A configuration whose frame is farther off its point is dropped [m]


class PoseConfigurations:
    """Finds configurations that bring ``"tool"`` or ``"jaw_tip"`` to poses."""

    def __init__(self, model: RobotModel, frame: str = "tool") -> None:
        self._structure, self._frame = IkSolver(model).structure, frame
        self._tool, self._point = ArmChain(model), ArmChain(model, frame)

    def at(self, pose: TaskPose, T_base_cell: SE3) -> Array:
        """Configurations at a pose of the cell, within the limits, shape (n, 5), [rad]."""
        p = T_base_cell @ pose.p
        if not self._is_near(p):
            return np.empty((0, 5))
        if pose.R is None:
            level: Array = np.zeros((1, 1, len(_PITCHES)))
            return _spread(self._found(p, level, _PITCHES[None, None]))
        R = T_base_cell.R @ pose.R
        if pose.roll_tolerance is None:
            tilts = pose.approach_tolerance * _SHARES
            found = self._found(
                p, _ROLLS, lambda pan: pitch_towards(self._structure, pan, R[None, :, 2]) + tilts
            )
        else:
            target, pitch = facing_turned(self._structure, self._frame, p[None], R[None], 0.0)
            found = self._found(p, roll_for(self._structure, target.pan, pitch, R[None]), pitch)
        turned = self._tool.rotations(found)
        good = np.linalg.norm(self._point.positions(found) - p, axis=1) <= _EXACT
        good &= angles_between(turned[:, :, 2], R[:, 2]) <= pose.approach_tolerance
        if pose.roll_tolerance is not None:
            off = R.T @ turned
            roll = np.arctan2(off[:, 1, 0] - off[:, 0, 1], off[:, 0, 0] + off[:, 1, 1])
            good &= np.abs(roll) <= pose.roll_tolerance + 1e-9
        return _spread(found[good])

    def _is_near(self, p: Array) -> bool:
        """Whether the arm is long enough for a point, whatever its joints."""
        m = self._structure.measures
        x, y, z = p.tolist()
        out = math.hypot(x - m.pan[0], y - m.pan[1]) - abs(m.shoulder[0])
        return math.hypot(max(out, 0.0), z - m.shoulder[1]) < self._structure.longest[self._frame]

    def _found(self, p: Array, roll: Array, pitch: Array | Callable[[Array], Array]) -> Array:
        found = configurations_at(self._structure, self._frame, p[None], roll, pitch)
        return found.q[found.excess <= 0.0]


def _spread(q: Array) -> Array:
    if len(q) <= MOST:
        return q
    return np.asarray(q[np.linspace(0, len(q) - 1, MOST).round().astype(int)])


_LOOKS = 100  # A leg is given up after so many checkpoints. Chosen: some tenths of a second.


class _Legs:
    """Plans legs from one base and keeps them, by a planner for ``plan_leg``. For one thread."""

    def __init__(
        self,
        model: RobotModel,
        scene: Scene,
        limits: MotionLimits,
        payload: Payload | None,
        strength: Strength,
    ) -> None:
        self._limits, self._scene = limits, scene
        self._payload, self._strength = payload, strength
        self._patience = WorkBudget(_LOOKS)
        # A fresh one: checkpoints are counted in batches that continue from plan to plan.
        self._planner = Planner(model, self._patience)
        self._made: dict[bytes, Plan | PlanningError | None] = {}

    def plan_together(
        self,
        goals: Mapping[str, JointGoal | PathGoal],
        *,
        limits: Mapping[str, MotionLimits],
        stands: Mapping[str, Stand],
    ) -> dict[str, Plan]:
        ((name, goal),) = goals.items()
        self._patience.reset()
        request = PlanRequest(
            q_start=stands[name].q,
            goal=goal,
            limits=limits[name],
            q_jaw=stands[name].q_jaw,
            scene=self._scene,
            payload=self._payload,
            strength=self._strength,
            time_budget=NEVER,
            route_effort=1,  # hundreds of places are tried
        )
        return {name: self._planner.plan(request)}

    def plan(self, task: PlacementTask, q: Array, indices: range, q_jaw: float) -> Plan | None:
        """The motion from the pose before ``indices`` through them; None if there is nothing to do.

        ``q`` has the joint angles at each pose, shape (n, 5), ``q_jaw`` the jaw's meanwhile, [rad].
        """
        q_start = q[(indices[0] - 1) % len(q)]
        key = np.array([indices[0], q_jaw, *q_start, *q[indices].ravel()]).tobytes()
        if key not in self._made:
            stands, caps = {ARM: Stand(q_start, q_jaw)}, {ARM: self._limits}
            try:
                program = task.program(q).on([ARM])
                self._made[key] = plan_leg(self.plan_together, program, indices, stands, caps).plan
            except PlanningError as error:
                self._made[key] = error
        made = self._made[key]
        if isinstance(made, PlanningError):
            raise made
        return made


def jaw_angles(apertures: Sequence[float | None], *, goes_around: bool) -> list[float]:
    """The jaw's angle after each stop [rad]; closed before the first aperture, 0 to 1.

    With ``goes_around`` the first stop comes again after the last.
    """
    given = [each for each in apertures if each is not None]
    aperture = given[-1] if given and goes_around else 0.0
    jaws = []
    for each in apertures:
        aperture = aperture if each is None else each
        jaws.append(JAW_CLOSED + aperture * (JAW_OPEN - JAW_CLOSED))
    return jaws


def least_time(distance: Array, velocity: float, acceleration: float, jerk: float) -> Array:
    """The shortest time from rest to rest over distances, any shape, [rad] to [s].

    Source: L. Biagiotti and C. Melchiorri, Trajectory Planning for Automatic Machines and Robots,
    2008, section 3.4, the double S with both ends at rest.
    """
    d = np.abs(distance)
    ramp = acceleration / jerk
    if velocity * jerk >= acceleration**2:
        cruise = d / velocity + velocity / acceleration + ramp
        full = velocity * (velocity / acceleration + ramp)
    else:
        cruise = d / velocity + 2.0 * np.sqrt(velocity / jerk)
        full = 2.0 * velocity * np.sqrt(velocity / jerk)
    ramped = ramp + np.sqrt(ramp**2 + 4.0 * d / acceleration)
    short = 4.0 * np.cbrt(0.5 * d / jerk)
    below = np.where(d >= 2.0 * acceleration * ramp**2, ramped, short)
    return np.where(d >= full, cruise, below)


def cheapest(costs: list[Array], *, closed: bool) -> tuple[float, list[int]]:
    """The least sum of costs, infinite if there is none, and the option at each stop for it.

    Costs lead from each option of a stop to each of the next, arrays (n_k, n_k+1). A ``closed``
    cycle ends where it began, with the same option.
    """
    n = len(costs[0])
    reached = np.where(np.eye(n, dtype=bool), 0.0, np.inf) if closed else np.zeros((1, n))
    before = []
    for cost in costs:
        through = reached[:, :, None] + cost[None]
        best = through.argmin(axis=1)
        before.append(best)
        reached = np.take_along_axis(through, best[:, None], axis=1)[:, 0]
    if closed:
        start = int(np.argmin(np.diag(reached)))
        last, total = start, float(reached[start, start])
    else:
        start, last = 0, int(np.argmin(reached[0]))
        total = float(reached[0, last])
    options = [last]
    for best in reversed(before):
        options.append(int(best[start, options[-1]]))
    options.reverse()
    return total, options[:-1] if closed else options


CRITERIA = ("time", "clearance", "torque", "robust")  # the criteria for comparing bases
_ROUNDS = 4  # most cycles from a base that are planned. Chosen: mostly the first stays.
GAIN = 0.002  # a smaller gain of time is not searched for. Chosen: a fifth of what may be missed.

_TORQUE_STEP = 0.05
"""When bases are compared by torque, configurations within this share of the best count as equally
good. Chosen."""

_LOOKED_AT = 10  # clearance along a motion is measured at every tenth setpoint
_FAR = 1.0  # stands for more clearance than is measured [m]
_Leg = tuple[int, int, int]  # the pose where a leg begins, and the configurations at both its ends


class Choice(NamedTuple):
    """The configurations at the poses of a task from one base, one array a pose."""

    q: list[Array]  # shapes (n_k, 5), [rad]
    level: list[Array]  # clearance of each, in steps, shapes (n_k,), [m]
    left: list[Array]  # share of the holding torque that each leaves, shapes (n_k,)

    def bounds(self) -> tuple[float, float]:
        """The largest clearance [m] and share of torque that any cycle can keep."""
        level = min(float(each.max()) for each in self.level)
        wider = [step for step in STEPS if step > level]
        return min(wider, default=_FAR), min(float(each.max()) for each in self.left)

    def narrowed(self, by: str) -> Choice:
        """Drop the configurations that would worsen the figure of the criterion."""
        if by not in ("clearance", "torque"):
            return self
        column, slack = (self.level, 0.0) if by == "clearance" else (self.left, _TORQUE_STEP)
        least = min(float(each.max()) for each in column) - slack
        kept = [each >= least for each in column]
        return Choice(*([each[good] for each, good in zip(of, kept, strict=True)] for of in self))


class Cycle(NamedTuple):
    """A planned cycle through all poses."""

    time: float  # its duration, pauses included [s]
    q: Array  # the joint angles at each pose, shape (n, 5), [rad]
    motions: list[tuple[Plan | None, float]]  # with the jaw's angle [rad]; None where the arm stays


class MountedArm:
    """An arm with a task. Belongs to one thread.

    ``payload`` is in the hand, at the jaw's tip [kg], ``voltage`` the servos' rated one [V],
    ``R_world_base`` the orientation of the base, by which torques are, ``by`` one of ``CRITERIA``.
    """

    def __init__(
        self,
        task: PlacementTask,
        limits: MotionLimits,
        *,
        payload: float,
        voltage: float,
        R_world_base: Array,
        attached: tuple[Attached, ...],
        by: str,
    ) -> None:
        self._task, self._limits, self._by = task, limits, by
        self.model = RobotModel.load().mounted(R_world_base)
        self._payload = Payload.of(LoadConfig(mass=payload), self.model)
        held = carried(self._payload, attached)
        loaded = self.model
        self._loaded = loaded if held is None else loaded.with_payload(held.mass, held.com)
        self._strength = Strength.of_servos(voltage)
        self._ways = PoseConfigurations(self.model, task.frame)
        self._around = lru_cache(maxsize=4)(partial(CollisionModel, self.model))
        self._pauses = sum(pose.pause for pose in task.poses)
        self._closed = task.rounds != 1
        apertures = [pose.aperture for pose in task.poses]
        self._jaws = jaw_angles(apertures, goes_around=self._closed)

    def choice(self, T_cell_base: SE3, scene: Scene) -> tuple[Choice | None, int]:
        """The configurations at a base with the scene as seen from it; else the pose that has none.

        That is counted as in ``Screened.missed``.
        """
        found, missed = self._free(T_cell_base, scene)
        if missed != -1:
            return None, missed
        collision, choice = self._around(scene), Choice([], [], [])
        for k, (q, left) in enumerate(found):
            level = np.zeros(len(q))
            for step in STEPS:
                near = collision.touching(q, self._jaws[k], extra=step)
                level = np.where(near, level, step)
            choice.q.append(q)
            choice.level.append(level)
            choice.left.append(left)
        return choice.narrowed(self._by), -1

    def reaches(self, T_cell_base: SE3, scene: Scene) -> bool:
        """Whether every pose can be reached from a base; arguments as for ``choice``."""
        return self._free(T_cell_base, scene)[1] == -1

    def _free(self, T_cell_base: SE3, scene: Scene) -> tuple[list[tuple[Array, Array]], int]:
        """The free configurations at each pose, with the share of torque that is left."""
        T_base_cell = T_cell_base.inverse
        found = []
        for k, pose in enumerate(self._task.poses):  # most bases fail here, before a body is made
            q = self._ways.at(pose, T_base_cell)
            if len(q) == 0:
                return [], k
            held = np.abs(self._loaded.holding_torques(q)).max(axis=1)
            found.append((q, 1.0 - held / self._strength.holding))
        if around_base(self.model.pin_model, scene) is not None:
            return [], -2
        collision = self._around(scene)
        free = []
        for k, (q, left) in enumerate(found):
            good = left >= 0.0
            for jaw in {self._jaws[k - 1], self._jaws[k]}:
                good &= np.logical_not(collision.touching(q, jaw))
            if not good.any():
                return [], k
            free.append((q[good], left[good]))
        return free, -1

    def least_time(self, choice: Choice) -> float:
        """A lower bound on the time of any cycle [s]."""
        return self._cheapest(choice, {})[0]

    def planned(self, choice: Choice, scene: Scene) -> Cycle | str:
        """Plan the fastest cycle; returns the name of the error if there is none."""
        legs = _Legs(self.model, scene, self._limits, self._payload, self._strength)
        known: dict[_Leg, float] = {}
        best: Cycle | None = None
        why = "NoPath"
        for _ in range(_ROUNDS):
            bound, options = self._cheapest(choice, known)
            if bound == math.inf or (best is not None and bound >= (1.0 - GAIN) * best.time):
                break
            try:
                made = self._along(choice, options, legs, known)
            except PlanningError as error:
                why = type(error).__name__
            else:
                best = made if best is None or made.time < best.time else best
        return best or why

    def figures(self, cycle: Cycle, scene: Scene) -> tuple[float, float]:
        """Clearance beyond the margins [m] and share of torque left, over whole motions."""
        collision, room, left = self._around(scene), math.inf, math.inf
        for plan, jaw in cycle.motions:
            if plan is None:
                continue
            q = plan.trajectory.q
            looked = q[np.unique([*range(0, len(q), _LOOKED_AT), len(q) - 1])]
            room = min(room, *(collision.clearance(each, jaw).room for each in looked))
            held = float(np.abs(self._loaded.holding_torques(looked)).max())
            left = min(left, 1.0 - held / self._strength.holding)
        return room, left

    def _along(
        self, choice: Choice, options: list[int], legs: _Legs, known: dict[_Leg, float]
    ) -> Cycle:
        """Plan the legs through one configuration at each pose, and note their durations."""
        n = len(options)
        q = np.array([of[option] for of, option in zip(choice.q, options, strict=True)])
        time, motions = self._pauses, list[tuple[Plan | None, float]]()
        for indices in self._stretches():
            through = [(indices[0] - 1) % n, *indices]
            begin, end = through[-2], through[-1]
            # The time that a stretch takes beyond its other legs is attributed to its last leg.
            other = sum(
                float(self._passing(np.abs(q[a] - q[b]).max(), 1 + (a != through[0])))
                for a, b in pairwise(through[:-1])
            )
            leg = begin, options[begin], options[end]
            known[leg] = math.inf
            jaw = self._jaws[through[0]]
            plan = legs.plan(self._task, q, indices, jaw)
            duration = 0.0 if plan is None else plan.duration
            known[leg] = duration - other
            time += duration
            motions.append((plan, jaw))
        return Cycle(time, q, motions)

    def _cheapest(self, choice: Choice, known: Mapping[_Leg, float]) -> tuple[float, list[int]]:
        """Time of the cheapest cycle, with pauses, and its configuration at each pose."""
        poses, n = self._task.poses, len(choice.q)
        velocity, acceleration, jerk = self._caps
        costs = []
        for k in range(n if self._closed else n - 1):
            after = (k + 1) % n
            off = np.abs(choice.q[k][:, None] - choice.q[after][None]).max(axis=2)
            passed = poses[k].passes + poses[after].passes
            if passed:
                costs.append(self._passing(off, passed))
            else:
                costs.append(least_time(off, velocity, acceleration, jerk))
        for (k, first, second), duration in known.items():
            costs[k][first, second] = max(duration, float(costs[k][first, second]))
        time, options = cheapest(costs, closed=self._closed)
        return time + self._pauses, options

    @property
    def _caps(self) -> tuple[float, float, float]:
        limits = self._limits
        velocity, acceleration, jerk = (
            float(each[0]) for each in (limits.velocity, limits.acceleration, limits.jerk)
        )
        return velocity, acceleration, jerk

    def _passing(self, off: Array, passed: int) -> Array:
        """Lower bound on the time of a leg with passed ends, over a joint distance [rad] to [s]."""
        velocity, acceleration, _ = self._caps
        d = np.maximum(off - passed * PASSING, 0.0)
        if passed == 2:
            return np.asarray(d / velocity)
        cruise = d / velocity + 0.5 * velocity / acceleration  # from rest, without an end
        short = d < 0.5 * velocity**2 / acceleration
        return np.where(short, np.sqrt(2.0 * d / acceleration), cruise)

    def _stretches(self) -> Iterator[range]:
        """The poses of each motion; the pose before them is where it begins."""
        for visit in self._task.program(np.zeros((len(self._task.poses), 5))).visits(most=1):
            indices = visit.indices
            if indices[0] > 0 or self._closed:
                yield indices
            elif len(indices) > 1:
                yield indices[1:]
