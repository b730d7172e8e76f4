"""Run the process that viam-server starts: register its models, serve, clean up at the end.

A SIGTERM (or a SIGHUP, when a terminal ends) closes the server, which closes every component. A
parent process that disappears (``kill -9``) is noticed within a second, long before the SDK would,
and has the same effect. Arms that are configured to be released at the end are released before the
components are closed: closing a component alone, as every change of its configuration does, leaves
the arm holding.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from contextlib import suppress
from functools import partial
from typing import Any

from grpclib import GRPCError, Status
from grpclib.metadata import Deadline
from grpclib.server import Stream
from viam.logging import getLogger
from viam.module.module import Module
from viam.proto.app.robot import ComponentConfig
from viam.proto.module import (
    AddResourceRequest,
    RemoveResourceRequest,
    ValidateConfigRequest,
    ValidateConfigResponse,
)
from viam.proto.robot import GetPoseRequest, GetPoseResponse
from viam.robot.service import RobotService
from viam.rpc.server import Server

from so101_motion.arm.planning_worker import acquire_worker, release_worker
from so101_motion.common.import_check import explain, sentence
from so101_motion.common.realtime import import_quietly, reduce_jitter
from so101_motion.viam.conversion.convert import grpc_statuses
from so101_motion.viam.conversion.frames import GIVE_FRAME, asked, machine_here, set_machine
from so101_motion.viam.models.registered import MODELS, RegisteredModel, register, registered
from so101_motion.viam.requests.request_guard import guard

LATER = (
    "so101_motion.setup.identify",
    "so101_motion.tasks.program",
    "so101_motion.setup.calibration_operation",
)
"""Imported a while after the first resource was added: the first requests need not wait for them.
They are imported where they are used, too, should that be earlier."""

register()
getLogger("so101_motion")  # sends our log to viam-server's

_CHECK_PERIOD = 1.0  # [s] between two checks of the parent process; chosen
_HARDWARE = "so101_motion.rig.hardware_rig"
_QUIET = 3.0  # [s] after the first resource; chosen, its first requests are over then
_ARM_COMES = 30.0  # [s] for which the planning process is kept for an arm to come; chosen
_PATIENCE = 8.0  # [s] for cleaning up once the parent is gone; chosen, viam-server itself gives 10


class So101Module(Module):
    """The SDK's module with plain error messages, and arms that end their motion when removed."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._keeps_planner = False
        self._loaded: set[RegisteredModel] = set()
        self._loading = asyncio.Lock()
        self._imports: asyncio.Task[None] | None = None

    async def add_resource(
        self, request: AddResourceRequest, *, deadline: Deadline | None = None
    ) -> None:
        await self._load(request.config)
        await super().add_resource(request, deadline=deadline)
        self._imports = self._imports or asyncio.create_task(_import_later())

    async def validate_config(self, request: ValidateConfigRequest) -> ValidateConfigResponse:
        """Check a configuration; a message has no Python type before it.

        A thousand obstacles take a tenth of a second, so they are checked in a thread first; the
        SDK's check on the event loop then uses the cached result.
        """
        model = await self._load(request.config)
        with suppress(Exception):  # the SDK's own check raises it again
            if model is not None:
                await asyncio.to_thread(model.validate_config, request.config)
        try:
            return await super().validate_config(request)
        except GRPCError as error:
            message = (error.message or "").removeprefix(f"{type(Exception)}: ")
            raise GRPCError(error.status, message) from error

    async def remove_resource(self, request: RemoveResourceRequest) -> None:
        """Remove a resource, also to rebuild it; first end an arm's motion with an error.

        The SDK alone would stop the arm as if somebody had pressed Stop.
        """
        api, _, name = request.name.rpartition("/")
        arms = _if_imported("so101_motion.viam.models.arm_resource", "ArmResource")
        arm = arms.here.get(name) if arms is not None and api == str(arms.API) else None
        if arm is not None:
            await arm.removed()
        await super().remove_resource(request)

    def end(self) -> None:
        if self._imports is not None:
            self._imports.cancel()
        self._leave_planner()

    async def _load(self, config: ComponentConfig) -> RegisteredModel | None:
        """Import a model in a thread, because the event loop answers Stop; None if unknown."""
        model = registered(config.api, config.model)
        async with self._loading:
            if model is None or model in self._loaded:
                return model
            # A process that starts holds the files that are open here, ports too.
            if model.plans and _if_imported(_HARDWARE, "HardwareRig") is None:
                self._start_planner()
            try:
                await asyncio.to_thread(model.load)
            except ImportError as error:
                if explain(error) is None:
                    raise
                raise GRPCError(Status.FAILED_PRECONDITION, sentence(error)) from error
            self._loaded.add(model)
        return model

    def _start_planner(self) -> None:
        if not self._keeps_planner:
            self._keeps_planner = True
            acquire_worker().start()
            loop = asyncio.get_running_loop()
            loop.call_later(_ARM_COMES, loop.run_in_executor, None, self._leave_planner)

    def _leave_planner(self) -> None:
        if self._keeps_planner:
            self._keeps_planner = False
            release_worker()


async def run() -> None:
    serve_get_pose()
    module = So101Module.from_args()
    set_machine(lambda: module.parent)
    for each in MODELS:
        module.add_model_from_registry(each.api, each.model)
    guard(module.server)
    _end_before_clients(module.server)
    _leave_before_closing(module.server)
    reduce_jitter()
    if sys.platform != "win32":
        hung_up = partial(os.kill, os.getpid(), signal.SIGTERM)
        asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, hung_up)
    watch = asyncio.create_task(_end_with_parent(os.getppid()))
    try:
        await module.start()  # type: ignore[no-untyped-call]  # the SDK left it unannotated
    finally:
        watch.cancel()
        module.end()


async def _import_later() -> None:
    await asyncio.sleep(_QUIET)
    with suppress(ImportError):  # whoever needs it says what is missing
        for name in LATER:
            await asyncio.to_thread(import_quietly, name)


def _if_imported(module: str, name: str) -> Any:
    """Something in a module that has been imported whole; else None."""
    return getattr(sys.modules.get(module), name, None)


def _end_before_clients(server: Server) -> None:
    """Make the server close while viam-server is still connected.

    Since Python 3.12 asyncio's ``Server.wait_closed`` waits until every client has disconnected.
    The components would be closed only then, and viam-server kills a module that takes so long.
    """
    grpc = server._server

    async def wait_closed() -> None:
        assert grpc._server_closed_fut is not None, "the SDK starts it first"
        await grpc._server_closed_fut
        await asyncio.gather(*(handler.wait_closed() for handler in grpc._handlers))

    grpc.wait_closed = wait_closed  # type: ignore[method-assign]  # less one wait, else grpclib's


def _leave_before_closing(server: Server) -> None:
    close = server.close

    async def leave_and_close() -> None:
        leave = _if_imported(_HARDWARE, "leave_arms_at_end")  # else there is no real arm
        try:
            if leave is not None:
                from so101_motion.viam.requests.await_motion import in_own_thread

                await in_own_thread(leave)
        finally:
            await close()  # type: ignore[no-untyped-call]  # the SDK left it unannotated

    server.close = leave_and_close  # type: ignore[method-assign]  # the SDK has no hook for it


async def _end_with_parent(parent: int) -> None:
    while True:
        await asyncio.sleep(_CHECK_PERIOD)
        if os.getppid() != parent:
            break
    os.kill(os.getpid(), signal.SIGTERM)
    await asyncio.sleep(_PATIENCE)
    os._exit(1)  # no other process would end this one


async def _get_pose(service: RobotService, stream: Stream[GetPoseRequest, GetPoseResponse]) -> None:
    request = await stream.recv_message()
    assert request is not None
    machine = machine_here()
    if machine is None:
        raise GRPCError(
            Status.FAILED_PRECONDITION,
            "the module is not connected to its machine, which knows where its components are;"
            " try again when viam-server is up",
        )
    transforms = list(request.supplemental_transforms)
    with grpc_statuses():
        try:
            pose = await asked(
                lambda: machine.get_pose(
                    request.component_name, request.destination_frame, transforms
                )
            )
        except GRPCError as error:  # viam-server's have the status UNKNOWN
            if "not in frame system" not in (error.message or ""):
                raise
            raise GRPCError(Status.NOT_FOUND, f"{error.message}; {GIVE_FRAME}") from error
    await stream.send_message(GetPoseResponse(pose=pose))


def serve_get_pose() -> None:
    """Answer the machine's ``GetPose`` on all servers that are made from now on.

    viam-server does not pass ``GetPose`` of a motion service on to the module. Its client sends the
    machine's request of that name to the module's socket instead, and the SDK answers
    UNIMPLEMENTED. Here it is passed on to the machine, which knows all frames. It does not name the
    service, so all motion services of this module give the same answer.
    """
    setattr(RobotService, "GetPose", _get_pose)  # noqa: B010  # the SDK has no hook for it
