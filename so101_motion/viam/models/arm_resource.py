"""The Viam arm methods that real and simulated arms share: convert, call the arm, convert back.

Stop goes from the event loop straight to the arm's I/O thread; calls that block (release, close)
run in a thread of their own. Forward kinematics takes microseconds and runs on the event loop,
because the kinematic model belongs to one thread.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import aclosing, suppress
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, ClassVar

import numpy as np
from viam.components.arm import Arm, JointPositions, KinematicsFileFormat, Mesh, MoveOptions, Pose
from viam.proto.common import Geometry, PoseInFrame
from viam.services.motion import Motion as MotionService

from so101_motion.arm.arm import SCENE
from so101_motion.arm.joint_caps import JointCaps
from so101_motion.arm.motion_handle import Motion
from so101_motion.arm.motion_queue import wait_here
from so101_motion.calib.record import store
from so101_motion.common.attributes import (
    ACCELERATION_RANGE_DEG,
    SPEED_RANGE_DEG,
    Attributes,
    checked_number,
)
from so101_motion.common.errors import (
    SUPERSEDED,
    ConfigError,
    Interrupted,
    MotionError,
    So101Error,
    SurroundingsUnknown,
)
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.modes import LONGEST_GUIDING
from so101_motion.common.operation import LocalOperation, Moving
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_mm, to_rad
from so101_motion.files.scene_file import arms_to, obstacles_from, scene_to
from so101_motion.planning.collision.apart import ROOM
from so101_motion.planning.collision.scene import Scene, StandingArm
from so101_motion.planning.goals import Goal, JointGoal, LeaveContactGoal, PathGoal, PoseGoal
from so101_motion.planning.request import Plan, Search
from so101_motion.rig.rig import Rig
from so101_motion.tasks.guided.teaching import TAUGHT, TeachingOperation
from so101_motion.tasks.picking import PICKED, PickOperation
from so101_motion.tasks.teleop.sides import jaw_of
from so101_motion.viam.component_config import MANUAL_RANGES, ArmConfig, SensesConfig, compliance
from so101_motion.viam.conversion import convert, kinematics, meshes
from so101_motion.viam.conversion.convert import grpc_statuses
from so101_motion.viam.conversion.planner_options import (
    REPLAN,
    OptionWarnings,
    PlannerOptions,
    cloud_in,
    to_goal_cloud,
)
from so101_motion.viam.conversion.world_state import MOST_THINGS
from so101_motion.viam.models.configured import Configured, Dependencies, dependency
from so101_motion.viam.models.gripper_resource import GripperResource
from so101_motion.viam.requests import await_motion
from so101_motion.viam.requests.commands import (
    KEYS,
    Command,
    Request,
    Taking,
    arguments,
    in_deg,
)
from so101_motion.viam.requests.manual import ManualMode
from so101_motion.viam.requests.operation_commands import operation_commands
from so101_motion.viam.surroundings.camera_view import CameraView
from so101_motion.viam.surroundings.guarded_scene import GuardedScene
from so101_motion.viam.surroundings.machine_bodies import MachineBodies
from so101_motion.viam.surroundings.machine_cell import MachineCell
from so101_motion.viam.surroundings.store_watch import StoreWatch
from so101_motion.viam.surroundings.surroundings import Source, Surroundings

AT_START = to_rad(0.5)
"""Largest distance from the arm to a first waypoint that counts as the start [rad]; chosen. Motion
services send the present joints as the first waypoint, and an arm rests up to this far off."""


_BLIND = "how deep the arm was in contact is not known, so the way out may have led deeper"
"""What the answer of ``leave_contact`` says then."""

_PROGRAM = ("schema", "waypoints", "steps", "loops", "rounds")
"""The entries of a program's file (``tasks/program/files.py``)."""


def scene_of(wanted: ArmConfig) -> Scene:
    if len(wanted.obstacles) > MOST_THINGS:
        given = f"{len(wanted.obstacles)} obstacles"
        raise ConfigError("obstacles", given, f"are more than the {MOST_THINGS} that are read")
    return _scene(wanted.floor_z, json.dumps(wanted.obstacles))


@lru_cache(maxsize=8)
def _scene(floor_z: float | None, obstacles: str) -> Scene:
    """Cached: ``validate_config`` builds it in a thread, and the event loop uses it again."""
    return Scene(floor_z=floor_z, obstacles=obstacles_from(json.loads(obstacles)))


class ArmResource(Configured, Arm):
    """An arm component; its rig is closed with it."""

    NEEDS_SERVOS: ClassVar[frozenset[str]] = frozenset()
    """The commands that are refused until the servos have been found."""

    here: ClassVar[dict[str, ArmResource]] = {}
    """The arms of this process by name; grippers and services look up their arm here."""

    cell: ClassVar = MachineCell(here)
    """Lets these arms know each other's motions, so that they keep apart."""

    def __init__(self, name: str, rig: Rig, config: ArmConfig, dependencies: Dependencies) -> None:
        super().__init__(name)
        self._planning_service = motion_service(config.motion, dependencies)
        self.rig = rig
        self.short_name = name.rpartition(":")[2]
        self.here[self.short_name] = self
        self._arm = rig.arm
        self.config, arm = config, rig.arm
        arm.set_ceiling(JointCaps(speed=config.max_speed, acceleration=config.max_acceleration))
        arm.set_load(config.load)
        arm.set_tool(config.tool)
        guard = SCENE if config.guarded else None
        self._retarget = partial(arm.retarget, guard=guard)
        self._start_stream = partial(arm.start_stream, guard=guard)
        self._ignored = OptionWarnings(self.logger)
        machine = MachineBodies(
            self.short_name, config.ignored, self.here, GripperResource.here, self.cell
        )
        senses = sources(config.senses, dependencies, self.logger)
        around = self.surroundings = Surroundings(machine, senses, self.logger)
        self.guarded_scene = GuardedScene(arm, around, self.logger, is_used=config.guarded)
        self._manual = ManualMode(arm, self.logger, self.guarded_scene)
        self.teaching = TeachingOperation(rig, partial(store.resolve, "paths"), self._set_manual)
        rig.picker.around = self._scene_now
        self.picking = PickOperation(rig.picker)
        self._operations: dict[str, LocalOperation] = {}
        self._ended_by = ""  # why no other motion may begin
        self._keys = (self._motion_params, KEYS)
        self._commands: dict[str, Command] = {
            "enter_manual_mode": Taking(self._enter_manual_mode, ("enabled_for", *MANUAL_RANGES)),
            "exit_manual_mode": self._exit_manual_mode,
            "get_planning_setup": self._get_planning_setup,
            "get_surroundings": self._get_surroundings,
            "leave_contact": self._leave_contact,
            **self._asked("teaching", self.teaching, TAUGHT),
            **self._asked("picking", self.picking, PICKED),
            "run_program": Taking(self._run_program, _PROGRAM),
        }

    def _asked(
        self, name: str, operation: LocalOperation, published: Iterable[str]
    ) -> dict[str, Command]:
        self._operations[name] = operation
        keys = {key: (name, key) for key in published}
        return operation_commands(self._operations, keys, arrived=self.arrived)

    @classmethod
    def needed(cls, wanted: ArmConfig) -> Sequence[str]:
        scene_of(wanted)  # refuses obstacles that are not valid
        return [motion_name(wanted.motion)] if wanted.motion else []

    @classmethod
    def used(cls, wanted: ArmConfig) -> Sequence[str]:
        return wanted.senses.resources

    def goal(self, T_base_goal: SE3) -> PoseGoal:
        far = 1000.0 * np.abs(T_base_goal.p).max()
        if 1e-6 < far < 1.0:  # [mm]; where no tool can be
            reason = f"at most {far:.3g} mm from the base: did you mean metres? Poses are in mm"
            raise ConfigError("pose", to_mm(T_base_goal.p).round(3).tolist(), reason)
        goal = PoseGoal(T_base_tool=T_base_goal)
        return replace(
            goal,
            position_tolerance=self.config.position_tolerance or goal.position_tolerance,
            approach_tolerance=self.config.approach_tolerance or goal.approach_tolerance,
        )

    # Position

    async def get_end_position(self, **kwargs: Any) -> Pose:
        await self.measured()
        return convert.to_pose(self._arm.T_base("tool"))

    async def get_joint_positions(self, **kwargs: Any) -> JointPositions:
        await self.measured()
        return convert.to_joint_positions(self._arm.state.q)

    async def is_moving(self) -> bool:
        return self._arm.is_moving

    def T_end(self) -> SE3:
        return self._arm.T_base("tool")

    def T_links(self) -> Mapping[str, SE3]:
        return self._arm.T_base_links()

    # Moving

    async def move_to_position(
        self, pose: Pose, *, extra: dict[str, Any] | None = None, **kwargs: Any
    ) -> None:
        await self.ready()
        extra = extra or {}
        with grpc_statuses():
            if self._planning_service is not None:
                await self._move_by_service(self._planning_service, pose, extra, **kwargs)
                return
            self._ignored.warn(extra)
            options = PlannerOptions.of(extra)
            goal = options.goal(self.goal(convert.from_pose(pose)))
            if options.replan:
                await self.replanned(goal, options.search, self.arrived)
            else:
                planning = self._planning(goal, options.search(self._arm.scene))
                await self.arrived(self._arm.start_planned(planning))

    def _planning(self, goal: Goal, search: Search) -> Callable[[], Future[Plan]]:
        """Starts to plan around the surroundings as they are when it is called."""
        if not self.surroundings.is_asked():
            return partial(self._arm.start_plan, goal, search=search)
        loop = asyncio.get_running_loop()

        def plan(scene: Scene) -> Future[Plan]:
            return self._arm.start_plan(goal, search=replace(search, scene=scene))

        return lambda: self.surroundings.start_planning(
            search.scene or self._arm.scene, plan, wait_here, loop
        )

    async def replanned(
        self,
        goal: Goal,
        search: Callable[[Scene], Search],
        arrived: Callable[[Motion], Awaitable[None]],
    ) -> None:
        """Move to a goal, and plan again whenever the surroundings have changed; see ``Arm``."""
        async with self.guarded_scene.kept_known(new=True):
            await arrived(self._arm.start_replanned(goal, search))

    async def _move_by_service(
        self, service: MotionService, pose: Pose, extra: dict[str, Any], **kwargs: Any
    ) -> None:
        convert.from_pose(pose)  # refuses numbers that are not finite
        cloud = cloud_in(extra)
        destination = PoseInFrame(reference_frame=f"{self.short_name}_origin", pose=pose)
        if cloud is not None:
            extra = {key: value for key, value in extra.items() if key != "pose_cloud"}
            destination.goal_cloud.CopyFrom(to_goal_cloud(cloud))
        else:
            extra = {"goal_metric_type": "position_only", **extra}
        try:
            moved = await service.move(
                component_name=self.short_name,
                destination=destination,
                extra=extra,
                timeout=kwargs.get("timeout"),
            )
        except asyncio.CancelledError:
            await self._at_rest(self._arm.start_stop())
            raise
        if not moved:
            raise MotionError(f'the motion service "{service.name}" reports that it did not move')

    async def move_to_joint_positions(
        self, positions: JointPositions, *, extra: dict[str, Any] | None = None, **kwargs: Any
    ) -> None:
        """Move the joints along a planned path; returns on arrival.

        With ``extra={"wait": false}`` it returns at once, and the arm turns from its present motion
        straight towards the angles and stops short of contact: the form for a stream of targets.
        ``streamed`` of the published module is accepted and has no effect.
        """
        await self.ready()
        with grpc_statuses():
            q_goal = self._checked(convert.from_joint_values(positions.values))
            convert.flag(extra or {}, "streamed", False)
            waits = convert.flag(extra or {}, "wait", True)
            if convert.flag(extra or {}, REPLAN, False):
                if not waits:
                    raise ConfigError(REPLAN, True, "needs a call that waits for arrival")
                goal = JointGoal(q=q_goal)
                await self.replanned(goal, lambda scene: Search(scene=scene), self.arrived)
            elif waits:
                planning = self._planning(JointGoal(q=q_goal), Search())
                await self.arrived(self._arm.start_planned(planning))
            else:
                await self.guarded_scene.known()
                await_motion.log_failure_of(self._retarget(q_goal), self.logger)

    async def move_through_joint_positions(
        self,
        positions: list[JointPositions],
        options: MoveOptions | None = None,
        *,
        extra: dict[str, Any] | None = None,
        **kwargs: Any,
    ) -> None:
        """Follow joint waypoints without stopping at each; returns on arrival at the last.

        As Viam's teleoperation wants it: with ``interpolate`` false in ``extra`` the arm turns from
        its present motion straight to the last waypoint, with ``waitAtEnd`` false the call returns
        at once. With ``stops``, as ``get_status`` reports it, it is refused after a later stop.
        """
        await self.ready()
        extra = extra or {}
        with grpc_statuses():
            if checked_number("stops", extra.get("stops", self._arm.stops)) != self._arm.stops:
                raise Interrupted("stop")
            if convert.flag(extra, REPLAN, False):
                raise ConfigError(REPLAN, True, "is for one goal, but several waypoints are given")
            interpolate = convert.flag(extra, "interpolate", True)
            waits = convert.flag(extra, "waitAtEnd", True)
            limits = convert.from_move_options(options, self._arm.limits)
            waypoints = self._waypoints(positions)
            if len(waypoints) == 0:
                return
            if interpolate:
                goal = PathGoal(waypoints=waypoints)
                motion = self._arm.move(goal, limits=limits, wait=False)
            else:
                await self.guarded_scene.known()
                motion = self._retarget(waypoints[-1], limits=limits)
            if waits:
                await self.arrived(motion)
            else:
                await_motion.log_failure_of(motion, self.logger)

    # The SDK declares its async generator as a coroutine that returns one.
    async def move_through_joint_positions_streamed(  # type: ignore[override]
        self,
        batches: AsyncIterator[list[Arm.TrajectoryPoint]],
        *,
        extra: dict[str, Any] | None = None,
        **kwargs: Any,
    ) -> AsyncIterator[Arm.TrajectoryUpdate]:
        """Play time-stamped points as they come in; yields an acknowledgement for each batch."""
        await self.ready()
        with grpc_statuses():
            async with self.guarded_scene.kept_known():
                opening = self._start_stream()
                playing = await_motion.played(opening, batches, self._come_to_rest)
                async with aclosing(playing) as updates:
                    async for update in updates:
                        yield update

    def _waypoints(self, positions: list[JointPositions]) -> Array:
        """Waypoints without the start, shape (n, 5), [rad], every one within the limits."""
        rows = [
            convert.from_joint_values(entry.values, what=f"positions[{i}]")
            for i, entry in enumerate(positions)
        ]
        if len(rows) > 1 and self._is_here(rows[0]):
            del rows[0]  # the start; an arm may rest just outside the limits
        return np.array([self._checked(q) for q in rows]).reshape(-1, len(ARM_JOINTS))

    def _is_here(self, q: Array) -> bool:
        return bool(np.max(np.abs(q - self._arm.state.q)) <= AT_START)

    def _checked(self, q: Array) -> Array:
        q = self._arm.model.within_limits(q)
        self._arm.range.check(q)
        return q

    async def stop(self, **kwargs: Any) -> None:
        with grpc_statuses():
            await self._at_rest(self._arm.start_stop())

    async def make_way(self) -> None:
        await self._at_rest(self._arm.start_stop(by=SUPERSEDED))

    async def removed(self) -> None:
        """End the motion under way, the last one of this component; returns at rest."""
        self._ended_by = "the removal of its arm"
        with suppress(So101Error):  # the servos may not answer any more
            await self._at_rest(self._arm.start_stop(by=self._ended_by))

    async def _at_rest(self, stop: Future[None]) -> None:
        stopping = asyncio.wrap_future(stop)
        await self._come_to_rest(stopping)
        stopping.result()

    async def found(self) -> None:
        """Wait until the servos have been found, for a request that reads them."""

    async def measured(self) -> None:
        """Wait until the arm's place is known; refuse the request while it cannot be read."""

    @property
    def ignored(self) -> tuple[str, ...]:
        return self.config.ignored

    async def ready(self) -> None:
        """Read the other arms' positions, for a request that moves this arm."""
        await self.surroundings.update_other_arms()
        with grpc_statuses():
            if self._ended_by:
                raise Interrupted(self._ended_by)

    async def ended(self, motion: Motion, by: str) -> None:
        over = asyncio.wrap_future(motion.future)
        motion.interrupt(by)
        await self._come_to_rest(over)

    async def arrived(self, motion: Moving) -> None:
        """Wait until a motion of this arm has arrived; a cancelled wait ends it first."""
        await await_motion.wait_for_arrival(motion, self._come_to_rest)

    async def _come_to_rest(self, over: asyncio.Future[None]) -> None:
        await await_motion.rest(over)

    # Manual mode

    def _set_manual(self, enabled: bool, enabled_for: float) -> None:
        switching = self.set_manual_mode(enabled, enabled_for)
        asyncio.run_coroutine_threadsafe(switching, self._loop).result()

    async def set_manual_mode(
        self, manual_mode: bool, enabled_for: float = 0, **kwargs: Any
    ) -> None:
        await self.ready()
        with grpc_statuses():
            await self._manual.set(manual_mode, enabled_for)

    async def get_manual_mode(self, **kwargs: Any) -> bool:
        await self.found()
        return self._arm.is_movable_by_hand

    # Description

    async def get_properties(self, **kwargs: Any) -> Arm.Properties:
        return Arm.Properties(support_manual_mode=True, support_cartesian_commands=True)

    async def get_kinematics(self, **kwargs: Any) -> tuple[KinematicsFileFormat.ValueType, bytes]:
        name = self.short_name
        if self.config.use_urdf:
            return KinematicsFileFormat.KINEMATICS_FILE_FORMAT_URDF, kinematics.arm_urdf(name)
        return KinematicsFileFormat.KINEMATICS_FILE_FORMAT_SVA, kinematics.arm_sva(name)

    async def get_3d_models(self, **kwargs: Any) -> Mapping[str, Mesh]:
        return meshes.arm_models(with_tool=self.config.visualize_ee_frame)

    async def get_geometries(self, **kwargs: Any) -> list[Geometry]:
        await self.measured()
        marker = self._arm.T_base("tool") if self.config.visualize_ee_frame else None
        links = self._arm.T_base_links()
        return meshes.arm_geometries(self.short_name, links, marker)

    async def get_status(self, **kwargs: Any) -> Mapping[str, Any]:
        state = self._arm.state
        status = {
            "mode": "manual" if self._arm.is_movable_by_hand else "auto",
            "state": state.mode.value,
            "is_moving": await self.is_moving(),
            "joint_positions_deg": dict(zip(ARM_JOINTS, to_deg(state.q), strict=True)),
            "late_ticks": state.late_ticks,
            "stops": self._arm.stops,
            "touching": self._manual.touching,
            "fault": state.fault,
        }
        return convert.to_result(status)

    # Requests

    async def do_command(self, command: Mapping[str, Any], **kwargs: Any) -> Mapping[str, Any]:
        self._loop = asyncio.get_running_loop()
        name = command.get("command")
        if isinstance(name, str) and name in self.NEEDS_SERVOS:
            await self.found()
        return await super().do_command(command)

    async def _motion_params(self, request: Request) -> dict[str, Any]:
        """Answer ``set_speed``, ``set_acceleration`` and ``get_motion_params``; all or none."""
        given, arm = arguments(request, KEYS), self._arm
        wanted = {
            key: checked_number(key, request[key], lower=lower, upper=upper, unit=unit)
            for key, (lower, upper), unit in (
                ("set_speed", SPEED_RANGE_DEG, "deg/s"),
                ("set_acceleration", ACCELERATION_RANGE_DEG, "deg/s^2"),
            )
            if key in request
        }
        wants_params = given.flag("get_motion_params", False)
        result: dict[str, Any] = {}
        if "set_speed" in wanted:
            result["speed_set"] = wanted["set_speed"]
            arm.set_speed(to_rad(wanted["set_speed"]))
        if "set_acceleration" in wanted:
            result["acceleration_set"] = wanted["set_acceleration"]
            arm.set_acceleration(to_rad(wanted["set_acceleration"]))
        if wants_params:
            result["current_speed_degs_per_sec"] = in_deg(arm.speed)
            result["current_acceleration_degs_per_sec_per_sec"] = in_deg(arm.acceleration)
        return result

    async def _get_planning_setup(self) -> dict[str, Any]:
        lower, upper = self._arm.range
        return convert.to_result({
            "scene": scene_to(self._arm.scene),
            "joint_min_deg": to_deg(lower),
            "joint_max_deg": to_deg(upper),
            "max_speed_degs_per_sec": in_deg(self._arm.ceiling.speed),
            "max_acceleration_degs_per_sec_per_sec": in_deg(self._arm.ceiling.acceleration),
        })  # fmt: skip

    async def _get_surroundings(self) -> dict[str, Any]:
        """What is around the arm besides its scene, as in a scene file; or why it is ``unknown``.

        Other arms count where they are now and where their motions end.
        """
        own = self._arm.scene
        try:
            now = await self.surroundings.standing(own)
        except SurroundingsUnknown as error:
            return {"unknown": str(error)}
        added = Scene(
            obstacles=now.obstacles[len(own.obstacles) :],
            attached=now.attached[len(own.attached) :],
        )
        told = await asyncio.to_thread(scene_to, added)
        member = self._arm.cell_member  # since it was read, perhaps
        others = [
            StandingArm(
                name=other.name,
                T_base_arm=other.T_base_other,
                q=other.course.q[:: max(len(other.course.q) - 1, 1)],
                attached=other.attached,
                room=ROOM,
            )
            for other in ([] if member is None else member.others())
        ]
        shown = {key: told.get(key, []) for key in ("obstacles", "attached")}
        return convert.to_result({**shown, "arms": arms_to(others)})

    async def _run_program(self, given: Attributes) -> dict[str, Any]:
        """Plan a program, and run it as one motion: a Stop or a newer motion ends all of it."""
        from so101_motion.tasks.program import ARM, ProgramRun, Rehearsal, Solo, rehearse
        from so101_motion.tasks.program.files import program_from, rounds_to

        content = {key: given.raw(key) for key in _PROGRAM if given.given(key)}
        program = (await asyncio.to_thread(program_from, content)).on([ARM])
        await self.set_manual_mode(False)  # holds again after a fault, too
        solo = Solo(self._arm, jaw_of(self.rig), self.rig.clock, picker=self.rig.picker)

        def planned() -> Rehearsal:
            """Called on the arm's planning thread once it rests."""
            if self.surroundings.is_asked():
                solo.scene = self._scene_now()
            return rehearse(solo, program)

        run = ProgramRun(solo, program, planned)
        await self.arrived(run.motions[ARM])
        assert run.rehearsal is not None
        return {
            "waypoints": len(program),
            "rounds": rounds_to(program.rounds),
            "round_s": round(run.rehearsal.duration, 3),
        }

    def _scene_now(self) -> Scene:
        """The arm's scene with what the machine has around it; on the arm's thread."""
        scene, around = self._arm.scene, self.surroundings
        if not around.is_asked():
            return scene
        return wait_here(asyncio.run_coroutine_threadsafe(around.around(scene), self._loop))

    async def _leave_contact(self) -> dict[str, Any]:
        await self.ready()
        motion = self._arm.start_planned(self._planning(LeaveContactGoal(), Search()))
        await self.arrived(motion)
        blind = motion.plan is not None and motion.plan.report.blind
        return {"success": True} | ({"note": _BLIND} if blind else {})

    async def _enter_manual_mode(self, given: Attributes) -> dict[str, Any]:
        wanted = compliance(given, self._arm.compliance)
        seconds = given.number("enabled_for", 0.0, lower=0.0, upper=LONGEST_GUIDING, unit="s")
        await self.ready()
        await self._manual.set(True, seconds, wanted)
        return {"mode": "manual"}

    async def _exit_manual_mode(self) -> dict[str, Any]:
        await self._manual.set(False)
        return {"mode": "auto"}

    async def close(self) -> None:
        if self.here.get(self.short_name) is self:
            del self.here[self.short_name]
        self._manual.forget()
        await await_motion.run_to_end(self.teaching.close)
        await self.guarded_scene.close()
        await self.surroundings.close()
        await await_motion.in_own_thread(self._leave)

    def _leave(self) -> None:
        with suppress(So101Error):  # the servos may not answer any more
            self.cell.leave(self.short_name, self.rig)
        self.rig.close()


def motion_name(service: str) -> str:
    return service if "/" in service else f"rdk:service:motion/{service}"


def motion_service(name: str | None, dependencies: Dependencies) -> MotionService | None:
    if name is None:
        return None
    client: MotionService | None = dependency(dependencies, "motion", name)
    if client is None:
        raise ConfigError("motion", name, "is not a motion service of this machine; check the name")
    return client


def sources(
    senses: SensesConfig, dependencies: Dependencies, logger: logging.Logger
) -> Sequence[Source]:
    """The store and the camera that report the surroundings; the caller closes them.

    A resource that the machine does not have makes a source too; planning with it fails.
    """
    found: list[Source] = []
    if senses.store is not None:
        store = dependency(dependencies, "world_state_store", senses.store)
        found.append(StoreWatch(senses.store, store, logger))
    if senses.camera is not None:
        camera = dependency(dependencies, "camera", senses.camera)
        finder = dependency(dependencies, "vision", senses.vision)
        found.append(CameraView(senses.camera, camera, senses.vision, finder))
    return found
