"""Find the components that viam-server's frame system leaves out because they do not run.

An arm or gantry that failed or is being configured is missing from the frame system, as if the
machine had none. The parts of a remote machine that is not connected are missing too.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from grpclib import GRPCError, Status
from viam.proto.robot import ResourceStatus

from so101_motion.common.errors import clipped
from so101_motion.viam.conversion.frames import Machine

_LEFT_OUT = ("arm", "gantry")
"""Kinds that are in it only while they run. Grippers are too, but each is attached to one of
these."""

_RUNS = (ResourceStatus.STATE_READY, ResourceStatus.STATE_UNSPECIFIED)


async def missing_parts(machine: Machine, left_out: Collection[str]) -> Mapping[str, str]:
    """The arms and gantries that do not run.

    Args:
        machine: The machine.
        left_out: Components that are ignored.

    Returns:
        Why each has failed, by name; empty for one that is being configured.

    Raises:
        GRPCError: The machine does not answer.
    """
    return {
        each.name.name: clipped(each.error, 300)
        for each in await _components(machine)
        if each.name.subtype in _LEFT_OUT
        and not each.remote
        and each.name.name not in left_out
        and each.state not in _RUNS
    }


async def lost_part(machine: Machine, gone: Collection[str]) -> str | None:
    """The first part of ``gone`` that is still a component of the machine; None without one."""
    listed = {each.name.name for each in await _components(machine)} if gone else set()
    return next((name for name in gone if name in listed), None)


async def _components(machine: Machine) -> list[ResourceStatus]:
    try:
        status = await machine.get_machine_status()
    except GRPCError as error:
        if error.status is Status.UNIMPLEMENTED:  # an older viam-server
            return []
        raise
    return [each for each in status.resources if each.name.type == "component"]
