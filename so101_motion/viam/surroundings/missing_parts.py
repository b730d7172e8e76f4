"""Which components viam-server's frame system leaves out because they do not run.

An arm or a gantry that failed, or is just being configured, is not in it, as if there were none;
nor is what a remote machine has that is not connected.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from grpclib import GRPCError, Status
from viam.proto.robot import ResourceStatus

from so101_motion.common.errors import clipped
from so101_motion.viam.conversion.frames import Machine

_LEFT_OUT = ("arm", "gantry")
"""Kinds that are in it only while they run. Grippers are, too, but they hang from one of those."""

_RUNS = (ResourceStatus.STATE_READY, ResourceStatus.STATE_UNSPECIFIED)


async def missing_parts(machine: Machine, left_out: Collection[str]) -> Mapping[str, str]:
    """Arms and gantries that do not run, by name.

    Args:
        machine: What is asked.
        left_out: Those that do not count.

    Returns:
        Why each has failed; empty for one that is being configured.

    Raises:
        GRPCError: The machine does not say.
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
    """The first of the parts that have gone from the frame system but are still components."""
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
