"""LeRobot's calibration files: where they are, how to write one, and how to read the old ones.

LeRobot has had two formats. Since June 2025 a file has an entry of five fields for each joint,
which are our first five, so ``record`` reads it as it is. LeRobot refuses further fields, so ours
are left out when a file is written for it. Folders were renamed in January 2026
(``so101_follower`` is now ``so_follower``).

Before, a file had parallel lists: ``motor_names``, ``homing_offset``, ``drive_mode``,
``start_pos``, ``end_pos``, ``calib_mode``. They describe two poses in which the joints were held:
first stretched out horizontally with the jaws closed (start), then each turned by a quarter turn
(end). For the arm, ``homing_offset`` makes the second pose 90 deg, and ``end_pos`` is negated where
``drive_mode`` is 1. So the zeros can be taken over, and the travels are the model's. The files do
not have the servos' own offsets; LeRobot's motor setup of that time set them to 0. Sources:
LeRobot's notes on backward compatibility; its issue 930 shows such a file.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path

from so101_motion.calib.record import record
from so101_motion.calib.record.record import JOINTS, Calibration, JointCalibration
from so101_motion.calib.record.zero import ROLL_UPRIGHT, STOPS, Zero, by_pose
from so101_motion.common.errors import CalibrationError, ConfigError, quoted
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_deg, to_rad
from so101_motion.drivers.bus.registers import TICKS_PER_TURN
from so101_motion.drivers.bus.ticks import TICKS_PER_RAD
from so101_motion.files import atomic

FIELDS = record.FIELDS[:5]  # LeRobot's fields of a joint; it refuses a file with more

FOLLOWERS = ("so_follower", "so101_follower", "so100_follower")
"""LeRobot's folders for the arms we drive, the newest first."""

MOBILE = ("lekiwi", "xlerobot")
"""Its folders for robots that carry such an arm; their names of joints have a prefix."""

LEADERS = ("so_leader", "so101_leader", "so100_leader")
"""LeRobot's folders for leader arms, the newest first."""

_QUARTER = TICKS_PER_TURN // 4
_LISTS = ("motor_names", "homing_offset", "drive_mode", "start_pos", "end_pos", "calib_mode")

STRETCHED = dict(
    zip(ARM_JOINTS, (0.0, math.pi / 2.0, -math.pi / 2.0, 0.0, ROLL_UPRIGHT), strict=True)
)
"""The model's angles of the pose that was zero before June 2025 [rad]."""

TURNED = dict(zip(JOINTS, (0, 1, 0, 0, 1, 0), strict=True))
"""The old ``drive_mode`` of a correctly built arm: 1 where angles count against the model's."""

_BY_HAND = to_rad(25.0)
"""How much the two poses may contradict each other [rad]; they were held by hand, and 10 deg is
common. Chosen."""
_MARGIN = to_rad(3.0)
"""How far inside the model's stops a travel that was never recorded ends [rad]. Chosen."""


# Where


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


# The format of today


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


# The format of before June 2025


def is_of_lists(content: object) -> bool:
    return isinstance(content, Mapping) and {"motor_names", "homing_offset"} <= content.keys()


def from_lists(
    content: object,
) -> tuple[dict[str, JointCalibration], dict[str, Zero], tuple[str, ...]]:
    """Read LeRobot's old format of lists: the calibration, the zeros, and notes for a person."""
    assert isinstance(content, Mapping)
    rows = _rows(content)
    calibration: dict[str, JointCalibration] = {}
    zeros: dict[str, Zero] = {}
    apart = 0.0
    for joint in (joint for joint in JOINTS if joint in rows):
        row = rows[joint]
        if row["drive_mode"] != TURNED[joint]:
            raise CalibrationError(
                joint,
                f"drive_mode {row['drive_mode']} means that its servo turns the other way than"
                " in an SO-101, or that the joint was held in another pose",
                "calibrate the arm again",
            )
        if joint == GRIPPER_JOINT:
            calibration[joint] = _entry(joint, row["start_pos"], row["end_pos"])
            continue
        apart = max(apart, _apart(joint, row))
        calibration[joint], zeros[joint] = _from_poses(joint, row)
    record.check(calibration)
    note = (
        "this is a LeRobot calibration from before June 2025: its zeros were taken over (its two"
        f" poses contradict each other by up to {to_deg(apart):.0f} deg), the travels are the"
        f" model's less {to_deg(_MARGIN):.0f} deg at each end, and the servos' own offsets are"
        " assumed to have been 0. Move carefully, and calibrate again when you can"
    )
    return calibration, zeros, (note,)


def _rows(content: Mapping[str, object]) -> dict[str, dict[str, int]]:
    names = _list(content, "motor_names", str)
    columns = {name: _list(content, name, int, len(names)) for name in _LISTS[1:5]}
    modes = _list(content, "calib_mode", str, len(names))
    rows = {}
    for place, joint in enumerate(names):
        if joint not in JOINTS:
            continue
        mode = "LINEAR" if joint == GRIPPER_JOINT else "DEGREE"
        if modes[place] != mode:
            raise CalibrationError(
                str(joint),
                f"calib_mode must be {mode}, not {quoted(modes[place])}",
                "check the path",
            )
        if joint in rows:
            raise CalibrationError(str(joint), "is in motor_names twice", "check the path")
        rows[str(joint)] = {name: int(str(column[place])) for name, column in columns.items()}
    if not rows:
        raise CalibrationError(None, "motor_names holds no joint of this arm", "check the path")
    return rows


def _list(
    content: Mapping[str, object], name: str, kind: type, count: int | None = None
) -> list[object]:
    value = content.get(name)
    what = "names" if kind is str else "whole numbers"
    if (
        not isinstance(value, list)
        or not all(isinstance(entry, kind) and not isinstance(entry, bool) for entry in value)
        or (kind is int and any(abs(entry) > 1_000_000 for entry in value))
    ):
        raise CalibrationError(
            None, f"{name} must be a list of {what}, not {quoted(value)}", "check the path"
        )
    if count is not None and len(value) != count:
        raise CalibrationError(
            None, f"{name} has {len(value)} entries, motor_names has {count}", "check the path"
        )
    return value


def _apart(joint: str, row: Mapping[str, int]) -> float:
    """How much the two poses contradict each other [rad]."""
    sign = -1 if row["drive_mode"] else 1
    if abs(row["homing_offset"] - (_QUARTER - row["end_pos"])) > 2:
        raise CalibrationError(
            joint,
            f"homing_offset {row['homing_offset']} and end_pos {row['end_pos']} do not belong"
            " together, so the file has been edited",
            "calibrate the arm again",
        )
    apart = abs(sign * row["start_pos"] + row["homing_offset"]) / TICKS_PER_RAD
    if apart > _BY_HAND:
        raise CalibrationError(
            joint,
            f"was not turned by 90 deg between the two poses: it is {to_deg(apart):.0f} deg off",
            "calibrate the arm again",
        )
    return apart


def _from_poses(joint: str, row: Mapping[str, int]) -> tuple[JointCalibration, Zero]:
    sign = -1 if row["drive_mode"] else 1
    lower, upper = STOPS[joint]
    stretched_ticks = -sign * row["homing_offset"]

    def ticks(angle: float) -> float:
        return stretched_ticks + (angle - STRETCHED[joint]) * TICKS_PER_RAD

    entry = _entry(joint, ticks(lower + _MARGIN), ticks(upper - _MARGIN))
    at = (stretched_ticks - entry.homing_offset) % TICKS_PER_TURN  # what the servo says there now
    return entry, by_pose(entry, at, angle=STRETCHED[joint])


def _entry(joint: str, first: float, last: float) -> JointCalibration:
    """The record of a travel that a servo without homing offset counts from ``first`` to ``last``.

    The homing offset is chosen such that the middle of the travel is in the middle of the scale.
    """
    middle = round((first + last) / 2.0)
    offset = max(middle % TICKS_PER_TURN - TICKS_PER_TURN // 2, -record.LARGEST_OFFSET)
    width = round(last - first)
    lower = (middle - offset) % TICKS_PER_TURN - width // 2
    return JointCalibration(
        id=record.SERVO_IDS[joint],
        homing_offset=offset,
        range_min=lower,
        range_max=lower + width,
        norm_mode=record.default(joint).norm_mode,
    )
