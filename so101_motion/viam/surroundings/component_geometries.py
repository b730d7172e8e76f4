"""Ask components of the machine for their geometries.

A call takes a third of a millisecond of this process, and all calls together most of what a look at
the machine takes. A component whose answer adds nothing to the configuration of its frame is asked
again only after a while. A call has no time limit of its own, which would take a tenth more: who
looks at the machine has one.
"""

from __future__ import annotations

import time
from collections.abc import Iterable

from grpclib import GRPCError, Status
from viam.errors import ResourceNotFoundError
from viam.proto.common import Geometry, ResourceName

from so101_motion.common.errors import SurroundingsUnknown
from so101_motion.viam.conversion.frames import machine_here

_ASK_AGAIN = 5.0
"""How long until a component is asked again whose answer added nothing [s]; chosen."""

REMOTE = "_world"
"""The end of the frame's name of a remote machine, which is no component."""

_HAS_NONE = ("unimplemented", "not implemented", "unsupported")
"""Words that modules in other languages send for UNIMPLEMENTED."""


class ComponentGeometries:
    """The answers of components to ``GetGeometries``. Belongs to the event loop."""

    def __init__(self) -> None:
        self._plain: dict[str, float] = {}  # whose answers added nothing, and when

    def forget(self) -> None:
        self._plain.clear()

    def has_to_be_asked(self, name: str) -> bool:
        """Whether a component has to be asked: not if its answer added nothing a moment ago."""
        since = self._plain.get(name)
        return since is None or time.monotonic() - since >= _ASK_AGAIN

    async def geometries(self, name: str, own: list[Geometry]) -> list[Geometry]:
        """The geometries in a component's answer and in its frame's configuration, ``own``."""
        try:
            answer = await self._ask(name)
        except SurroundingsUnknown:
            if own:
                return own
            raise
        if all(_is_among(each, own) for each in answer):
            self._plain[name] = time.monotonic()
            return own
        self._plain.pop(name, None)
        # Of a component without a geometry in its configuration viam-server takes the first answer.
        return [*(each for each in own if not _is_among(each, answer)), *answer]

    async def _ask(self, name: str) -> list[Geometry]:
        machine = machine_here()
        assert machine is not None
        resource = _component(machine.resource_names, name)
        if resource is None:
            await machine.refresh()  # type: ignore[no-untyped-call]  # the SDK's
            resource = _component(machine.resource_names, name)
        if resource is None and name.endswith(REMOTE):
            return []
        if resource is None:
            reason = f'"{name}" has a frame but does not run, so its shape is unknown'
            raise SurroundingsUnknown(reason, component=name)
        try:
            client = machine.get_component(resource)
        except ResourceNotFoundError:
            return []  # of an API that this SDK does not know
        try:
            return list(await client.get_geometries())
        except NotImplementedError:
            return []
        except GRPCError as error:
            if _has_none(error):
                return []
            reason = f'"{name}" does not report its geometries: {words(error)}'
            raise SurroundingsUnknown(reason, component=name) from error


def words(error: GRPCError) -> str:
    return error.message or ""


def _component(names: list[ResourceName], name: str) -> ResourceName | None:
    wanted = [each for each in names if each.type == "component" and each.name == name]
    return wanted[0] if wanted else None


def _is_among(geometry: Geometry, others: Iterable[Geometry]) -> bool:
    bare = Geometry()
    for each in others:
        bare.CopyFrom(each)
        bare.label = geometry.label
        if bare == geometry:
            return True
    return False


def _has_none(error: GRPCError) -> bool:
    message = (error.message or "").lower()
    return error.status is Status.UNIMPLEMENTED or any(word in message for word in _HAS_NONE)
