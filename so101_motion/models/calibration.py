"""``devrel:so101:calibration``: a sensor that takes a kit of servos to a calibrated arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from viam.components.sensor import Sensor
from viam.proto.app.robot import ComponentConfig
from viam.proto.common import ResourceName
from viam.resource.base import ResourceBase
from viam.resource.types import Model

from so101_motion.calib import store
from so101_motion.calibrator import Calibrator
from so101_motion.hardware_config import CALIBRATION_FILE, CalibrationConfig
from so101_motion.models import convert
from so101_motion.models.awaiting import carried_out
from so101_motion.models.calibration_commands import CalibrationCommands
from so101_motion.models.calibration_readings import readings
from so101_motion.models.commands import answer
from so101_motion.models.convert import grpc_statuses
from so101_motion.rig import open_hardware
from so101_motion.servos import ServoSettings


class So101Calibration(Sensor):
    """Motor setup and calibration, told by readings and driven by commands.

    It shares the port with an arm and a gripper and needs neither. Until a command wants the bus,
    it only looks on.

    Args:
        name: The component's name.
        calibrator: Does the work; closed with the component.
    """

    MODEL: ClassVar = Model.from_string("devrel:so101:calibration")

    def __init__(self, name: str, calibrator: Calibrator) -> None:
        super().__init__(name)
        self._calibrator = calibrator
        self._commands = CalibrationCommands(calibrator).commands

    @classmethod
    def validate_config(cls, config: ComponentConfig) -> tuple[Sequence[str], Sequence[str]]:
        """Check the attributes; there are no dependencies.

        Raises:
            ConfigError: As it is, for the SDK makes an INVALID_ARGUMENT of its text.
        """
        CalibrationConfig.from_attributes(convert.from_struct(config.attributes))
        return [], []

    @classmethod
    def new(
        cls, config: ComponentConfig, dependencies: Mapping[ResourceName, ResourceBase]
    ) -> So101Calibration:
        """Build the component from its configuration; no servo need be there."""
        with grpc_statuses():
            wanted = CalibrationConfig.from_attributes(convert.from_struct(config.attributes))
            rig = open_hardware(_asked(wanted))
        try:
            sensor = cls(config.name, Calibrator(rig, wanted.joints))
        except BaseException:
            rig.close()
            raise
        for key in wanted.unused:
            sensor.logger.info("%s has no effect here", key)
        return sensor

    async def get_readings(self, **kwargs: Any) -> Mapping[str, Any]:
        """How far calibration and motor setup are, and where the joints are; never waits."""
        return convert.to_result(readings(self._calibrator.situation))

    async def do_command(self, command: Mapping[str, Any], **kwargs: Any) -> Mapping[str, Any]:
        """Carry out a step of the calibration or of the motor setup."""
        with grpc_statuses():
            result = await answer(command, self._commands)
        return convert.to_result(result)

    async def get_status(self, **kwargs: Any) -> Mapping[str, Any]:
        """The state of the calibration, and whether the port is there."""
        now = self._calibrator.situation
        return {
            "calibration_state": now.view.state.value,
            "motor_setup_in_progress": now.setup.in_progress,
            "calibration_file": str(now.calibration_file),
            "connected": now.is_connected,
        }

    async def close(self) -> None:
        """Put back what a calibration under way has changed, and give up the port."""
        await carried_out(self._calibrator.close)


def _asked(wanted: CalibrationConfig) -> ServoSettings:
    """What it asks of the port: no servo, so nothing but to agree about the calibration file."""
    connection = wanted.connection
    file = connection.calibration_file
    return ServoSettings(
        port=connection.port,
        baudrate=connection.baudrate,
        timeout=None,
        calibration_file=store.resolve(file) if file else None,
        fallback_file=store.resolve(CALIBRATION_FILE),
    )
