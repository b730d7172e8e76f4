"""The jaw of a running machine."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from viam.components.gripper import Gripper

from so101_motion.arm.gripper import JAW_CLOSED, JAW_OPEN
from so101_motion.arm.motion_handle import Motion
from so101_motion.common.attributes import checked_number
from so101_motion.common.errors import ConfigError
from so101_motion.viam.client.executor import STOPPING
from so101_motion.viam.client.link import Link
from so101_motion.viam.client.reports import GripperReport
from so101_motion.viam.client.runner import MotionRunner

_LOOK = 0.05
"""How often to ask whether the jaw has arrived, if its command did not wait [s]; chosen."""


class MachineGripper(MotionRunner):
    """Opens and closes the jaw. A new motion takes over from the one under way.

    Args:
        link: The connection to the machine.
        find: Returns the gripper's client; raises ``MachineUnavailable`` or ``ConfigError`` without
            one.
        newest_report: Returns its last report.
        look: Updates that.
    """

    def __init__(
        self,
        link: Link,
        find: Callable[[], Gripper],
        newest_report: Callable[[], GripperReport],
        look: Callable[[], Awaitable[None]],
    ) -> None:
        super().__init__(link, look)
        self._find, self._newest_report = find, newest_report

    @property
    def q_jaw(self) -> float:
        """Measured jaw angle [rad], taken from the aperture over the jaw's full travel."""
        return self.angle_of(self.aperture)

    @property
    def aperture(self) -> float:
        """How far it is open: 0 closed, 1 open."""
        return self._newest_report().aperture

    @property
    def is_moving(self) -> bool:
        """Whether the jaw is moving."""
        return self._newest_report().is_moving

    @property
    def is_holding(self) -> bool:
        """Whether it holds something, as far as it reports that."""
        return self._newest_report().is_holding

    def angle_of(self, aperture: float) -> float:
        """The jaw angle [rad] that an aperture stands for, over the jaw's full travel."""
        return JAW_CLOSED + aperture * (JAW_OPEN - JAW_CLOSED)

    def move(self, aperture: float, *, wait: bool = True) -> Motion:
        """Open or close to ``aperture``.

        Raises:
            ConfigError: Outside 0 to 1.
        """
        checked_number("aperture", aperture, lower=0.0, upper=1.0)
        return self._send({"command": "set_position", "percentage": 100.0 * aperture}, wait)

    def grab(self, aperture: float = 0.0, *, wait: bool = True) -> Motion:
        """Close until something is gripped or the jaw is closed; ``is_holding`` tells which.

        Args:
            aperture: Ignored, because the machine decides itself what counts as closed.
            wait: As for ``move``.
        """
        return self._send(None, wait)

    def stop(self) -> None:
        """Slow to rest; returns when the jaw is at rest. The arm is left alone."""
        self.bring_to_rest("stop").result()

    def _send(self, command: Mapping[str, Any] | None, wait: bool) -> Motion:
        """Send ``command``, or a grab; the motion ends when the jaw rests."""

        async def move() -> None:
            gripper = self._find()
            with self._link.asking("moving the jaw"):
                if command is None:
                    await gripper.grab()
                else:
                    await gripper.do_command(command)
                await _rest(gripper)

        motion = Motion()
        running = motion.begin(lambda: self.begin(move), self.interrupt)
        running.add_done_callback(motion.take_outcome)
        if wait:
            motion.result()
        return motion

    async def _brake(self) -> None:
        try:
            gripper = self._find()
        except ConfigError:
            return  # there is none, or none was chosen of several
        with self._link.asking("stop"):
            await gripper.stop(timeout=STOPPING)


async def _rest(gripper: Gripper) -> None:
    """Wait until a jaw rests; the command that moves it need not wait for that."""
    while True:
        if not await gripper.is_moving():
            return
        await asyncio.sleep(_LOOK)
