from dataclasses import dataclass

from lerobot.choices import Choices


@dataclass(kw_only=True)
class CameraConfig(Choices):
    _names = {}  # noqa: RUF012  # no field
    fps: int | None = None
    width: int | None = None
    height: int | None = None


class Camera:
    def __init__(self, config):
        self.fps, self.width, self.height = config.fps, config.width, config.height
