from dataclasses import dataclass
from pathlib import Path

from lerobot.choices import Choices
from lerobot.device import Device


@dataclass(kw_only=True)
class TeleoperatorConfig(Choices):
    _names = {}  # noqa: RUF012  # no field
    id: str | None = None
    calibration_dir: Path | None = None


class Teleoperator(Device):
    group = "teleoperators"
