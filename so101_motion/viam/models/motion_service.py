"""``devrel:so101:motion``: a motion service for the arms of this module.

The ``world_state`` of a request is added to the arm's surroundings, for that request alone. Path
constraints are checked on the setpoints that will be sent. A request may name a component that is
attached to the arm, such as the gripper, instead of the arm.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
from google.protobuf import json_format
from grpclib import GRPCError, Status
from viam.proto.common import PoseInFrame, Transform, WorldState
from viam.proto.service.motion import Constraints, MoveRequest
from viam.resource.types import Model
from viam.services.motion import Motion as MotionService

from so101_motion.arm.arm import Arm
from so101_motion.arm.motion_handle import Motion
from so101_motion.common.attributes import Attributes, checked_number
from so101_motion.common.errors import ConfigError, MotionError, NoPath, PlanningError
from so101_motion.common.geometry import SE3, Array, rotation_angle
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_mm
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import Goal, GoalMetric, LineGoal, PathGoal, PoseCloud, PoseGoal
from so101_motion.planning.kinematics.ik_cloud import is_in_cloud
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.request import Plan, Search
from so101_motion.viam.component_config import MotionConfig, SensesConfig
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.convert import grpc_statuses
from so101_motion.viam.conversion.frames import WORLD, Frames, carrier
from so101_motion.viam.conversion.planner_options import (
    REPLAN,
    OptionWarnings,
    PlannerOptions,
    from_goal_cloud,
)
from so101_motion.viam.conversion.tool_constraints import ToolConstraints
from so101_motion.viam.conversion.world_state import allowing, scene_with
from so101_motion.viam.models.arm_resource import AT_START, ArmResource, sources
from so101_motion.viam.models.configured import Dependencies
from so101_motion.viam.models.for_an_arm import ServiceForAnArm, arm_here
from so101_motion.viam.requests.await_motion import TurnQueue
from so101_motion.viam.requests.commands import Request, answer
from so101_motion.viam.requests.together import hand_over, move_together, set_held
from so101_motion.viam.surroundings.machine_cell import refuse_through

_KEYS = ("plan", "preview", "execute", "move_together", "holds", "handover")
_COMPONENT = "component"  # the planner's name for the frame of a component that is not the arm


class So101Motion(ServiceForAnArm, MotionService):
    """Plans and moves arms of this module; its sources add to the arm's own."""

    MODEL: ClassVar = Model.from_string("devrel:so101:motion")
    CONFIG = MotionConfig

    def __init__(
        self, name: str, arm: str | None, senses: SensesConfig, dependencies: Dependencies
    ) -> None:
        super().__init__(name, arm)
        self._sources = tuple(sources(senses, dependencies, self.logger))
        self._model = RobotModel.load()
        self._ignored = OptionWarnings(self.logger)
        self._turns = TurnQueue()
        self._running: set[tuple[ArmResource, Motion]] = set()

    @classmethod
    def used(cls, wanted: MotionConfig) -> Sequence[str]:
        return wanted.senses.resources

    @classmethod
    def build(cls, name: str, wanted: MotionConfig, dependencies: Dependencies) -> So101Motion:
        return cls(name, wanted.arm, wanted.senses, dependencies)

    async def move(
        self,
        component_name: str,
        destination: PoseInFrame,
        world_state: WorldState | None = None,
        constraints: Constraints | None = None,
        *,
        extra: Mapping[str, Any] | None = None,
        **kwargs: Any,
    ) -> bool:
        with grpc_statuses():
            wanted = MoveArguments(
                component_name, destination, world_state, constraints, extra or {}
            )
            resource = await self._arm_for(component_name, wanted.transforms)
            await resource.ready()
            options = PlannerOptions.of(wanted.extra)
            if options.replan:
                await self._replanned(wanted, options, resource)
                return True
            arm, loop = resource.rig.arm, asyncio.get_running_loop()
            if arm.is_movable_by_hand or not arm.newest_motion.future.done():
                await self._refuse_hopeless(wanted, arm.scene)
            motion = arm.start_planned(
                lambda: asyncio.run_coroutine_threadsafe(self._planned(wanted), loop)
            )
            await self._seen_through(resource, motion)
        return True

    async def get_pose(
        self,
        component_name: str,
        destination_frame: str,
        supplemental_transforms: Sequence[Transform] | None = None,
        **kwargs: Any,
    ) -> PoseInFrame:
        with grpc_statuses():
            brought = supplemental_transforms or ()
            arm = await self._arm_for(component_name, brought)
            frames = Frames(arm.short_name, arm.rig.arm.T_base(), brought)
            T_base_component = await frames.T_base(component_name)
            T_base_frame = await frames.T_base(destination_frame or WORLD)
            pose = convert.to_pose(T_base_frame.inverse @ T_base_component)
            return PoseInFrame(reference_frame=destination_frame or WORLD, pose=pose)

    async def do_command(self, command: Mapping[str, Any], **kwargs: Any) -> Mapping[str, Any]:
        """Answer ``plan``, ``preview`` and ``execute``, and the commands for several arms.

        ``{"plan": <MoveRequest as JSON>}`` answers the joint angles of the path [rad], as the
        builtin service does; ``preview`` adds duration, tool path and clearance;
        ``{"execute": <either answer>}`` moves along the angles if the arm stands at their start.
        ``move_together``, ``holds`` and ``handover`` are in ``viam/requests/together.py``.
        """
        with grpc_statuses():
            return await answer(command, {}, self._by_key, _KEYS)

    async def _by_key(self, request: Request) -> dict[str, Any]:
        given = Attributes(request, _KEYS, kind="request")
        result: dict[str, Any] = {}
        for key in ("plan", "preview"):
            if given.given(key):
                await self._turns.passed()
                wanted = await asyncio.to_thread(MoveArguments.of_json, key, request[key])
                plan = await self._planned(wanted)
                arm = await self._arm_for(wanted.component, wanted.transforms)
                name = arm.short_name
                result[key] = _plan_json(plan, name) if key == "preview" else _steps(plan, name)
        here, seen_through = ArmResource.here, self._seen_through
        moves: dict[str, Callable[[object], Awaitable[Any]]] = {
            "execute": self._execute,
            "move_together": lambda asked: move_together(asked, here, seen_through),
            "holds": lambda asked: set_held(asked, here),
            "handover": lambda asked: hand_over(asked, here, seen_through),
        }
        for key, carry_out in moves.items():
            if given.given(key):
                result[key] = await carry_out(request[key]) or True
        return result

    async def _execute(self, steps: object) -> None:
        name, waypoints = _read_steps(steps)
        resource = await self._arm_for(name)
        if name != resource.short_name:
            raise ConfigError(
                "execute", name, f"is not the arm of this service, {resource.short_name}"
            )
        await resource.ready()
        await resource.make_way()
        arm = resource.rig.arm
        off = float(np.max(np.abs(waypoints[0] - arm.state.q_ref)))
        if off > AT_START:
            raise MotionError(
                f"the arm is {to_deg(off):.1f} deg away from the first of these steps; plan again"
            )
        if len(waypoints) > 1:
            motion = arm.move(PathGoal(waypoints=waypoints[1:]), wait=False)
            await self._seen_through(resource, motion)

    # Steps of a request

    async def _arm_for(self, component: str, transforms: Iterable[Transform] = ()) -> ArmResource:
        """The arm that moves a component: the configured one, the only one, or by the frames."""
        if self._arm_name is not None or len(ArmResource.here) == 1:
            return arm_here(self._arm_name)
        name = await carrier(component, ArmResource.here, transforms)
        if name is None:
            known = ", ".join(ArmResource.here) or "none"
            raise ConfigError(
                "component_name",
                component,
                f"is not attached to an arm of this module; arms: {known}. Give it a frame whose"
                ' parent is the arm, or set "arm" in this service\'s configuration',
            )
        return arm_here(name)

    async def _seen_through(self, resource: ArmResource, motion: Motion) -> None:
        running = (resource, motion)
        self._running.add(running)
        try:
            await resource.arrived(motion)
        finally:
            self._running.discard(running)

    async def close(self) -> None:
        for resource, motion in tuple(self._running):
            await resource.ended(motion, "the removal of its motion service")
        for source in self._sources:
            await source.close()

    async def _refuse_hopeless(self, wanted: MoveArguments, around: Scene) -> None:
        """Refuse a request that fails from any start, before it ends the arm's present motion.

        Store, camera and other arms are read later, when the arm rests. A path that is not found
        from here is no reason.
        """
        asked = await self._asked(wanted, around)
        considered, planning = asked.arm.consider(asked.goal, search=asked.search)
        try:
            await asyncio.wait([asyncio.wrap_future(planning)])
        finally:
            planning.cancel()
        considered.refuse_interrupted()
        with suppress(NoPath):
            planning.result()

    async def _asked(self, wanted: MoveArguments, around: Scene) -> _PlanningTask:
        """Read a request for the arm's present position and these surroundings."""
        await self._turns.passed()
        self._ignored.warn(wanted.extra)
        resource = await self._arm_for(wanted.component, wanted.transforms)
        arm, name = resource.rig.arm, resource.short_name
        options = PlannerOptions.of(wanted.extra)
        if wanted.destination.HasField("goal_cloud"):
            options = replace(options, cloud=from_goal_cloud(wanted.destination.goal_cloud))
        frames = Frames(name, arm.T_base(), wanted.transforms)
        scene = await scene_with(around, wanted.world, frames)
        asked = ToolConstraints.of(
            wanted.constraints, counts_turn=options.metric is GoalMetric.FULL_POSE
        )
        if wanted.constraints is not None:
            refuse_through(arm.cell_member, wanted.constraints)
            for specification in wanted.constraints.collision_specification:
                scene = await allowing(scene, specification, frames)
        T_tool_component = await frames.T_tool(wanted.component)
        T_base_goal = await frames.T_base(wanted.destination.reference_frame)
        T_base_goal = T_base_goal @ convert.from_pose(wanted.destination.pose)
        goal = options.goal(resource.goal(T_base_goal))
        search = options.search(scene)
        if wanted.component != name:
            goal = replace(goal, frame=_COMPONENT)
            search = replace(search, frames={_COMPONENT: T_tool_component})
        return _PlanningTask(arm, goal, search, asked, T_tool_component)

    async def _replanned(
        self, wanted: MoveArguments, options: PlannerOptions, resource: ArmResource
    ) -> None:
        # Over gRPC neither is ever None; what was not given is empty.
        more = [each for each in (wanted.world, wanted.constraints) if each and each.ByteSize()]
        if more or self._sources:
            raise ConfigError(
                REPLAN,
                True,
                "cannot be combined with world_state, constraints, or a camera or store of this"
                " service; name those in the arm's configuration",
            )
        asked = await self._asked(wanted, resource.rig.arm.scene)
        frames, seen_through = asked.search.frames, partial(self._seen_through, resource)
        await resource.replanned(
            asked.goal, lambda scene: replace(options.search(scene), frames=frames), seen_through
        )

    async def _planned(self, wanted: MoveArguments) -> Plan:
        """Plan a request around the present surroundings and check it; moves nothing."""
        resource = await self._arm_for(wanted.component, wanted.transforms)
        plan = partial(self._planned_in, wanted)
        return await resource.surroundings.planned(resource.rig.arm.scene, plan, self._sources)

    async def _planned_in(self, wanted: MoveArguments, around: Scene) -> Plan:
        asked = await self._asked(wanted, around)
        goal, T_tool_component = asked.goal, asked.T_tool_component
        problem: PlanningError | None = None
        for attempt in _attempts(goal, asked.constraints):
            try:
                plan = await asyncio.wrap_future(asked.arm.start_plan(attempt, search=asked.search))
                asked.constraints.check(
                    plan.trajectory.q, lambda q: self._model.frame(q) @ T_tool_component
                )
                if goal.cloud is not None:
                    _check_end(goal, goal.cloud, self._model.frame(plan.q_goal) @ T_tool_component)
            except PlanningError as error:
                problem = problem or error
            else:
                return plan
        assert problem is not None
        raise problem

    # Methods for mobile bases

    async def _not_for_arms(self, *args: Any, **kwargs: Any) -> Any:
        raise GRPCError(
            Status.UNIMPLEMENTED,
            "this method is for mobile bases, and this service moves an arm; use Move, and the"
            " arm's Stop to end it",
        )

    move_on_map = move_on_globe = stop_plan = get_plan = list_plan_statuses = _not_for_arms


class MoveArguments(NamedTuple):
    """The arguments of a Move request."""

    component: str
    destination: PoseInFrame
    world: WorldState | None
    constraints: Constraints | None
    extra: Mapping[str, Any]

    @property
    def transforms(self) -> Sequence[Transform]:
        return self.world.transforms if self.world is not None else ()

    @classmethod
    def of_json(cls, key: str, value: object) -> MoveArguments:
        """Read a MoveRequest from JSON, text or object."""
        request = MoveRequest()
        try:
            if isinstance(value, str):
                json_format.Parse(value, request)
            else:
                json_format.ParseDict(value, request)
        except (json_format.ParseError, *_NOT_JSON) as error:
            raise ConfigError(key, "...", f"must be a MoveRequest as JSON: {error}") from error
        return cls(
            request.component_name,
            request.destination,
            request.world_state if request.HasField("world_state") else None,
            request.constraints if request.HasField("constraints") else None,
            convert.from_struct(request.extra),
        )


class _PlanningTask(NamedTuple):
    """A request in the planner's terms."""

    arm: Arm
    goal: PoseGoal
    search: Search
    constraints: ToolConstraints
    T_tool_component: SE3


_NOT_JSON = (AttributeError, TypeError, ValueError, OverflowError, RecursionError)
"""The errors of protobuf's JSON reader besides its own."""


def _attempts(goal: PoseGoal, asked: ToolConstraints) -> list[Goal]:
    """The goals to try, in order: a straight line where the constraints need one."""
    if not asked.is_any:
        return [goal]
    line = LineGoal(T_base_tool=goal.T_base_tool, metric=goal.metric, frame=goal.frame)
    line = replace(line, orientation_tolerance=min(asked.turn, line.orientation_tolerance))
    lines: list[Goal] = [line]
    if goal.cloud is not None and goal.cloud.metric is not goal.metric:
        # A line ends in the middle of the cloud, on the second attempt also with its orientation.
        lines.append(replace(line, metric=goal.cloud.metric))
    if asked.wants_line:
        return lines
    return [goal, *lines] if math.isinf(asked.line_share) else [*lines, goal]


def _check_end(goal: PoseGoal, cloud: PoseCloud, T_base_reached: SE3) -> None:
    T = goal.T_base_tool.inverse @ T_base_reached
    if not is_in_cloud(cloud, T):
        off_mm, off_deg = to_mm(float(np.linalg.norm(T.p))), to_deg(rotation_angle(T.R))
        raise PlanningError(
            f"a straight line ends {off_mm:.1f} mm and {off_deg:.1f} deg from the goal, which is"
            " outside its cloud; widen the tolerances, or loosen the constraint"
        )


def _steps(plan: Plan, name: str) -> list[dict[str, list[float]]]:
    return [{name: [float(angle) for angle in q]} for q in plan.path]


def _plan_json(plan: Plan, name: str) -> dict[str, Any]:
    report = plan.report
    return {
        "plan": _steps(plan, name),
        "duration_s": plan.duration,
        "waits_s": report.waits,
        "waits_for": list(report.waits_for),
        "tool_path_mm": [[float(x) for x in to_mm(point)] for point in plan.tool_path],
        "clearance_mm": float(to_mm(report.clearance)),
        "closest": list(report.closest),
        "planning_ms": report.stages_ms["total"],
        "routes": report.routes,
        "out_of_time": report.out_of_time,
    }


def _read_steps(steps: object) -> tuple[str, Array]:
    """The arm and its joint angles, shape (n, 5), [rad], in a result of ``plan``."""
    if isinstance(steps, Mapping):
        steps = steps.get("plan")
    if not isinstance(steps, list) or not steps:
        raise ConfigError("execute", "...", "must be an answer of plan or preview")
    rows = []
    for i, step in enumerate(steps):
        if not isinstance(step, Mapping) or len(step) != 1:
            raise ConfigError(f"execute[{i}]", step, 'must be an object such as {"arm": [...]}')
        [(name, angles)] = step.items()
        if not isinstance(angles, (list, tuple)) or len(angles) != len(ARM_JOINTS):
            raise ConfigError(f"execute[{i}]", angles, f"must be {len(ARM_JOINTS)} angles [rad]")
        rows.append([checked_number(f"execute[{i}]", angle, unit="rad") for angle in angles])
    return str(name), np.array(rows)
