"""A camera that sees a grey ramp, for ``--robot.cameras="{front: {type: fake, ...}}"``."""

from dataclasses import dataclass

import numpy as np
from lerobot.cameras import Camera, CameraConfig


@CameraConfig.register_subclass("fake")
@dataclass
class FakeCameraConfig(CameraConfig):
    pass


class FakeCamera(Camera):
    def __init__(self, config):
        super().__init__(config)
        self._is_connected, self._seen = False, 0

    @property
    def is_connected(self):
        return self._is_connected

    @staticmethod
    def find_cameras():
        return []

    def connect(self, warmup=True):
        self._is_connected = True

    def read(self):
        self._seen += 1
        return np.full((self.height, self.width, 3), self._seen % 256, dtype=np.uint8)

    def async_read(self, timeout_ms=200):
        return self.read()

    def read_latest(self, max_age_ms=500):
        return self.read()

    def disconnect(self):
        self._is_connected = False
