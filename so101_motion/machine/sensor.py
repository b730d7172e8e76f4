"""The calibration sensor of a machine that has no arm yet: a kit out of the box.

``MachineRig`` has an arm or is not. Before the motors have their ids no arm can be configured, so
for that long this is the connection: to the sensor alone.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, TypeVar

from grpclib import GRPCError
from viam.components.sensor import Sensor
from viam.robot.client import RobotClient

from so101_motion.clock import MonotonicClock
from so101_motion.errors import ConfigError
from so101_motion.machine.link import PATIENCE, Access, Link
from so101_motion.rig_like import Connection

T = TypeVar("T")

STEP = 60.0
"""How long a step of the setup may take [s]; chosen: it waits for motors."""

_PERIOD = 1.0  # [s] between two questions whether the machine is there

MARK = "calibration_state"
"""What only a calibration sensor's readings hold."""


class MachineSensor:
    """A machine's calibration sensor. ``connect`` makes it; close it after use.

    Attributes:
        name: What the machine calls it.
    """

    def __init__(self, access: Access) -> None:
        self.name = ""
        self._sensor: Sensor | None = None
        self._link = Link(access, MonotonicClock(), self._watch, self._lose)
        self._link.open()

    @classmethod
    def connect(
        cls, address: str, *, api_key_id: str | None = None, api_key: str | None = None
    ) -> MachineSensor:
        """Connect to a machine; nothing is asked of its motors.

        Args:
            address: As on the machine's CONNECT page, or host and port.
            api_key_id: The id of an API key; without a key the connection is plain and direct.
            api_key: The key.

        Raises:
            MachineUnavailable: It cannot be reached.
            ConfigError: It has no calibration sensor.
        """
        return cls(Access(address=address, api_key_id=api_key_id, api_key=api_key))

    @property
    def connection(self) -> Connection:
        """Whether the machine can be reached, and since when not."""
        return self._link.connection

    def do_command(self, command: Mapping[str, Any]) -> Mapping[str, Any]:
        """Send the sensor a DoCommand; its answer.

        Raises:
            MachineRefused: It refused.
            MachineUnavailable: It does not answer.
        """
        title = str(command.get("command", ""))
        return self._ask(title, lambda sensor: sensor.do_command(command, timeout=STEP))

    def readings(self) -> Mapping[str, Any]:
        """What it reads.

        Raises:
            MachineRefused: It refused.
            MachineUnavailable: It does not answer.
        """
        return self._ask("readings", lambda sensor: sensor.get_readings(timeout=STEP))

    def close(self) -> None:
        """Hang up. May be called twice."""
        self._link.close()

    # How

    def _ask(self, title: str, ask: Callable[[Sensor], Coroutine[Any, Any, T]]) -> T:
        async def send() -> T:
            self._link.client()
            assert self._sensor is not None  # it is there as long as the client is
            with self._link.asking(f"{self.name}: {title}"):
                return await ask(self._sensor)

        return self._link.run(send()).result()

    async def _watch(self, client: RobotClient, connected: Callable[[], None]) -> None:
        self._sensor = await self._found(client)
        self.name = self._sensor.name
        while True:
            connected()
            await asyncio.sleep(_PERIOD)
            async with asyncio.timeout(PATIENCE):
                await self._sensor.get_readings(timeout=PATIENCE)

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

    def _lose(self, _problem: str) -> None:
        self._sensor = None
