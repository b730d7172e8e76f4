"""A connection to a machine that has a calibration sensor but no arm yet.

``MachineRig`` needs an arm, and no arm can be configured before the motors have their ids. Until
then this class connects to the sensor alone.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from grpclib import GRPCError
from viam.components.sensor import Sensor
from viam.robot.client import RobotClient

from so101_motion.common.errors import ConfigError
from so101_motion.viam.client.link import PATIENCE, Access
from so101_motion.viam.client.machine import Machine

_PERIOD = 1.0  # [s] between two readings

MARK = "calibration_state"
"""A key that only a calibration sensor's readings have."""


class MachineSensor(Machine):
    """A machine's calibration sensor. ``connect`` makes it; close it after use.

    Attributes:
        name: The sensor's name in the configuration.
    """

    def __init__(self, access: Access) -> None:
        super().__init__(access)
        self.name = ""
        self._link.open()

    @classmethod
    def connect(
        cls, address: str, *, api_key_id: str | None = None, api_key: str | None = None
    ) -> MachineSensor:
        """Connect to a machine; its motors are not touched.

        Args:
            address: As on the machine's CONNECT page, or host and port.
            api_key_id: The id of an API key; without a key the connection is plain and direct.
            api_key: The key.

        Raises:
            MachineUnavailable: It cannot be reached.
            ConfigError: It has no calibration sensor.
        """
        return cls(Access(address=address, api_key_id=api_key_id, api_key=api_key))

    # The loop's thread

    async def _poll(self, client: RobotClient, connected: Callable[[], None]) -> None:
        sensor = await self._found(client)
        self.name = sensor.name
        while True:
            connected()
            await asyncio.sleep(_PERIOD)
            async with asyncio.timeout(PATIENCE):
                await sensor.get_readings(timeout=PATIENCE)

    async def _found(self, client: RobotClient) -> Sensor:
        for each in client.resource_names:
            if each.subtype == "sensor":
                sensor = client.get_component(each)
                assert isinstance(sensor, Sensor)  # by its subtype
                try:
                    readings = await sensor.get_readings(timeout=PATIENCE)
                except GRPCError:
                    continue
                if MARK in readings:
                    return sensor
        raise ConfigError(
            "sensor",
            None,
            "the machine has no calibration sensor; add one of the model devrel:so101:calibration"
            " with the arm's port",
        )

    def _on_loss(self, problem: str) -> None:
        """Do nothing: ``connection`` has the reason."""
