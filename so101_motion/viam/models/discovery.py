"""``devrel:so101:discovery``: suggests configurations for the arms on the serial ports."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

from google.protobuf import json_format
from viam.proto.app.robot import ComponentConfig
from viam.resource.types import Model
from viam.services.discovery import Discovery as DiscoveryService

from so101_motion.setup.discovery import Discovery, PortReport, Suggestion, discover
from so101_motion.viam.component_config import DiscoveryConfig
from so101_motion.viam.conversion.convert import grpc_statuses
from so101_motion.viam.models.arm_resource import ArmResource
from so101_motion.viam.models.configured import Configured, Dependencies
from so101_motion.viam.models.hardware_arm import HardwareArm
from so101_motion.viam.requests.commands import Command


class So101Discovery(Configured, DiscoveryService):
    """Finds arms on the serial ports."""

    MODEL: ClassVar = Model.from_string("devrel:so101:discovery")
    CONFIG = DiscoveryConfig

    def __init__(self, name: str, ports: Sequence[str]) -> None:
        super().__init__(name)
        self._ports = ports
        self._commands: dict[str, Command] = {"report": self._report}

    @classmethod
    def build(
        cls, name: str, wanted: DiscoveryConfig, dependencies: Dependencies
    ) -> So101Discovery:
        return cls(name, wanted.ports)

    async def discover_resources(self, **kwargs: Any) -> list[ComponentConfig]:
        """Suggest configurations for the servos that are plugged in, in under 2 s.

        The log has a line for each port: what was found there, or why nothing was.
        """
        found = await self._look()
        return [_config(one) for report in found.reports for one in report.suggestions]

    async def get_status(self, **kwargs: Any) -> Mapping[str, Any]:
        return {"ports": list(self._ports)}

    async def _look(self) -> Discovery:
        with grpc_statuses():
            found = await asyncio.to_thread(discover, self._ports)
        for report in found.reports:
            self.logger.info("%s: %s", report.port.name, report.sentence)
        for note in found.notes:
            self.logger.warning("%s", note)
        if found.reports and not any(report.has_arm for report in found.reports):
            self.logger.warning("no complete arm found; the lines above say why, port by port")
        return replace(found, reports=tuple(map(_named, found.reports)))

    async def _report(self) -> dict[str, Any]:
        found, ports = await self._look(), []
        for report in found.reports:
            values = {**report.to_json(), "names": [one.name for one in report.suggestions]}
            ports.append({key: value for key, value in values.items() if value is not None})
        return {"ports": ports, "notes": list(found.notes)}


def _named(report: PortReport) -> PortReport:
    """The report with the name of the arm that is configured on the port, if one is."""
    if "arm" not in report.configured:
        return report
    for name, arm in ArmResource.here.items():
        if isinstance(arm, HardwareArm) and arm.rig.is_on(report.port.name):
            return replace(report, arm_name=name)
    return report


def _config(one: Suggestion) -> ComponentConfig:
    namespace, _, kind = one.api.split(":")
    entry = {**one.to_json(), "namespace": namespace, "type": kind}
    config: ComponentConfig = json_format.ParseDict(entry, ComponentConfig())
    return config
