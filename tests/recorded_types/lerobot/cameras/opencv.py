"""A camera that sees a new shade thirty times a second; one named ``gone`` cannot be opened."""

import time
from dataclasses import dataclass

import numpy as np

from lerobot.cameras import Camera, CameraConfig

RATE = 30.0


@dataclass(kw_only=True)
class OpenCVCameraConfig(CameraConfig):
    index_or_path: object = None

    def __init__(self, index_or_path):
        super().__init__()
        self.index_or_path = index_or_path


class OpenCVCamera(Camera):
    def connect(self, warmup=True):
        if str(self._where) == "gone":
            raise ConnectionError(f"Failed to open OpenCVCamera({self._where}).")
        self.width, self.height, self._seen = 64, 48, {}

    def __init__(self, config):
        super().__init__(config)
        self._where = config.index_or_path

    def read_latest(self, max_age_ms=500):
        number = int(time.monotonic() * RATE)
        if number not in self._seen:
            picture = np.full((self.height, self.width, 3), number % 256, dtype=np.uint8)
            self._seen = {number: picture}
        return self._seen[number]

    def disconnect(self):
        self._seen = {}
