"""The calibration sensor of a machine that has no arm yet.

``MachineRig`` needs an arm. Before the motors have their ids no arm can be configured, so for that
long the connection is to the sensor alone.
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

_PERIOD = 1.0  # [s] between two questions whether the machine is there

MARK = "calibration_state"
"""What only a calibration sensor's readings hold."""


class MachineSensor(Machine):
    """A machine's calibration sensor. ``connect`` makes it; close it after use.

    Attributes:
        name: What the machine calls it.
    """

    def __init__(self, access: Access) -> None:
        super().__init__(access)
        self.name = ""
        self._link.open()

    @classmethod
    def connect(
        cls, address: str, *, api_key_id: str | None = None, api_key: str | None = None
    ) -> MachineSensor:
        """Connect to a machine; asks nothing of its motors.

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
                    told = await sensor.get_readings(timeout=PATIENCE)
                except GRPCError:
                    continue
                if MARK in told:
                    return sensor
        raise ConfigError(
            "sensor",
            None,
            "the machine has no calibration sensor; add one of the model devrel:so101:calibration"
            " with the arm's port",
        )

    def _on_loss(self, problem: str) -> None:
        """See ``Machine._on_loss``; ``connection`` tells it."""
