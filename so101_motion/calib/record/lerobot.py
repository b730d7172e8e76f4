"""LeRobot's calibration files: where they are, and how to write one.

Since June 2025 a file has an entry of five fields for each joint, which are our first five, so
``record`` reads it as it is. LeRobot refuses further fields, so ours are left out when a file is
written for it. Folders were renamed in January 2026 (``so101_follower`` is now ``so_follower``).
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

from so101_motion.calib.record import record
from so101_motion.calib.record.record import JOINTS, Calibration
from so101_motion.calib.record.zero import ROLL_UPRIGHT
from so101_motion.common.errors import CalibrationError, ConfigError
from so101_motion.common.state import ARM_JOINTS
from so101_motion.files import atomic

FIELDS = record.FIELDS[:5]  # LeRobot's fields of a joint; it refuses a file with more

FOLLOWERS = ("so_follower", "so101_follower", "so100_follower")
"""LeRobot's folders for the arms we drive, the newest first."""

MOBILE = ("lekiwi", "xlerobot")
"""Its folders for robots that carry such an arm; their names of joints have a prefix."""

LEADERS = ("so_leader", "so101_leader", "so100_leader")
"""LeRobot's folders for leader arms, the newest first."""

STRETCHED = dict(
    zip(ARM_JOINTS, (0.0, math.pi / 2.0, -math.pi / 2.0, 0.0, ROLL_UPRIGHT), strict=True)
)
"""The model's angles of the pose that was zero before June 2025 [rad]."""

TURNED = dict(zip(JOINTS, (0, 1, 0, 0, 1, 0), strict=True))
"""1 where the angles of that time count against the model's."""


def folder() -> Path:
    """LeRobot's folder of calibrations for this user, by LeRobot's environment variables."""
    named = os.environ.get
    if named("HF_LEROBOT_CALIBRATION"):
        return Path(os.environ["HF_LEROBOT_CALIBRATION"]).expanduser()
    if named("HF_LEROBOT_HOME"):
        return Path(os.environ["HF_LEROBOT_HOME"]).expanduser() / "calibration"
    if named("HF_HOME"):
        return Path(os.environ["HF_HOME"]).expanduser() / "lerobot" / "calibration"
    cache = Path(named("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return cache / "huggingface" / "lerobot" / "calibration"


def path_for(robot_id: str, *, kind: str = "") -> Path:
    """The path at which LeRobot looks for the calibration of the arm ``robot_id``.

    Args:
        robot_id: As in LeRobot's ``--robot.id``.
        kind: One of ``FOLLOWERS`` or ``LEADERS``; if empty, the follower's folder that exists, or
            the newest name for it.

    Raises:
        ConfigError: ``robot_id`` cannot be a file name, or there is no such kind.
    """
    if not robot_id or robot_id in (".", "..") or any(c in robot_id for c in "/\\\0"):
        raise ConfigError("robot_id", robot_id, "must be a plain name, as in LeRobot's --robot.id")
    if kind and kind not in FOLLOWERS + LEADERS:
        raise ConfigError("kind", kind, f"must be one of {', '.join(FOLLOWERS + LEADERS)}")
    base = folder()
    if not kind:
        there = [name for name in FOLLOWERS if (base / "robots" / name).is_dir()]
        kind = (there or FOLLOWERS)[0]
    group = "teleoperators" if kind in LEADERS else "robots"
    return base / group / kind / f"{robot_id}.json"


def text(calibration: Calibration) -> bytes:
    """The text of a file for LeRobot, which would ask for a new calibration without all joints."""
    missing = [joint for joint in JOINTS if joint not in calibration]
    if missing:
        raise CalibrationError(
            missing[0],
            f"LeRobot needs all six joints, and {', '.join(missing)} is not calibrated",
            "calibrate it first",
        )
    record.check(calibration)
    content = {
        joint: {name: getattr(calibration[joint], name) for name in FIELDS} for joint in JOINTS
    }
    return json.dumps(content, indent=4).encode() + b"\n"


def export(calibration: Calibration, path: Path) -> None:
    """Write a calibration file for LeRobot to ``path``; an older file is kept as ``.bak``."""
    data = text(calibration)
    with record.writing(path), atomic.locked(path.parent):
        if path.exists() and path.read_bytes() != data:
            atomic.write(path.with_name(path.name + ".bak"), path.read_bytes())
        atomic.write(path, data)
