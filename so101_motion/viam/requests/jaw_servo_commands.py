"""Answer the ``servo_…`` commands, which move the jaw through the arm component.

Later versions of the published module let programs move the jaw's servo through the arm when no
gripper is configured; the answers have the same keys. If a gripper component moves the same jaw,
the newer motion takes over.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from so101_motion.arm.motion_handle import Motion
from so101_motion.common.attributes import Attributes
from so101_motion.common.errors import ConfigError, MotionError
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.viam.requests.await_motion import log_failure_of
from so101_motion.viam.requests.commands import Command, Taking
from so101_motion.viam.requests.servo_commands import out_of_fault

_PATIENCE_MS = 3000.0
"""How long ``servo_wait_stop`` waits without ``timeout_ms`` [ms]; the published default."""

_LOOK = 0.02
"""Time between two checks while it waits [s]."""


class JawServoCommands:
    """Answers the ``servo_…`` commands."""

    def __init__(self, rig: HardwareRig, logger: logging.Logger) -> None:
        self._rig, self._logger = rig, logger
        self._latest: Motion | None = None
        self.commands: Mapping[str, Command] = {
            "servo_capabilities": self._capabilities,
            "servo_move": Taking(self._move, ("servo_id", "percent", "raw", "speed")),
            "servo_moving": Taking(self._moving, ("servo_id",)),
            "servo_position": Taking(self._position, ("servo_id",)),
            "servo_stop": Taking(self._stop, ("servo_id",)),
            "servo_wait_stop": Taking(self._wait_stop, ("servo_id", "timeout_ms")),
        }

    async def _capabilities(self) -> dict[str, Any]:
        return {"servo_commands": True, "servo_ids": [self._id] if self._is_there else []}

    async def _move(self, given: Attributes) -> dict[str, Any]:
        self._check_id(given)
        jaw = self._rig.gripper
        echo: dict[str, Any]
        if given.given("raw"):
            raw = given.required("raw", lower=0.0, upper=4095.0, unit="ticks")
            q = self._rig.servos.to_angle(GRIPPER_JOINT, round(raw))
            aperture, echo = (q - jaw.closed) / (jaw.opened - jaw.closed), {"raw": raw}
        else:
            percent = given.required("percent", unit="%")
            aperture, echo = percent / 100.0, {"percent": min(max(percent, 0.0), 100.0)}
        aperture = min(max(aperture, 0.0), 1.0)  # limited, as in the published module
        limits = jaw.limits
        if given.given("speed"):
            ticks = given.required("speed", lower=1.0, upper=4096.0, unit="ticks/s")
            asked = np.full(1, 2.0 * np.pi * ticks / 4096.0)
            limits = replace(limits, velocity=np.minimum(asked, limits.velocity))
        await out_of_fault(self._rig)
        # An object in the way of a closing jaw is gripped, not crushed.
        go = jaw.grab if aperture < jaw.aperture else jaw.move
        self._latest = go(aperture, limits=limits, wait=False)
        log_failure_of(self._latest, self._logger)
        return echo

    async def _moving(self, given: Attributes) -> dict[str, Any]:
        self._check_id(given)
        return {"moving": self._is_moving}

    async def _position(self, given: Attributes) -> dict[str, Any]:
        self._check_id(given)
        jaw = self._rig.gripper
        raw = self._rig.servos.to_ticks(GRIPPER_JOINT, jaw.q_jaw)
        return {"percent": round(100.0 * min(max(jaw.aperture, 0.0), 1.0), 3), "raw": raw}

    async def _stop(self, given: Attributes) -> dict[str, Any]:
        self._check_id(given)
        await asyncio.wrap_future(self._rig.gripper.start_stop())
        return {}

    async def _wait_stop(self, given: Attributes) -> dict[str, Any]:
        self._check_id(given)
        patience_ms = given.number("timeout_ms", _PATIENCE_MS, lower=0.0, upper=6e5, unit="ms")
        waited_ms = 0.0
        while self._is_moving:
            if waited_ms >= patience_ms:
                raise MotionError(
                    f"servo {self._id} still moves after {patience_ms:g} ms; raise timeout_ms, or"
                    " send servo_stop"
                )
            await asyncio.sleep(_LOOK)
            waited_ms += 1000.0 * _LOOK
        return {}

    @property
    def _is_moving(self) -> bool:
        begun = self._latest is not None and not self._latest.future.done()
        return begun or self._rig.gripper.is_moving

    @property
    def _id(self) -> int:
        return self._rig.settings.ids()[GRIPPER_JOINT]

    @property
    def _is_there(self) -> bool:
        return GRIPPER_JOINT in self._rig.servos.setups

    def _check_id(self, given: Attributes) -> None:
        asked = given.required("servo_id", lower=1.0, upper=6.0)
        if asked != self._id:
            raise ConfigError(
                "servo_id", asked, f"moves the arm, not the jaw; give {self._id}, the jaw's servo"
            )
        if not self._is_there:
            raise ConfigError(
                "servo_id",
                asked,
                "did not answer when the arm was opened; check its cable, then send reinitialize",
            )
