"""An arm as LeRobot's commands use it, on emulated servos and simulated time."""

import dataclasses
import importlib.util
import sys
from concurrent.futures import wait
from contextlib import closing
from pathlib import Path

import numpy as np

from harness.emulated_pair import FOLLOWING
from harness.emulated_rig import HardwareBench
from so101_motion.common.errors import MotionError

TESTS = Path(__file__).parents[1]

sys.path.insert(0, str(TESTS.parent))  # where the plugin lies
if importlib.util.find_spec("lerobot") is None:
    sys.path.insert(0, str(TESTS / "recorded_types"))

from lerobot.cameras import Camera, CameraConfig  # noqa: E402

from lerobot_robot_so101_motion import (  # noqa: E402
    BiSO101Motion,
    BiSO101MotionConfig,
    SO101Motion,
    SO101MotionArmConfig,
    SO101MotionConfig,
    SO101MotionJog,
    SO101MotionJogConfig,
    SO101MotionLeader,
    SO101MotionLeaderConfig,
)

__all__ = [
    "BiSO101Motion",
    "BiSO101MotionConfig",
    "SO101MotionArmConfig",
    "SO101MotionJog",
    "SO101MotionJogConfig",
    "SO101MotionLeader",
    "SO101MotionLeaderConfig",
]

READY = (0.0, -40.0, 40.0, 55.0, 0.0, 30.0)
"""Over the table, the jaw a little open; LeRobot's values."""


class LeRobotBench(HardwareBench):
    """The same servos, and robots on them; ``rig`` is the one opened last."""

    def __init__(self, folder, *, clock=None, **options):
        super().__init__(folder, clock=clock, **options)
        self.rig = None
        self._folder, self._robots = folder, []

    def _command_caps(self):
        return FOLLOWING

    def open_rig(self, settings):
        """Open a rig as a plugin does, on this clock."""
        names = [field.name for field in dataclasses.fields(settings)]
        known = {name: getattr(settings, name) for name in names}
        self.rig = self.open(**{**known, "timeout": 0.01})
        return self.rig

    def wait(self, future, seconds):
        """Let time pass until ``future`` is done; fits ``Waiter``."""
        end = self.clock.now() + seconds
        while not future.done():
            if self.clock.now() > end:
                raise MotionError(f"it did not come to an end within {seconds:g} s")
            wait([future], timeout=self.turn)
            self.advance(0.02)
        future.result()

    def robot(self, cls=SO101Motion, config=SO101MotionConfig, **settings):
        """A robot that is not connected yet."""
        settings = {"port": str(self.port), "id": "arm", "calibration_dir": self._folder} | settings
        robot = cls(config(**settings))
        robot.open_rig, robot.wait = self.open_rig, self.wait
        self._robots.append(robot)
        return robot

    def close(self):
        self.emulator.plug()
        for robot in self._robots:
            if robot.is_connected:
                robot.disconnect()
        super().close()

    def connected(self, *degrees, **settings):
        """A robot that has gone to these values, or to ``READY``."""
        robot = self.robot(**settings)
        robot.connect(calibrate=False)
        robot.send_action(action(*(degrees or READY)))
        self.advance(0.6)
        return robot


@CameraConfig.register_subclass("grey")
@dataclasses.dataclass
class GreyConfig(CameraConfig):
    """A camera whose pictures are grey."""


class Grey(Camera):
    """The camera of ``GreyConfig``, which LeRobot finds by its name."""

    def __init__(self, config):
        super().__init__(config)
        self.is_connected = False

    def connect(self, warmup=True):
        self.is_connected = True

    def disconnect(self):
        self.is_connected = False

    def read_latest(self, max_age_ms=500):
        return np.full((self.height, self.width, 3), 127, dtype=np.uint8)


def action(*values):
    names = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
    return {f"{name}.pos": value for name, value in zip(names, values, strict=True)}


def lerobot_bench(folder, **options):
    return closing(LeRobotBench(folder, **options))
