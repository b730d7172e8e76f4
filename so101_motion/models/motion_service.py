"""``devrel:so101:motion``: a motion service for the arms of this module.

``move`` plans with the whole of our planner and runs what it planned. What a request says of the
surroundings (``world_state``) counts for that request alone, on top of what the arm's own
configuration says. Constraints are kept along the whole way and checked on the very setpoints that
will be sent: a plan that breaks one is refused, with where and by how much.

It plans for arms of this module in this process and moves nothing else. A component that hangs from
the arm, such as the gripper, may be named instead of the arm; its frame is then what is brought to
the destination.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from google.protobuf import json_format
from grpclib import GRPCError, Status
from viam.proto.app.robot import ComponentConfig
from viam.proto.common import PoseInFrame, ResourceName, Transform, WorldState
from viam.proto.service.motion import Constraints, MoveRequest
from viam.resource.base import ResourceBase
from viam.resource.types import Model
from viam.services.motion import Motion as MotionService

from so101_motion.config import Attributes, checked_number
from so101_motion.errors import ConfigError, MotionError, PlanningError
from so101_motion.geometry import SE3, Array, rotation_angle
from so101_motion.models import convert
from so101_motion.models.arm_resource import AT_START, ArmResource
from so101_motion.models.commands import Request, answer
from so101_motion.models.convert import grpc_statuses
from so101_motion.models.for_an_arm import arm_here, arm_named
from so101_motion.models.frames import WORLD, Frames
from so101_motion.models.planner_options import Ignored, PlannerOptions, from_goal_cloud
from so101_motion.models.tool_constraints import ToolConstraints
from so101_motion.models.world_state import allowing, scene_with
from so101_motion.planning.goals import (
    Goal,
    GoalMetric,
    LineGoal,
    PathGoal,
    PoseCloud,
    PoseGoal,
)
from so101_motion.planning.ik_cloud import is_in_cloud
from so101_motion.planning.model import RobotModel
from so101_motion.planning.plan import Plan
from so101_motion.state import ARM_JOINTS
from so101_motion.units import to_deg, to_mm

_COMPONENT = "component"  # what the planner calls the frame of a component that is not the arm


class So101Motion(MotionService):
    """Plans and moves one arm of this module.

    Args:
        name: The service's name.
        arm: Name of the arm; None for the only one, or for the one that a request names.
    """

    MODEL: ClassVar = Model.from_string("devrel:so101:motion")

    def __init__(self, name: str, arm: str | None) -> None:
        super().__init__(name)
        self._arm_name = arm
        self._model = RobotModel.load()
        self._ignored = Ignored(self.logger)

    @classmethod
    def validate_config(cls, config: ComponentConfig) -> tuple[Sequence[str], Sequence[str]]:
        """Check the attributes.

        Raises:
            ConfigError: As it is, for the SDK makes an INVALID_ARGUMENT of its text.
        """
        arm_named(config)
        return [], []

    @classmethod
    def new(
        cls, config: ComponentConfig, dependencies: Mapping[ResourceName, ResourceBase]
    ) -> So101Motion:
        """Build the service from its configuration."""
        with grpc_statuses():
            return cls(config.name, arm_named(config))

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
        """Bring a component to a pose around what is in the way; returns on arrival."""
        with grpc_statuses():
            wanted = Wanted(
                component=component_name,
                destination=destination,
                world=world_state,
                constraints=constraints,
                extra=extra or {},
            )
            resource = self._arm_for(component_name)
            await resource.stop()  # a newer move ends the older one
            plan = await self._planned(wanted)
            await resource.arrived(resource.watched(resource.rig.arm.start_execute(plan)))
        return True

    async def get_pose(
        self,
        component_name: str,
        destination_frame: str,
        supplemental_transforms: Sequence[Transform] | None = None,
        **kwargs: Any,
    ) -> PoseInFrame:
        """Where a component is, seen from a frame."""
        with grpc_statuses():
            arm = self._arm_for(component_name)
            frames = Frames(arm.short_name, arm.rig.arm.T_base(), supplemental_transforms or ())
            T_base_component = await frames.T_base(component_name)
            T_base_frame = await frames.T_base(destination_frame or WORLD)
            pose = convert.to_pose(T_base_frame.inverse @ T_base_component)
            return PoseInFrame(reference_frame=destination_frame or WORLD, pose=pose)

    async def do_command(self, command: Mapping[str, Any], **kwargs: Any) -> Mapping[str, Any]:
        """Answer ``plan``, ``preview`` and ``execute``.

        ``{"plan": <MoveRequest as JSON>}`` gives the joint angles of the way [rad], as the builtin
        service does; ``preview`` the same with what is known of it; ``{"execute": <that>}``
        moves along the angles, from where the arm stands.
        """
        with grpc_statuses():
            return await answer(command, {}, self._by_key, ("plan", "preview", "execute"))

    async def _by_key(self, request: Request) -> dict[str, Any]:
        given = Attributes(request, ("plan", "preview", "execute"), kind="request")
        result: dict[str, Any] = {}
        for key in ("plan", "preview"):
            if given.given(key):
                wanted = Wanted.of_json(key, request[key])
                plan = await self._planned(wanted)
                name = self._arm_for(wanted.component).short_name
                result[key] = _told(plan, name) if key == "preview" else _steps(plan, name)
        if given.given("execute"):
            await self._execute(request["execute"])
            result["execute"] = True
        return result

    async def _execute(self, steps: object) -> None:
        name, waypoints = _read_steps(steps)
        resource = self._arm_for(name)
        if name != resource.short_name:
            raise ConfigError("execute", name, f"is not the arm; that is {resource.short_name}")
        await resource.stop()
        arm = resource.rig.arm
        off = float(np.max(np.abs(waypoints[0] - arm.state.q_ref)))
        if off > AT_START:
            raise MotionError(
                f"the arm is {to_deg(off):.1f} deg away from where these steps begin; plan again"
            )
        if len(waypoints) > 1:
            motion = arm.start_move(PathGoal(waypoints=waypoints[1:]))
            await resource.arrived(resource.watched(motion))

    # How

    def _arm_for(self, component: str) -> ArmResource:
        arm = arm_here(self._arm_name) or ArmResource.here.get(component)
        if arm is None:
            known = ", ".join(ArmResource.here) or "none"
            raise ConfigError(
                "component_name",
                component,
                f'which arm moves it? set "arm" in the configuration; arms here: {known}',
            )
        return arm

    async def _planned(self, wanted: Wanted) -> Plan:
        """A plan for a request, every constraint checked; moves nothing."""
        self._ignored.warn(wanted.extra)
        resource = self._arm_for(wanted.component)
        arm, name = resource.rig.arm, resource.short_name
        options = PlannerOptions.of(wanted.extra)
        if wanted.destination.HasField("goal_cloud"):
            options = replace(options, cloud=from_goal_cloud(wanted.destination.goal_cloud))
        transforms = wanted.world.transforms if wanted.world is not None else ()
        frames = Frames(name, arm.T_base(), transforms)
        scene = await scene_with(arm.scene, wanted.world, frames)
        asked = ToolConstraints.of(
            wanted.constraints, counts_turn=options.metric is GoalMetric.FULL_POSE
        )
        if wanted.constraints is not None:
            for specification in wanted.constraints.collision_specification:
                scene = await allowing(scene, specification, frames)
        T_tool_component = await frames.T_tool(wanted.component)
        T_base_goal = await frames.T_base(wanted.destination.reference_frame)
        T_base_goal = T_base_goal @ convert.from_pose(wanted.destination.pose)
        goal = options.goal(resource.settings.goal(T_base_goal))
        search = options.search(scene)
        if wanted.component != name:
            goal = replace(goal, frame=_COMPONENT)
            search = replace(search, frames={_COMPONENT: T_tool_component})
        problem: PlanningError | None = None
        for attempt in _attempts(goal, asked):
            try:
                plan = await asyncio.to_thread(arm.plan, attempt, search=search)
                asked.check(plan.trajectory.q, lambda q: self._model.frame(q) @ T_tool_component)
                if goal.cloud is not None:
                    _check_end(goal, goal.cloud, self._model.frame(plan.q_goal) @ T_tool_component)
            except PlanningError as error:
                problem = problem or error
            else:
                return plan
        assert problem is not None
        raise problem

    # What it does not do

    async def move_on_map(self, *args: Any, **kwargs: Any) -> str:
        """Not for arms."""
        raise _not_for_arms("MoveOnMap")

    async def move_on_globe(self, *args: Any, **kwargs: Any) -> str:
        """Not for arms."""
        raise _not_for_arms("MoveOnGlobe")

    async def stop_plan(self, *args: Any, **kwargs: Any) -> None:
        """Not for arms; their own Stop ends a move of this service."""
        raise _not_for_arms("StopPlan")

    async def get_plan(self, *args: Any, **kwargs: Any) -> Any:
        """Not for arms."""
        raise _not_for_arms("GetPlan")

    async def list_plan_statuses(self, *args: Any, **kwargs: Any) -> Any:
        """Not for arms."""
        raise _not_for_arms("ListPlanStatuses")


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """One request, as it came.

    Attributes:
        component: What shall be brought there.
        destination: Where to.
        world: What is around.
        constraints: What the way must keep.
        extra: Options.
    """

    component: str
    destination: PoseInFrame
    world: WorldState | None
    constraints: Constraints | None
    extra: Mapping[str, Any]

    @classmethod
    def of_json(cls, key: str, value: object) -> Wanted:
        """From a MoveRequest as JSON, text or object.

        Raises:
            ConfigError: It is none.
        """
        request = MoveRequest()
        try:
            if isinstance(value, str):
                json_format.Parse(value, request)
            else:
                json_format.ParseDict(value, request)
        except (json_format.ParseError, AttributeError, TypeError) as error:
            raise ConfigError(key, "...", f"must be a MoveRequest as JSON: {error}") from error
        return cls(
            component=request.component_name,
            destination=request.destination,
            world=request.world_state if request.HasField("world_state") else None,
            constraints=request.constraints if request.HasField("constraints") else None,
            extra=convert.from_struct(request.extra),
        )


def _attempts(goal: PoseGoal, asked: ToolConstraints) -> list[Goal]:
    """What to try, in order, to keep what is asked of the way; a straight line keeps the most."""
    if not asked.is_any:
        return [goal]
    line = LineGoal(T_base_tool=goal.T_base_tool, metric=goal.metric, frame=goal.frame)
    line = replace(line, orientation_tolerance=min(asked.turn, line.orientation_tolerance))
    lines: list[Goal] = [line]
    if goal.cloud is not None and goal.cloud.metric is not goal.metric:
        # Lines have no leeways: they lead to the middle of the cloud, if need be turned as there.
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
            " outside its cloud; widen the leeways, or loosen the constraint"
        )


def _steps(plan: Plan, name: str) -> list[dict[str, list[float]]]:
    return [{name: [float(angle) for angle in q]} for q in plan.path]


def _told(plan: Plan, name: str) -> dict[str, Any]:
    report = plan.report
    return {
        "plan": _steps(plan, name),
        "duration_s": plan.duration,
        "tool_path_mm": [[float(x) for x in to_mm(point)] for point in plan.tool_path],
        "clearance_mm": float(to_mm(report.clearance)),
        "closest": list(report.closest),
        "planning_ms": report.stages_ms["total"],
    }


def _read_steps(steps: object) -> tuple[str, Array]:
    """The arm and its joint angles, shape (n, 5), [rad], in what ``plan`` gave."""
    if isinstance(steps, Mapping):
        steps = steps.get("plan")
    if not isinstance(steps, list) or not steps:
        raise ConfigError("execute", "...", "must be what plan or preview gave")
    rows = []
    for i, step in enumerate(steps):
        if not isinstance(step, Mapping) or len(step) != 1:
            raise ConfigError(f"execute[{i}]", step, 'must be an object such as {"arm": [...]}')
        [(name, angles)] = step.items()
        if not isinstance(angles, (list, tuple)) or len(angles) != len(ARM_JOINTS):
            raise ConfigError(f"execute[{i}]", angles, f"must be {len(ARM_JOINTS)} angles [rad]")
        rows.append([checked_number(f"execute[{i}]", angle, unit="rad") for angle in angles])
    return str(name), np.array(rows)


def _not_for_arms(what: str) -> GRPCError:
    return GRPCError(Status.UNIMPLEMENTED, f"{what} is for machines that drive; this moves an arm")
