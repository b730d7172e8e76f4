"""Plan to pick an item and to place it: every stage, before the first one moves.

    approach   any free path, with the jaw open as far as the item needs, to before the item
    reach      straight in; gripper and jaw may touch the item from here on
    lift       straight up; the item is held, and may touch what it stood on or beside
    carry      any free path with the item's shape and weight
    lower      straight down; it may touch what it is put on or beside
    leave      straight out, with the jaw open; it is an obstacle again

Between reach and lift the jaw closes, between lower and leave it opens. The item is planned with as
it lies on the fixed finger, for the jaw pushes it there. The grasps of ``grasps.py`` are tried in
their order, each until a stage has no plan; the short stages first, for they are what fails.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TypeVar

import numpy as np

from so101_motion.common.errors import ConfigError, NoPath, Overloaded, PlanningError
from so101_motion.common.geometry import SE3, Array, angle, point, rot_z, rotation_angle
from so101_motion.common.units import to_mm, to_rad
from so101_motion.planning.cell.team_requests import TeamTask
from so101_motion.planning.collision.bodies import NEAR
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import (
    HOLDERS,
    LINKS,
    Attached,
    Obstacle,
    Scene,
    one_named,
)
from so101_motion.planning.goals import Goal, GoalMetric, JointGoal, LineGoal
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.picking.grasps import (
    BACKS,
    BESIDE,
    THICKEST,
    THINNEST,
    WIDER,
    Grasp,
    GraspSearch,
    Tally,
    Wishes,
    item_hull,
)
from so101_motion.planning.planner import Planner
from so101_motion.planning.request import Plan, PlanRequest

LIFTS = (0.04, 0.02)  # how far the item is lifted, and lowered at its place [m]; chosen
FINER = 3  # how many times more directions are tried if none of the first will do; chosen
MOST = 12  # grasps that are planned for, unless the request says more; chosen
DEEPEST = 0.001  # how deep an item may be in what it is put on [m]; chosen, the error of scenes
SNAP = 0.003  # a place so little above the table is on it [m]; chosen: the base plate is 2.4 mm
LEVEL = to_rad(2.0)  # largest tilt of an item that is put down [rad]; chosen
TURNS = 24  # yaws that are tried where any will do; chosen

STAGES = ("approach", "reach", "lift", "carry", "lower", "leave")
HELD_STAGES = ("lift", "carry", "lower")

Body = TypeVar("Body", Obstacle, Attached)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Place:
    """Where an item is put.

    Attributes:
        p: Below the item's origin, at its underside, shape (3,), in the base frame [m]; up to
            ``SNAP`` above the table it is put on the table.
        yaw: How far the item is turned about the vertical from how it was picked [rad]; None for
            any.
    """

    p: Array
    yaw: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "p", point("at", self.p, 5.0))
        if self.yaw is not None:
            angle("yaw", self.yaw)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PickPlan:
    """A planned picking, placing, or both.

    Attributes:
        item: The item's name.
        grasp: How it is gripped; None if the gripper holds it already.
        plans: The plan of each stage by its name, in order.
        q_jaw_open: Where the jaw stands until it closes [rad]; None without a picking.
        q_jaw_closed: Where the item will stop it [rad].
        q_jaw_free: Where it stands after it has let go [rad]; None without a placing.
        scenes: The arm's scene from the begin of each stage on, by its name, and at the ``"end"``.
        R_base_item: How the item stood when it was picked, shape (3, 3).
    """

    item: str
    grasp: Grasp | None
    plans: Mapping[str, Plan]
    q_jaw_open: float | None
    q_jaw_closed: float
    q_jaw_free: float | None
    scenes: Mapping[str, Scene]
    R_base_item: Array

    @property
    def duration(self) -> float:
        """How long the arm moves [s], without the time for the jaw."""
        return sum(each.duration for each in self.plans.values())

    def q_jaw(self, stage: str) -> float:
        """Where the jaw stands in a stage [rad]."""
        q_jaw = {"leave": self.q_jaw_free}.get(stage, self.q_jaw_open)
        return self.q_jaw_closed if q_jaw is None or stage in HELD_STAGES else q_jaw

    def at(self, t: float) -> tuple[Array, float]:
        """Joints, shape (5,), and jaw [rad] after some time without that for the jaw [s]."""
        *before, last = self.plans
        for stage in before:
            if t <= self.plans[stage].duration:
                last = stage
                break
            t -= self.plans[stage].duration
        plan = self.plans[last]
        return plan.trajectory.sample(min(max(t, 0.0), plan.duration)).q, self.q_jaw(last)

    def applied(self, scene: Scene, stage: str) -> Scene:
        """``scene`` with the item where it is from the begin of a stage on, or at the ``"end"``."""
        then = self.scenes[stage]
        return replace(
            scene,
            obstacles=_as_in(scene.obstacles, then.obstacles, self.item),
            attached=_as_in(scene.attached, then.attached, self.item),
        )


def _as_in(bodies: Iterable[Body], planned: Iterable[Body], name: str) -> tuple[Body, ...]:
    others = tuple(each for each in bodies if each.name != name)
    return others + tuple(each for each in planned if each.name == name)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PickRequest(TeamTask[PickPlan]):
    """Request to pick an item of the scene, to place what is held, or both.

    Attributes:
        request: From where, with which caps and scene; its goal is ignored.
        item: The name of an obstacle, to pick it, or of what the gripper holds.
        place: Where to put it; None to hold it above where it was.
        wishes: What the user says about grasps.
        R_base_item: How a held item stood before, shape (3, 3); None: as it is.
        most: How many grasps are planned for.
        finer: How many times more directions are tried.
    """

    request: PlanRequest
    item: str
    place: Place | None = None
    wishes: Wishes = field(default_factory=Wishes)
    R_base_item: Array | None = None
    most: int = MOST
    finer: int = 1


@lru_cache(maxsize=4)
def _search(limits: tuple[tuple[float, float], ...]) -> tuple[RobotModel, GraspSearch]:
    lower, upper = np.array(limits).T
    model = RobotModel.load().narrowed(lower, upper)
    return model, GraspSearch(model, IkSolver(model).structure)


def plan_pick(planner: Planner, request: PickRequest) -> PickPlan:
    """Plan all stages.

    Raises:
        ConfigError: There is no such item, or it is a keep-out zone.
        PlanningError: It cannot be gripped, reached, carried or put there; the error says why.
    """
    return _Planning(planner, request).run()


class _Planning:
    def __init__(self, planner: Planner, request: PickRequest) -> None:
        self._planner, self._asked, self._request = planner, request, request.request
        model = planner.context(self._request).model
        self._model, self._search = _search(model.limits)
        self._scene, self._name = self._request.scene, request.item
        self._deadline = time.monotonic() + self._request.time_budget
        self._collision: Callable[[Scene], CollisionModel] = planner.around

    def run(self) -> PickPlan:
        held = [each for each in self._scene.attached if each.name == self._name]
        if held:
            return self._placed(held[0])
        if others := [each.name for each in self._scene.attached if not each.fixed]:
            names = " and ".join(f"'{name}'" for name in others)
            raise ConfigError("item", self._name, f"cannot be picked: {names} is in the gripper")
        if not self._scene.obstacles:
            reason = "the scene is empty; add an obstacle to it that has a mass in kg"
            raise ConfigError("item", self._name, reason)
        item = one_named(self._name, self._scene.obstacles)
        if item.keep_out:
            raise ConfigError("item", self._name, "is a keep-out zone, which cannot be picked")
        return self._picked(item)

    # Picking

    def _picked(self, item: Obstacle) -> PickPlan:
        fingers = frozenset(frozenset((each, self._name)) for each in HOLDERS)
        touching = replace(self._scene, may_touch=self._scene.may_touch | fingers)
        problems = list[PlanningError]()
        for finer in (self._asked.finer, FINER * self._asked.finer):
            grasps, tally = self._search.find(
                item, self._collision(touching), self._request.q_start, self._asked.wishes,
                finer=finer,
            )  # fmt: skip
            for grasp in grasps[: self._asked.most]:
                if not self._search.clear_of_item(grasp, item, grasp.q_jaw_open):
                    continue
                try:
                    return self._by(grasp, item, touching)
                except PlanningError as error:
                    problems.append(error)
                if time.monotonic() > self._deadline:
                    raise self._no_plan(len(grasps), problems)
            if tally.surfaces == 0 or self._asked.wishes.only:
                break
        if not grasps:
            raise self._no_grasp(item, tally)
        raise self._no_plan(len(grasps), problems)

    def _by(self, grasp: Grasp, item: Obstacle, touching: Scene) -> PickPlan:
        opened, T_base_tool = grasp.q_jaw_open, self._model.frame(grasp.q)
        closed = self._search.angle_closed(grasp, item)
        pushed = self._model.frame(grasp.q, "jaw_tip").R[:, 0] * BESIDE
        lying = replace(
            item, T_base_obstacle=SE3(item.T_base_obstacle.R, item.T_base_obstacle.p + pushed)
        )
        with_it = replace(
            self._scene,
            obstacles=tuple(lying if e is item else e for e in self._scene.obstacles),
        ).taking(self._name, T_base_tool)
        R_item, place = item.T_base_obstacle.R, self._asked.place
        places = []
        if place is not None:
            places = self._places(with_it.attached[-1], R_item, grasp.q, place)
        way = LineGoal(T_base_tool=T_base_tool, metric=GoalMetric.FULL_POSE)
        reach = self._stage("reach", way, grasp.q_before, touching, opened)
        q = reach.q_goal
        on = self._touched(with_it, q, closed, "stands in")
        lifting = _touching(with_it, self._name, on)
        up = LineGoal(
            T_base_tool=self._model.frame(self._raised(q)),
            metric=GoalMetric.POSITION_AND_APPROACH,
        )
        lift = self._stage("lift", up, q, lifting, closed)
        plans, scenes = {"reach": reach, "lift": lift}, {"reach": touching, "lift": lifting}
        free = None
        if place is None:
            scenes["end"] = with_it
            if not self._collision(with_it).is_free(lift.q_goal, closed):
                raise self._close_call(with_it, lift.q_goal, closed, "when it is lifted")
        else:
            free, more, after = self._put(with_it, places, lift.q_goal, closed)
            plans, scenes = plans | more, scenes | after
        at = self._request
        self._refuse_jaw(self._scene, at.q_start, at.q_jaw, opened, "opens where the arm stands")
        approach = self._stage(
            "approach", JointGoal(q=grasp.q_before), self._request.q_start, self._scene, opened
        )
        return PickPlan(
            item=self._name,
            grasp=grasp,
            plans={"approach": approach, **plans},
            q_jaw_open=opened,
            q_jaw_closed=closed,
            q_jaw_free=free,
            scenes={"approach": self._scene, **scenes},
            R_base_item=R_item,
        )

    # Placing

    def _placed(self, held: Attached) -> PickPlan:
        place = self._asked.place
        if place is None:
            raise ConfigError("item", self._name, "is in the gripper already; say where to put it")
        q, closed = self._request.q_start, self._request.q_jaw
        R = self._asked.R_base_item
        if R is None:
            R = (self._model.frame(q) @ held.T_tool_object).R
        places = self._places(held, R, q, place)
        free, plans, scenes = self._put(self._scene, places, q, closed)
        return PickPlan(
            item=self._name,
            grasp=None,
            plans=plans,
            q_jaw_open=None,
            q_jaw_closed=closed,
            q_jaw_free=free,
            scenes=scenes,
            R_base_item=R,
        )

    def _put(
        self, holding: Scene, places: list[Array], q_from: Array, closed: float
    ) -> tuple[float, dict[str, Plan], dict[str, Scene]]:
        """The stages from ``q_from`` on, to the first of the places for which there are plans."""
        held = next(each for each in holding.attached if each.name == self._name)
        problem: PlanningError | None = None
        for q in places[: self._asked.most]:
            try:
                return self._put_by(holding, held, q_from, q, closed)
            except PlanningError as error:
                problem = problem or error
        assert problem is not None
        raise problem

    def _put_by(
        self, holding: Scene, held: Attached, q_from: Array, q: Array, closed: float
    ) -> tuple[float, dict[str, Plan], dict[str, Scene]]:
        T, q_above = self._model.frame(q), self._raised(q)
        lowering = _touching(
            holding, self._name, self._touched(holding, q, closed, "would stand in")
        )
        down = LineGoal(T_base_tool=T, metric=GoalMetric.FULL_POSE)
        lower = self._stage("lower", down, q_above, lowering, closed)
        T = self._model.frame(lower.q_goal)
        put = holding.putting(self._name, T @ held.T_tool_object)
        fingers = frozenset(frozenset((each, self._name)) for each in HOLDERS)
        leaving = replace(put, may_touch=put.may_touch | fingers)
        problem: PlanningError | None = None
        for wider in WIDER:
            free = min(closed + wider, self._search.jaw.opened)
            for back in BACKS:
                way = LineGoal(T_base_tool=_back(self._model, lower.q_goal, back),
                               metric=GoalMetric.POSITION_AND_APPROACH)  # fmt: skip
                try:
                    self._refuse_jaw(leaving, lower.q_goal, closed, free, "lets go")
                    leave = self._stage("leave", way, lower.q_goal, leaving, free)
                    if not self._collision(put).is_free(leave.q_goal, free):
                        raise self._close_call(put, leave.q_goal, free, "after letting go")
                    carry = self._stage("carry", JointGoal(q=q_above), q_from, holding, closed)
                    plans = {"carry": carry, "lower": lower, "leave": leave}
                    scenes = {"carry": holding, "lower": lowering, "leave": leaving, "end": put}
                    return free, plans, scenes
                except PlanningError as error:
                    problem = problem or error
        assert problem is not None
        raise problem

    def _places(self, held: Attached, R_item: Array, q_from: Array, place: Place) -> list[Array]:
        """Configurations in which a held item stands at the place, near ``q_from`` first."""
        turns = [place.yaw] if place.yaw is not None else list(
            2.0 * math.pi * np.arange(TURNS) / TURNS
        )  # fmt: skip
        points, T_object_tool = item_hull(held.shape).points, held.T_tool_object.inverse
        z = place.p[2]
        if self._scene.floor_z is not None and 0.0 <= z - self._scene.floor_z <= SNAP:
            z = self._scene.floor_z
        Rs = np.array([rot_z(turn) @ R_item for turn in turns])
        for each_time in range(4):
            # The origin is above the place; the lowest corner stands on it.
            lowest = np.array([(points @ R.T)[:, 2].min() for R in Rs])
            p = np.column_stack([np.full((len(Rs), 2), place.p[:2]), z - lowest])
            T_tools = [SE3(R, each) @ T_object_tool for R, each in zip(Rs, p, strict=True)]
            q, number = self._search.solve(
                np.array([T.p for T in T_tools]).reshape(-1, 3),
                np.array([T.R for T in T_tools]).reshape(-1, 3, 3),
                frame="tool",
            )
            tools = [self._model.frame(each) for each in q]
            reached = [(T @ held.T_tool_object).R for T in tools]
            # First turned about the vertical as the arm's plane is, then as it is reached.
            if each_time == 0 and place.yaw is None:
                reached = [
                    rot_z(_turn(T_tools[k].R[:, 2], T.R[:, 2])) @ Rs[k]
                    for T, k in zip(tools, number, strict=True)
                ]
            Rs = np.array(reached).reshape(-1, 3, 3)
        good = list[tuple[float, int]]()
        for k, R in enumerate(Rs):
            D = R @ R_item.T
            off = math.acos(min(D[2, 2], 1.0))
            if place.yaw is not None:
                off = rotation_angle(D.T @ rot_z(place.yaw))
            if off <= LEVEL:
                good.append((float(np.abs(q[k] - q_from).max()), k))
        seen = list[Array]()
        for _, k in sorted(good):
            if all(np.abs(q[k] - other).max() > to_rad(3.0) for other in seen):
                with suppress(NoPath):
                    self._raised(q[k])
                    seen.append(q[k])
        if not seen:
            at = ", ".join(f"{value:.0f}" for value in to_mm(place.p))
            raise NoPath(
                f"the arm cannot hold '{self._name}' upright at {at} mm; choose a place about 200"
                " mm from the base, or another grasp",
                where="goal",
            )
        return seen

    # Both

    def _raised(self, q: Array) -> Array:
        """The configuration straight above another, with the tool as it is there."""
        T = self._model.frame(q)
        for lift in LIFTS:
            p = T.p + np.array([0.0, 0.0, lift])
            above, _ = self._search.solve(p[None], T.R[None], frame="tool")
            for each in sorted(above, key=lambda each: float(np.abs(each - q).max())):
                if rotation_angle(self._model.frame(each).R.T @ T.R) <= LEVEL:
                    return np.asarray(each)
        raise NoPath(f"the arm cannot go up from there by {to_mm(LIFTS[-1]):.0f} mm", where="goal")

    def _stage(self, name: str, goal: Goal, q_start: Array, scene: Scene, q_jaw: float) -> Plan:
        left = max(self._deadline - time.monotonic(), 0.05)
        request = replace(
            self._request, goal=goal, q_start=q_start, scene=scene, q_jaw=q_jaw, others=(),
            time_budget=left,
        )  # fmt: skip
        try:
            return self._planner.plan(request)
        except PlanningError as error:
            raise error.about(_DOING[name]) from None

    def _touched(self, scene: Scene, q: Array, q_jaw: float, how: str) -> frozenset[str]:
        """What a held item is near to; refused if it is deep in something."""
        collision, found = self._collision(scene), set[str]()
        for each in collision.nearest(q, q_jaw, within=min(2.0 * scene.margin, NEAR)):
            pair = {each.first, each.second}
            other = next(iter(pair - {self._name}), "")
            if self._name not in pair or other in LINKS:
                if each.distance <= each.margin:
                    raise self._close_call(
                        scene, q, q_jaw, f"with the jaw closed on '{self._name}'"
                    )
                continue
            if each.distance < -DEEPEST:
                raise NoPath(
                    f"'{self._name}' {how} {scene.called(other)} by {to_mm(-each.distance):.1f} mm",
                    where="goal", blockers=(other,),
                )  # fmt: skip
            found.add(other)
        return frozenset(found)

    def _refuse_jaw(self, scene: Scene, q: Array, begin: float, end: float, what: str) -> None:
        """Refuse that the jaw comes too near something while the arm stands."""
        for q_jaw in np.linspace(begin, end, 4)[1:]:
            for each in self._collision(scene).nearest(q, q_jaw, within=scene.margin):
                if LINKS[-1] in (each.first, each.second) and each.distance <= each.margin:
                    raise self._close_call(scene, q, q_jaw, f"when the jaw {what}")

    def _close_call(self, scene: Scene, q: Array, q_jaw: float, when: str) -> PlanningError:
        closest = self._collision(scene).clearance(q, q_jaw)
        return NoPath(f"{when}, {closest.message()}", where="goal", blockers=(closest.second,))

    # Why not

    def _no_grasp(self, item: Obstacle, tally: Tally) -> PlanningError:
        name, p = self._name, item.T_base_obstacle.p
        if tally.surfaces == 0 and tally.narrowest < THINNEST:
            why = (
                f"'{name}' is too thin: {to_mm(tally.narrowest):.0f} mm, and under"
                f" {to_mm(THINNEST):.0f} mm the jaws cannot tell it from nothing"
            )
        elif tally.surfaces == 0 and math.isfinite(tally.narrowest):
            over = to_mm(tally.narrowest - THICKEST)
            why = (
                f"'{name}' is {math.ceil(round(over, 3))} mm too wide:"
                f" {to_mm(tally.narrowest):.0f} mm where it is narrowest, and the jaws"
                f" grip {to_mm(THICKEST):.0f} mm"
            )
        elif tally.surfaces == 0:
            why = f"'{name}' has no two opposite surfaces that the jaws can grip"
        elif tally.reached == 0:
            far = to_mm(float(np.hypot(p[0], p[1])))
            why = (
                f"'{name}' is out of reach: {far:.0f} mm from the base, {to_mm(p[2]):.0f} mm up; no"
                " grasp can be reached with the gripper in the arm's plane"
            )
        elif tally.blockers and not tally.unwanted:
            most = sorted(tally.blockers, key=lambda each: -tally.blockers[each])[:2]
            names = " and ".join(self._scene.called(each) for each in most)
            why = (
                f"no approach to '{name}' is free: in each of {tally.reached} grasps the gripper"
                f" would come too near {names}"
            )
        else:
            why = f"none of the grasps of '{name}' is allowed by what you forbid"
        return NoPath(why, where="goal", blockers=tuple(tally.blockers))

    def _no_plan(self, grasps: int, problems: list[PlanningError]) -> PlanningError:
        name = self._name
        heavy = next((each for each in problems if isinstance(each, Overloaded)), None)
        if heavy is not None and isinstance(problems[0], Overloaded):
            return heavy.about(f"'{name}' is too heavy at that reach")
        if not problems:
            why = f"no approach to '{name}' is free: the open jaw would meet it"
            return NoPath(why, where="goal")
        first = problems[0]
        return NoPath(
            f"'{name}' can be gripped in {grasps} ways, but none of the best {len(problems)} can be"
            f" carried out. The first: {first}",
            where="goal",
            blockers=getattr(first, "blockers", ()),
        )


_DOING = {
    "approach": "on the way to it",
    "reach": "straight in",
    "lift": "lifting it",
    "carry": "carrying it",
    "lower": "setting it down",
    "leave": "straight out",
}


def _touching(scene: Scene, name: str, others: frozenset[str]) -> Scene:
    """A scene in which a held thing may touch others."""
    attached = tuple(
        replace(each, may_touch=each.may_touch | others) if each.name == name else each
        for each in scene.attached
    )
    return replace(scene, attached=attached)


def _back(model: RobotModel, q: Array, back: float) -> SE3:
    T = model.frame(q)
    return T @ SE3.from_translation((0.0, 0.0, -back))


def _turn(wanted: Array, reached: Array) -> float:
    """The angle about the vertical between two directions [rad]; 0 if one is nearly vertical."""
    if min(math.hypot(*wanted[:2]), math.hypot(*reached[:2])) < math.sin(LEVEL):
        return 0.0
    return math.atan2(reached[1], reached[0]) - math.atan2(wanted[1], wanted[0])
