"""A connection to a running machine and its resources; ``rig.py`` adds an arm to it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Self

import viam.components.generic
import viam.services.discovery
import viam.services.generic
import viam.services.motion
import viam.services.worldstatestore  # noqa: F401  # importing registers the client classes
from grpclib import GRPCError, Status
from viam.components.camera import Camera
from viam.components.sensor import Sensor
from viam.errors import ViamError
from viam.media.video import CameraMimeType
from viam.robot.client import RobotClient

from so101_motion.common.attributes import suggest
from so101_motion.common.clock import MonotonicClock
from so101_motion.common.errors import ConfigError, MachineRefused
from so101_motion.common.public import Complete
from so101_motion.rig.protocols import ArmConnection
from so101_motion.viam.client.link import PATIENCE, Access, Link

ANSWERING = 60.0  # how long a command may take [s]; chosen: a calibration step waits for servos
LOOKING = 4.0  # how long a camera may take for a picture [s]; chosen

_PERIOD = 1.0  # [s] between two looks whether it answers

MARK = "calibration_state"  # a key that only a calibration sensor's readings have


@dataclass(frozen=True, slots=True, kw_only=True)
class Resource:
    """A resource of a machine; its ``api`` is type and subtype, such as ``"component:arm"``."""

    name: str
    api: str


class Machine(Complete):
    """A connection to a machine. ``connect`` makes it; close it after use."""

    def __init__(self, access: Access) -> None:
        self.clock = MonotonicClock()
        self.link = Link(access, self.clock, self._poll, self._on_loss)

    @classmethod
    def connect(
        cls, address: str, *, api_key_id: str | None = None, api_key: str | None = None
    ) -> Machine:
        """Connect to a machine; it needs no arm.

        Args:
            address: As on the machine's CONNECT page, or host and port.
            api_key_id: The id of an API key; without a key the connection is plain and direct.
            api_key: The key.

        Raises:
            MachineUnavailable: It cannot be reached.
        """
        machine = cls(Access(address=address, api_key_id=api_key_id, api_key=api_key))
        machine.link.open()
        return machine

    @property
    def connection(self) -> ArmConnection:
        return self.link.connection

    @property
    def resources(self) -> tuple[Resource, ...]:
        return tuple(
            Resource(name=each.name, api=f"{each.type}:{each.subtype}")
            for each in self.link.client().resource_names
        )

    def do_command(self, resource: str, command: Mapping[str, Any]) -> Mapping[str, Any]:
        """Send a DoCommand to a component or service by its name; returns the answer."""
        asked: Mapping[str, Any] = self._ask(
            resource,
            str(command.get("command", next(iter(command), ""))),
            lambda it: it.do_command(command, timeout=ANSWERING),
        )
        return asked

    def readings(self, sensor: str) -> Mapping[str, Any]:
        """Read a sensor, such as the calibration sensor."""
        wrong = ("sensor", "has no readings, so it is not a sensor")
        read: Mapping[str, Any] = self._ask(
            sensor, "readings", lambda it: it.get_readings(timeout=ANSWERING), Sensor, wrong
        )
        return read

    def calibration_sensor(self) -> str:
        """The name of the machine's calibration sensor; ``ConfigError`` without one."""
        for resource in self.resources:
            if resource.api == "component:sensor":
                with suppress(MachineRefused):
                    if MARK in self.readings(resource.name):
                        return resource.name
        raise ConfigError(
            "sensor",
            None,
            "the machine has no calibration sensor; add one of the model devrel:so101:calibration"
            " with the arm's port",
        )

    def picture(self, camera: str) -> bytes:
        """The newest picture of a camera, as JPEG or PNG; ``ConfigError`` if it sends neither."""
        wrong = ("camera", "is not a camera; name one of the machine's")
        seen: bytes = self._ask(camera, "picture", picture_of, Camera, wrong)
        return seen

    def _ask(
        self,
        name: str,
        what: str,
        call: Callable[[Any], Awaitable[Any]],
        kind: type = object,
        wrong: tuple[str, str] = ("", ""),
    ) -> Any:
        """What a resource answers to ``call``; it must be of a kind."""

        async def ask() -> Any:
            client = self._client_of(name)
            if not isinstance(client, kind):
                raise ConfigError(wrong[0], name, wrong[1])
            with self.link.asking(f"{name}: {what}"):
                return await call(client)

        return self.link.run(ask()).result()

    def close(self) -> None:
        self.link.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # The loop's thread

    async def _poll(self, client: RobotClient, connected: Callable[[], None]) -> None:
        while True:
            await is_there(client)
            connected()
            await asyncio.sleep(_PERIOD)

    def _on_loss(self, problem: str) -> None:
        """Note that the machine does not answer; ``connection`` has the reason."""

    def _client_of(self, name: str) -> Any:
        client = self.link.client()
        known = {each.name: each for each in client.resource_names}
        if name not in known:
            raise ConfigError("resource", name, f"is not on the machine; {suggest(name, known)}")
        found = known[name]
        get = client.get_component if found.type == "component" else client.get_service
        try:
            return get(found)
        except ViamError as error:
            raise ConfigError(
                "resource", name, f"is a {found.subtype}, which Viam's SDK here does not know"
            ) from error


async def picture_of(camera: Camera) -> bytes:
    images, _ = await camera.get_images(timeout=LOOKING)
    for image in images:
        if image.mime_type in (CameraMimeType.JPEG, CameraMimeType.PNG):
            return image.data
    raise ConfigError("camera", camera.name, "sends neither JPEG nor PNG")


async def is_there(client: RobotClient) -> None:
    """Raise one of ``LOSSES`` if the machine itself does not answer."""
    try:
        async with asyncio.timeout(PATIENCE):
            await client.get_version()
    except GRPCError as error:
        if error.status is not Status.UNIMPLEMENTED:
            raise ConnectionError(error.message or error.status.name) from error
