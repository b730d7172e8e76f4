from dataclasses import dataclass
from pathlib import Path

from lerobot.choices import Choices
from lerobot.device import Device


@dataclass(kw_only=True)
class RobotConfig(Choices):
    _names = {}  # noqa: RUF012  # no field
    id: str | None = None
    calibration_dir: Path | None = None


class Robot(Device):
    group = "robots"

    def __init__(self, config):
        self.robot_type = self.name
        super().__init__(config)
