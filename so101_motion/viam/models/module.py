"""Run the process that viam-server starts: register its models, serve, clean up at the end.

Importing this module registers the models. A SIGTERM (or a SIGHUP, when a terminal ends) closes the
server, which closes every component. A parent process that disappears (``kill -9``) is noticed
within a second, long before the SDK would, and has the same effect. In any case the planning
process ends by itself when its pipe closes. Arms that are configured to be released at the end are
released before the components are closed: closing a component alone, as every change of its
configuration does, leaves the arm holding.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
from contextlib import suppress
from functools import partial
from importlib import import_module

from grpclib import GRPCError
from viam.logging import getLogger
from viam.module.module import Module
from viam.proto.module import (
    ReadyRequest,
    ReadyResponse,
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

LATER = (
    "so101_motion.setup.identify",
    "so101_motion.tasks.program",
    "so101_motion.viam.requests.calibration_commands",
)
"""Imported once the module is ready: a tenth of all imports, which the first requests need not wait
for. They are imported where they are used, too, should that be earlier."""

for _model in MODELS:
    Registry.register_resource_creator(
        _model.API,
        _model.MODEL,
        ResourceCreatorRegistration(_model.new, _model.validate_config),
    )

getLogger("so101_motion")  # sends our log to viam-server's

_CHECK_PERIOD = 1.0  # [s] between two checks of the parent process; chosen
_PATIENCE = 8.0  # [s] for cleaning up once the parent is gone; chosen, viam-server itself gives 10


class So101Module(Module):
    """The SDK's module with plain error messages, and arms that end their motion when removed."""

    async def ready(self, request: ReadyRequest) -> ReadyResponse:
        """List the models, and import the rest in the background."""
        answer = await super().ready(request)
        threading.Thread(target=_import_later, name="so101-imports", daemon=True).start()
        return answer

    async def validate_config(self, request: ValidateConfigRequest) -> ValidateConfigResponse:
        """Check a configuration.

        A thousand obstacles take a tenth of a second, so they are checked in a thread first; the
        SDK's check on the event loop then uses the cached result.

        Raises:
            GRPCError: The configuration is not valid; the message has no Python type before it.
        """
        config = request.config
        with suppress(Exception):  # the SDK's own check raises it again
            api, model = API.from_string(config.api), Model.from_string(config.model)
            await asyncio.to_thread(Registry.lookup_validator(api, model), config)
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
        arm = ArmResource.here.get(name) if api == str(ArmResource.API) else None
        if arm is not None:
            await arm.removed()
        await super().remove_resource(request)


async def run() -> None:
    """Serve until the process is to end."""
    serve_get_pose()
    module = So101Module.from_args()
    set_machine(lambda: module.parent)
    for model in MODELS:
        module.add_model_from_registry(model.API, model.MODEL)
    await asyncio.to_thread(user_storage.remove_old_leftovers)
    guard(module.server)
    _end_before_clients(module.server)
    _release_before_closing(module.server)
    reduce_jitter()
    if sys.platform != "win32":
        hung_up = partial(os.kill, os.getpid(), signal.SIGTERM)
        asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, hung_up)
    watch = asyncio.create_task(_end_with_parent(os.getppid()))
    try:
        await module.start()  # type: ignore[no-untyped-call]  # the SDK left it unannotated
    finally:
        watch.cancel()


def _import_later() -> None:
    for name in LATER:
        import_module(name)


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


def _release_before_closing(server: Server) -> None:
    close = server.close

    async def release_and_close() -> None:
        await in_own_thread(release_arms_at_end)
        await close()  # type: ignore[no-untyped-call]  # the SDK left it unannotated

    server.close = release_and_close  # type: ignore[method-assign]  # the SDK has no hook for it


async def _end_with_parent(parent: int) -> None:
    while True:
        await asyncio.sleep(_CHECK_PERIOD)
        if os.getppid() != parent:
            break
    os.kill(os.getpid(), signal.SIGTERM)
    await asyncio.sleep(_PATIENCE)
    os._exit(1)  # no other process would end this one
