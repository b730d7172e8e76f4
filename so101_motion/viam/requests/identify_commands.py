"""Answer ``identify``: move the arm to measure its servos, or to weigh the load in its hand."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from so101_motion.calib.record import servo_file
from so101_motion.common.attributes import Attributes
from so101_motion.common.errors import CalibrationError, ConfigError, MotionError
from so101_motion.common.state import ARM_JOINTS
from so101_motion.planning.request import Search
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.viam.requests.await_motion import in_own_thread, rest, run_to_end
from so101_motion.viam.requests.commands import Command, Taking
from so101_motion.viam.requests.servo_commands import out_of_fault
from so101_motion.viam.surroundings.surroundings import Surroundings

if TYPE_CHECKING:
    from so101_motion.setup.identify import Identification, IdentificationOutline

_FLAGS = ("carrying", "check", "outline", "undo")


class IdentifyCommands:
    """Answers ``identify`` of one arm component. Lives in the event loop.

    Args:
        rig: The arm's rig.
        surroundings: The arm's surroundings; read once, before anything moves.
        logger: Gets a line for each joint that moves.

    Attributes:
        commands: The method for each ``command``.
    """

    def __init__(
        self, rig: HardwareRig, surroundings: Surroundings, logger: logging.Logger
    ) -> None:
        self._rig, self._surroundings, self._logger = rig, surroundings, logger
        self._is_under_way = False
        self.commands: Mapping[str, Command] = {
            "identify": Taking(self._identify, (*_FLAGS, "joints"))
        }

    async def _identify(self, given: Attributes) -> dict[str, Any]:
        from so101_motion.setup.identify import Identification

        carrying, check, outline, undo = (given.flag(name, False) for name in _FLAGS)
        joints = given.names("joints") or ARM_JOINTS
        for joint in joints:
            if joint not in ARM_JOINTS:
                raise ConfigError("joints", joint, f"must be some of {', '.join(ARM_JOINTS)}")
        if carrying and set(joints) != set(ARM_JOINTS):
            raise ConfigError("joints", list(joints), "must be all to weigh what the hand carries")
        if undo:
            return await self._undo()
        if self._is_under_way:
            raise MotionError("the arm is being identified already; wait for it, or stop the arm")
        self._is_under_way = True
        try:
            await out_of_fault(self._rig)
            scene = self._rig.arm.scene
            if self._surroundings.is_asked():
                scene = await self._surroundings.around(scene)
            identification = Identification(self._rig, joints, Search(scene=scene))
            planned = await run_to_end(identification.outline)
            plan_json = {"will_move": planned.sentence, "cannot_move": dict(planned.obstacles)}
            if outline:
                return {**plan_json, "duration_s": round(planned.duration, 1)}
            await self._moved(identification, planned)
            report = await run_to_end(
                partial(identification.report, hand_is_empty=not carrying, keeps=not check)
            )
            if report.file is not None:
                await run_to_end(self._rig.reload)
            return {**plan_json, **report.to_json()}
        finally:
            self._is_under_way = False

    async def _moved(self, identification: Identification, outline: IdentificationOutline) -> None:
        """Move as outlined; a cancelled wait brings the arm to rest first."""

        def progress(joint: str, share: float) -> None:
            self._logger.info("identifying %s, %.0f %% done", joint, 100.0 * share)

        moving = in_own_thread(partial(identification.move_and_record, outline, progress))
        try:
            await asyncio.shield(moving)
        except asyncio.CancelledError:
            identification.cancel()
            await rest(moving)
            raise

    async def _undo(self) -> dict[str, Any]:
        file = self._rig.settings.file
        if file is None:
            raise CalibrationError(
                None, "no calibration file is configured", 'set "calibration_file"'
            )
        kept = await run_to_end(partial(servo_file.restore, file))
        await run_to_end(self._rig.reload)
        return {"at": kept.at, "file": str(servo_file.servos_path(file))}
