"""The calibration record: what the servos' ticks mean, and the file that keeps it.

The file is the published module's: an object by joint name with six whole numbers each, and it is
LeRobot's as well, which writes five of them (no ``norm_mode``). Programs in the field write it with
joints left out or null, so a record may lack joints; whoever uses it says what stands in for them.

Reading judges. The published module takes any numbers between 0 and 4095; here a file is refused
when it cannot describe this arm, and the message names the joint and what to do again. What is
refused is refused whole: half of a wrong file is no better than all of it.

Writing never loses anything: what the file already says of other joints stays, the new content is
written beside it and put in its place in one step, and what was there before is kept as ``.bak``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from so101_motion.drivers.registers import TICKS_PER_TURN
from so101_motion.errors import CalibrationError
from so101_motion.state import ARM_JOINTS, GRIPPER_JOINT

JOINTS = (*ARM_JOINTS, GRIPPER_JOINT)
"""Along the cable: joint ``JOINTS[i]`` is moved by servo ``i + 1``."""

FIELDS = ("id", "drive_mode", "homing_offset", "range_min", "range_max", "norm_mode")
"""What is said of each joint, in the order of the file."""

LARGEST_OFFSET = 2047
"""Largest homing offset that every firmware stores [tick]; register 31 has eleven bits for it."""

NARROWEST = 57
"""Narrowest range taken for a recorded travel [tick], 5 deg; less means the joint was not moved."""

WIDEST = 4000
"""Widest travel of a joint that has stops [tick]; the arm's own turn 2,340 at most. More means that
the sweep went across the encoder's seam. Only wrist_roll may be recorded as a whole turn."""

GRIPPER_TRAVEL = 1251
"""What the jaw travels [tick]: 110 deg, the joint limits of the robot description."""

_WIDEST_GRIPPER = 1.25 * GRIPPER_TRAVEL  # the published module's guard; real arms: up to 1.17
_AGAIN = "calibrate the arm again"


@dataclass(frozen=True, slots=True, kw_only=True)
class JointCalibration:
    """What is known of one joint's servo.

    Attributes:
        id: The servo's id.
        drive_mode: Not 0 if the servo counts down with the joint angle.
        homing_offset: What the servo subtracts from its encoder [tick].
        range_min: Smallest position of the travel [tick], as the servo reports it.
        range_max: Largest.
        norm_mode: How LeRobot-like programs scale it: 1 as 0..100, 2 as -100..100, 3 in degrees.
    """

    id: int
    drive_mode: int = 0
    homing_offset: int = 0
    range_min: int = 500
    range_max: int = 3500
    norm_mode: int = 3

    def to_json(self) -> dict[str, int]:
        """The six fields by name."""
        return {name: getattr(self, name) for name in FIELDS}


Calibration = Mapping[str, JointCalibration]
"""What is known of the joints, by name; joints may be missing."""


def default(joint: str) -> JointCalibration:
    """What to go by when nothing is known: the middle of the encoder, and a safe jaw."""
    servo_id = JOINTS.index(joint) + 1
    if joint == GRIPPER_JOINT:
        return JointCalibration(id=servo_id, range_min=2048, range_max=3248, norm_mode=1)
    return JointCalibration(id=servo_id)


def from_registers(
    joint: str, servo_id: int, *, homing_offset: int, range_min: int, range_max: int
) -> tuple[JointCalibration, str | None]:
    """What a servo's own registers say, and what is odd about it.

    A jaw whose limits are much wider than a jaw travels has never been calibrated; to drive it to
    such a limit would press it against its stop for good. It gets the default instead.

    Returns:
        The calibration, and a sentence about it that a person should read, or None.
    """
    found = replace(
        default(joint),
        id=servo_id,
        homing_offset=homing_offset,
        range_min=range_min,
        range_max=range_max,
    )
    if not 0 <= range_min < range_max < TICKS_PER_TURN:
        return (
            replace(default(joint), id=servo_id),
            f"{joint}: the limits in the servo ({range_min} to {range_max}) make no sense,"
            f" so defaults are used; {_AGAIN}",
        )
    width = range_max - range_min
    if joint == GRIPPER_JOINT and width > _WIDEST_GRIPPER:
        return (
            replace(default(joint), id=servo_id, homing_offset=homing_offset),
            f"{joint}: the limits in the servo ({range_min} to {range_max}) are wider than the jaw"
            f" travels, so a narrower default is used; {_AGAIN}",
        )
    if joint in _STOPPED and width > WIDEST:
        return found, f"{joint}: its servo looks as new, so zero is only a guess; {_AGAIN}"
    return found, None


_STOPPED = tuple(joint for joint in JOINTS if joint != "wrist_roll")


# Reading


def resolve(path: str) -> Path:
    """Where a calibration file is: a relative path lies in the module's data directory.

    viam-server names that directory in ``VIAM_MODULE_DATA``; without it (from the command line) a
    relative path means what it always means. Resolve once and keep the answer.
    """
    given = Path(path).expanduser()
    return (Path(os.environ.get("VIAM_MODULE_DATA") or ".") / given).resolve()


def read(path: Path) -> dict[str, JointCalibration]:
    """The calibration in a file; joints it does not mention are missing.

    Raises:
        CalibrationError: There is no such file, or what it says cannot be true of this arm.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        reason = f"{path} cannot be read: {error.strerror or error}"
        raise CalibrationError(None, reason, "check calibration_file") from error
    except ValueError as error:
        reason = f"{path} is not JSON: {error}"
        raise CalibrationError(None, reason, f"{_AGAIN}, or restore the file") from error
    try:
        return parse(content)
    except CalibrationError as error:
        raise CalibrationError(
            error.joint, f"{error.reason} (in {path})", error.next_step
        ) from error


def parse(content: object) -> dict[str, JointCalibration]:
    """The calibration in what a file holds.

    Raises:
        CalibrationError: It cannot be true of this arm.
    """
    if not isinstance(content, Mapping):
        raise CalibrationError(None, "a calibration is an object with a joint each", _AGAIN)
    if "motor_names" in content and "start_pos" in content:
        raise CalibrationError(
            None,
            "this is a LeRobot calibration of before June 2025, which meant other zeros",
            _AGAIN,
        )
    found = {
        joint: _joint(joint, content[joint])
        for joint in JOINTS
        if content.get(joint) is not None  # null: the published module's mark of a lost joint
    }
    if not found:
        raise CalibrationError(
            None, "no joint of this arm in it: " + ", ".join(JOINTS), "check calibration_file"
        )
    return found


def _joint(joint: str, entry: object) -> JointCalibration:
    if not isinstance(entry, Mapping):
        raise CalibrationError(joint, f"must be an object, not {entry!r}", _AGAIN)
    numbers = {name: _whole(joint, name, entry[name]) for name in FIELDS if name in entry}
    missing = [name for name in FIELDS[:5] if name not in numbers]
    if missing:
        raise CalibrationError(joint, f"{', '.join(missing)} missing", _AGAIN)
    if not numbers.get("norm_mode"):
        numbers["norm_mode"] = default(joint).norm_mode
    found = JointCalibration(**numbers)
    problem = _problem(joint, found)
    if problem is not None:
        raise CalibrationError(joint, *problem)
    return found


def _whole(joint: str, name: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value != int(value):
        raise CalibrationError(joint, f"{name} must be a whole number, not {value!r}", _AGAIN)
    return int(value)


def _problem(joint: str, found: JointCalibration) -> tuple[str, str] | None:
    """What is wrong and what to do, or None."""
    lower, upper = found.range_min, found.range_max
    place = JOINTS.index(joint) + 1
    if found.id != place:
        swapped = JOINTS[found.id - 1] if 1 <= found.id <= len(JOINTS) else "no joint"
        return (
            f"is servo {place} of this arm, but the record says {found.id} (that is {swapped})",
            "check that the file belongs to this arm",
        )
    if found.drive_mode not in (0, 1):
        return f"drive_mode is 0 or 1, not {found.drive_mode}", _AGAIN
    if abs(found.homing_offset) > LARGEST_OFFSET:
        return (
            f"homing_offset {found.homing_offset} is more than a servo stores ({LARGEST_OFFSET})",
            "hold the joint nearer to the middle of its travel and calibrate again",
        )
    if not 0 <= lower < upper < TICKS_PER_TURN:
        return f"range {lower} to {upper} is not within 0 to {TICKS_PER_TURN - 1}", _AGAIN
    if upper - lower < NARROWEST:
        return (
            f"range {lower} to {upper} is only {(upper - lower) * 360 / TICKS_PER_TURN:.1f} deg",
            "calibrate again and move this joint from stop to stop",
        )
    if joint in _STOPPED and upper - lower > WIDEST:
        return (
            f"range {lower} to {upper} is more than the joint can turn, so its encoder went past"
            " the end of its scale while it was recorded",
            "calibrate again with the joint held in the middle of its travel first",
        )
    if not 0 <= found.norm_mode <= 3:
        return f"norm_mode is 0 to 3, not {found.norm_mode}", _AGAIN
    return None


# Writing


def save(path: Path, calibration: Calibration) -> None:
    """Put ``calibration`` into the file at ``path``, beside what it says of other joints.

    A crash at any instant leaves the old file or the new one. What was there is kept under the
    same name with ``.bak`` behind it; what cannot be understood is replaced, and kept as well.

    Raises:
        CalibrationError: It cannot be written, or ``calibration`` cannot be true of this arm.
    """
    for joint, entry in calibration.items():
        _joint(joint, entry.to_json())
    content = {**_known(path), **calibration}
    ordered = {joint: content[joint].to_json() for joint in JOINTS if joint in content}
    text = json.dumps(ordered, indent=2) + "\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and path.read_text(encoding="utf-8", errors="replace") != text:
            _replace(path.with_name(path.name + ".bak"), path.read_bytes())
        _replace(path, text.encode())
    except OSError as error:
        reason = f"{path} cannot be written: {error.strerror or error}"
        raise CalibrationError(None, reason, "check the path and its permissions") from error


def _known(path: Path) -> dict[str, JointCalibration]:
    try:
        return read(path)
    except CalibrationError:
        return {}


def _replace(path: Path, data: bytes) -> None:
    """Let ``path`` hold ``data``, in one step and for good."""
    beside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(beside, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)  # the new name must survive a power cut as well
    finally:
        os.close(folder)
