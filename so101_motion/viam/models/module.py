"""Run the process that viam-server starts: register its models, serve, end in order.

Importing this registers the models. The process ends in three ways and cleans up in all: a SIGTERM
(or a SIGHUP, when a terminal ends) closes the server, which closes every component; a parent that
vanishes without a word (``kill -9``) is noticed within a second, long before the SDK would, and is
treated the same; and whatever else happens, the planning process leaves by itself when its pipe
ends. Before the components are closed, arms that are to be let go of at the end are: closing a
component alone, as every change of its configuration does, leaves the arm holding.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from contextlib import suppress
from functools import partial

from grpclib import GRPCError
from viam.logging import getLogger
from viam.module.module import Module
from viam.proto.module import (
    RemoveResourceRequest,
    ValidateConfigRequest,
    ValidateConfigResponse,
)
from viam.resource.registry import Registry, ResourceCreatorRegistration
from viam.resource.types import API, Model
from viam.rpc.server import Server

from so101_motion.common.realtime import reduce_jitter
from so101_motion.files import user_storage
from so101_motion.rig.hardware_rig import release_arms_at_end
from so101_motion.viam.conversion.frames import set_machine
from so101_motion.viam.models.arm_resource import ArmResource
from so101_motion.viam.models.calibration import So101Calibration
from so101_motion.viam.models.discovery import So101Discovery
from so101_motion.viam.models.hardware_arm import HardwareArm
from so101_motion.viam.models.hardware_gripper import HardwareGripper
from so101_motion.viam.models.machine_pose import serve_get_pose
from so101_motion.viam.models.motion_service import So101Motion
from so101_motion.viam.models.simulated import SimulatedArm
from so101_motion.viam.models.simulated_gripper import SimulatedGripper
from so101_motion.viam.models.teleop import So101Teleop
from so101_motion.viam.models.world_state_store import So101WorldState
from so101_motion.viam.requests.await_motion import in_own_thread
from so101_motion.viam.requests.request_guard import guard

MODELS = (
    HardwareArm,
    HardwareGripper,
    SimulatedArm,
    SimulatedGripper,
    So101Calibration,
    So101Discovery,
    So101Motion,
    So101Teleop,
    So101WorldState,
)
"""Every model of this module."""

for _model in MODELS:
    Registry.register_resource_creator(
        _model.API,
        _model.MODEL,
        ResourceCreatorRegistration(_model.new, _model.validate_config),
    )

getLogger("so101_motion")  # gives our loggers the SDK's way to viam-server's log

_LOOK_PERIOD = 1.0  # [s] between two looks at the parent; chosen
_PATIENCE = 8.0  # [s] to end in order once the parent is gone; chosen, viam-server itself gives 10


class So101Module(Module):
    """The SDK's module, whose refusals of a configuration are sentences."""

    async def validate_config(self, request: ValidateConfigRequest) -> ValidateConfigResponse:
        """Check a configuration.

        A thousand obstacles take a tenth of a second, so they are checked in a thread first; the
        SDK's check on the event loop then finds them checked.

        Raises:
            GRPCError: What is wrong with it, without the type that the SDK puts before it.
        """
        config = request.config
        with suppress(Exception):  # the SDK says what is wrong
            api, model = API.from_string(config.api), Model.from_string(config.model)
            await asyncio.to_thread(Registry.lookup_validator(api, model), config)
        try:
            return await super().validate_config(request)
        except GRPCError as error:
            told = (error.message or "").removeprefix(f"{type(Exception)}: ")
            raise GRPCError(error.status, told) from error

    async def remove_resource(self, request: RemoveResourceRequest) -> None:
        """Remove a resource, also to build it anew; who waits for an arm's motion is told so.

        The SDK would stop the arm, as if somebody had pressed Stop.
        """
        api, _, name = request.name.rpartition("/")
        arm = ArmResource.here.get(name) if api == str(ArmResource.API) else None
        if arm is not None:
            await arm.removed()
        await super().remove_resource(request)


async def run() -> None:
    """Serve until told to end."""
    serve_get_pose()
    module = So101Module.from_args()
    set_machine(lambda: module.parent)
    for model in MODELS:
        module.add_model_from_registry(model.API, model.MODEL)
    await asyncio.to_thread(user_storage.remove_old_leftovers)
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


def _end_before_clients(server: Server) -> None:
    """Have the server end while viam-server is still connected, as it always is.

    Since Python 3.12 asyncio's ``Server.wait_closed`` waits until every client has gone. The
    components would be closed only then, and viam-server kills a module that takes so long.
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
        await in_own_thread(release_arms_at_end)
        await close()  # type: ignore[no-untyped-call]  # likewise

    server.close = leave_and_close  # type: ignore[method-assign]  # the SDK asks nobody at its end


async def _end_with_parent(parent: int) -> None:
    while True:
        await asyncio.sleep(_LOOK_PERIOD)
        if os.getppid() != parent:
            break
    os.kill(os.getpid(), signal.SIGTERM)
    await asyncio.sleep(_PATIENCE)
    os._exit(1)  # nobody is left who would end us
