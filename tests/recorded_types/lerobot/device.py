"""The calibration file of a robot or teleoperator; LeRobot has this code in both classes."""

import json

from lerobot.motors import MotorCalibration
from lerobot.utils.constants import HF_LEROBOT_CALIBRATION


class Device:
    config_class: type
    name: str
    group: str

    def __init__(self, config):
        self.id = config.id
        folder = HF_LEROBOT_CALIBRATION / self.group / self.name
        self.calibration_dir = config.calibration_dir or folder
        self.calibration_dir.mkdir(parents=True, exist_ok=True)
        self.calibration_fpath = self.calibration_dir / f"{self.id}.json"
        self.calibration = {}
        if self.calibration_fpath.is_file():
            self._load_calibration()

    def __str__(self):
        return f"{self.id} {type(self).__name__}"

    def __enter__(self):
        self.connect()
        return self

    def __exit__(self, exc_type, exc_value, traceback):
        self.disconnect()

    def _load_calibration(self, fpath=None):
        content = json.loads((fpath or self.calibration_fpath).read_text())
        self.calibration = {joint: MotorCalibration(**entry) for joint, entry in content.items()}
