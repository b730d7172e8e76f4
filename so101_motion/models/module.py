"""The process that viam-server starts: its models, and its end.

Importing this registers the models. The process ends in three ways and cleans up in all: a SIGTERM
closes the server, which closes every component; a parent that vanishes without a word (``kill -9``)
is noticed within a second, long before the SDK would, and is treated the same; and whatever else
happens, the planning process leaves by itself when its pipe ends. Before the components are closed,
arms that are to be let go of at the end are: closing a component alone, as every change of its
configuration does, leaves the arm holding.
"""

from __future__ import annotations

import asyncio
import os
import signal

from viam.logging import getLogger
from viam.module.module import Module
from viam.resource.registry import Registry, ResourceCreatorRegistration
from viam.rpc.server import Server

from so101_motion.models.calibration import So101Calibration
from so101_motion.models.discovery import So101Discovery
from so101_motion.models.frames import set_machine
from so101_motion.models.hardware_arm import HardwareArm
from so101_motion.models.hardware_gripper import HardwareGripper
from so101_motion.models.motion_service import So101Motion
from so101_motion.models.simulated import SimulatedArm
from so101_motion.models.simulated_gripper import SimulatedGripper
from so101_motion.models.teleop import So101Teleop
from so101_motion.models.world_state_store import So101WorldState
from so101_motion.realtime import steady_interpreter
from so101_motion.rig import leave_all

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


async def run() -> None:
    """Serve until told to end."""
    module = Module.from_args()
    set_machine(lambda: module.parent)
    for model in MODELS:
        module.add_model_from_registry(model.API, model.MODEL)
    _leave_before_closing(module.server)
    steady_interpreter()
    watch = asyncio.create_task(_end_with_parent(os.getppid()))
    try:
        await module.start()  # type: ignore[no-untyped-call]  # the SDK left it unannotated
    finally:
        watch.cancel()


def _leave_before_closing(server: Server) -> None:
    close = server.close

    async def leave_and_close() -> None:
        await asyncio.to_thread(leave_all)
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
