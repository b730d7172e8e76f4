"""A joint's zero: the model's angle at the middle of its recorded travel.

A calibration record has the ticks between which a joint travels, but nothing about the model.
LeRobot, and the published module up to 0.9.0-rc2, take the middle of the travel as zero. But the
arm's stops are not symmetric about the model's zero, so that is up to six degrees off, at the
elbow, and with all joints together some 40 mm at the jaws. Here every convention is one number, the
model's angle at the middle of the recorded travel, and its source:

* ``middle``: nothing more is known, so the middle is zero, as for those;
* ``stops``: the joint was moved from stop to stop, and the model has the angles of its stops;
* ``pose``: the servo's position in a known pose is known (wrist_roll, whose stops are two nubs that
  give way);
* ``homing``: the pose at ``set_homing`` is zero, tick ``HOMING_TICK``, as for the published module
  since its versions after 0.9.0-rc2. Its files do not say which was meant, so ``joint_zero`` does;
* ``configured``: ``joint_zero_offsets_deg`` sets it. That overrides the others.

The middle is the reference because errors of a recording are small there: when a joint stops short
of one stop, only half of what is missing counts. This is about the five joints of the arm; the
jaw's zero is where it is closed (``joint_setup.joint_map``).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import so101_description

from so101_motion.calib.record.record import JOINTS, Calibration, JointCalibration
from so101_motion.common.attributes import checked_number
from so101_motion.common.encoder_zeros import EncoderZero
from so101_motion.common.errors import CalibrationError, ConfigError, quoted
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_deg, to_rad
from so101_motion.drivers.bus.registers import TICKS_PER_TURN
from so101_motion.drivers.bus.ticks import RAD_PER_TICK, TICKS_PER_RAD
from so101_motion.files import json_file

STOPS: Mapping[str, tuple[float, float]] = (
    so101_description.ROBOT.stops or so101_description.ROBOT.limits
)
"""The model's angles at the mechanical stops [rad], or its limits where the robot file has none. Of
five public calibrations of an SO-101, the travels of pan, lift, elbow and wrist agree within 4 deg,
except for two recordings that went wrong. Cable clips and screw heads are not in the solids: allow
for 1.5 deg."""

ROLL_UPRIGHT: float = so101_description.ROBOT.roll_upright
"""The model's wrist_roll with the jaws upright [rad]: how the robot description mounts the gripper.
Ask the user to hold it upright: that can be seen, while an angle of 2.8 deg cannot."""

_SHORT, _LONG = to_rad(4.0), to_rad(5.0)
"""How much less or more than the model's a travel from stop to stop may be [rad]: public
calibrations have 2.4 deg less to 3.8 deg more. Chosen."""

SWEPT = ARM_JOINTS[:4]  # the joints whose zero comes from their stops


@dataclass(frozen=True, slots=True, kw_only=True)
class Zero:
    """The angle at the middle of a joint's recorded travel, and how it is known."""

    by: str  # ``"middle"``, ``"stops"``, ``"pose"``, ``"homing"`` or ``"configured"``
    angle: float  # the model's angle at the middle of the recorded travel [rad]


MIDDLE = Zero(by="middle", angle=0.0)
"""The zero of LeRobot and of the published module up to 0.9.0-rc2; used where nothing is known."""

CONVENTIONS = ("middle", "homing")
"""What ``joint_zero`` may be: the zero of joints of which nothing better is known."""

HOMING_TICK = 2047
"""The position that a servo reports in the pose of the published module's ``set_homing`` [tick]."""

_TOLD = to_rad(1.0)  # a difference between the conventions from which it is told [rad]. Chosen


def expected_travel(joint: str) -> float:
    """The travel of ``joint``, the jaw too, from stop to stop by the model [tick]."""
    lower, upper = STOPS[joint]
    return (upper - lower) * TICKS_PER_RAD


def by_stops(joint: str, entry: JointCalibration) -> Zero | None:
    """The zero of a joint that was swept from stop to stop.

    Returns:
        None when the recorded travel differs from the model's, so that it was not from stop to
        stop, when the zero of ``joint`` does not come from stops (wrist_roll, gripper), or when the
        stops are not known.
    """
    if joint not in SWEPT or not so101_description.ROBOT.stops:
        return None
    lower, upper = STOPS[joint]
    if not -_SHORT <= excess(joint, entry) <= _LONG:
        return None
    return Zero(by="stops", angle=(lower + upper) / 2.0)


def excess(joint: str, entry: JointCalibration) -> float:
    """How much longer the recorded travel is than the model's from stop to stop [rad]."""
    lower, upper = STOPS[joint]
    return (entry.range_max - entry.range_min) * RAD_PER_TICK - (upper - lower)


def by_pose(entry: JointCalibration, ticks: float, *, angle: float) -> Zero:
    """The zero of a joint that stood at ``angle`` [rad] when its servo reported ``ticks``.

    For wrist_roll, ask for the jaws upright and give ``angle=ROLL_UPRIGHT``.
    """
    beyond = _direction(entry) * (_middle(entry) - ticks) * RAD_PER_TICK
    return Zero(by="pose", angle=angle + beyond)


def by_convention(entry: JointCalibration, convention: str | None) -> Zero:
    """The zero of a joint of which nothing is known, by one of ``CONVENTIONS``; None: the first."""
    if convention != "homing":
        return MIDDLE
    return replace(by_pose(entry, HOMING_TICK, angle=0.0), by="homing")


def about_homing(calibration: Calibration, zeros: Mapping[str, Zero]) -> str:
    """Say where the published module's old and new zero differ; empty if they do not."""
    differing = [
        f"{joint} {to_deg(beyond):+.1f} deg"
        for joint in ARM_JOINTS
        if joint in calibration and joint not in zeros
        and abs(beyond := by_convention(calibration[joint], "homing").angle) >= _TOLD
    ]  # fmt: skip
    if not differing:
        return ""
    return (
        "zero is taken to be the middle of each joint's travel; a machine with devrel:so101-arm"
        " later than 0.9.0-rc2 counts from the pose of set_homing, and the file does not tell which"
        f' ("joint_zero": "homing" would add {", ".join(differing)})'
    )


def in_force(
    stored: Zero | None, configured: float | None, entry: JointCalibration, convention: str | None
) -> Zero:
    """The zero to use: the configured one [rad], else the stored one, else the convention's."""
    if configured is not None:
        return Zero(by="configured", angle=configured)
    return stored or by_convention(entry, convention)


def zero_ticks(entry: JointCalibration, zero: Zero) -> float:
    """The servo position at the model's angle zero [tick]; may lie between two."""
    return _middle(entry) - _direction(entry) * zero.angle * TICKS_PER_RAD


def _middle(entry: JointCalibration) -> float:
    return (entry.range_min + entry.range_max) / 2.0


def _direction(entry: JointCalibration) -> int:
    return -1 if entry.drive_mode else 1


def encoder_zeros(calibration: Calibration, zeros: Mapping[str, Zero]) -> dict[str, EncoderZero]:
    """The encoder position of each joint's zero; without an entry in ``zeros`` it is the middle.

    A servo subtracts its homing offset from its encoder, and a calibration says which of the
    resulting ticks is the zero. Only their sum matters: two calibrations with the same sums give
    the same angles, however they were recorded. Limits alone change no angle.
    """
    found = {}
    for joint in JOINTS:
        if joint not in calibration:
            continue
        entry = calibration[joint]
        if joint == GRIPPER_JOINT:
            at_zero: float = entry.range_max if entry.drive_mode else entry.range_min
        else:
            at_zero = zero_ticks(entry, zeros.get(joint, MIDDLE))
        found[joint] = EncoderZero(
            direction=-1 if entry.drive_mode else 1,
            ticks=round((at_zero + entry.homing_offset) % TICKS_PER_TURN, 1) % TICKS_PER_TURN,
        )
    return found


# The file beside a calibration, ``arm.zero.json``. Zeros are not in the calibration itself, because
# other programs use that file as well: LeRobot refuses further fields, and the published module
# drops them when it saves. So each entry here repeats the numbers of the record that it belongs to.
# If any program has changed those since, the entry is ignored, and a note says so. While a
# calibration is being saved a joint has two entries, for the old record and for the new, so that
# after a crash either record has its own zero.

_SAME = ("drive_mode", "homing_offset", "range_min", "range_max")
"""An entry belongs to the record that has the same values of these."""

_SOURCES = ("stops", "pose", *CONVENTIONS)


def read_zeros(path: Path, calibration: Calibration) -> tuple[dict[str, Zero], tuple[str, ...]]:
    """Read the zeros of ``calibration`` from the file at ``path``, with notes on problems.

    Without a file there are none. With a file that cannot be read there are none either, and a note
    says so: the joints then have their zero in the middle, as with a file of another program.
    """
    if not path.exists():
        return {}, ()
    try:
        content = json_file.read(path)
        entries = content.get("joints") if isinstance(content, Mapping) else None
        if not isinstance(entries, Mapping):
            raise CalibrationError(None, f'{path} holds no "joints"', "calibrate again")
        zeros = {
            joint: found
            for joint, entry in calibration.items()
            if joint in entries and (found := _zero(joint, entry, entries[joint])) is not None
        }
    except CalibrationError as error:
        return {}, (f"zero is the middle of each travel, because zeros cannot be read: {error}",)
    stale = [joint for joint in calibration if entries.get(joint) and joint not in zeros]
    if not stale:
        return zeros, ()
    return zeros, (
        f"{', '.join(stale)}: another program has calibrated since {path.name} was written, so zero"
        " is the middle of the travel again",
    )


def zeros_text(*sides: tuple[Calibration, Mapping[str, Zero]]) -> bytes:
    joints: dict[str, list[dict[str, object]]] = {}
    for calibration, zeros in sides:
        for joint in JOINTS:
            if joint not in zeros or joint not in calibration:
                continue
            entry = {
                **{name: getattr(calibration[joint], name) for name in _SAME},
                "by": zeros[joint].by,
                "middle_deg": round(to_deg(zeros[joint].angle), 4),
            }
            known = joints.setdefault(joint, [])
            if entry not in known:
                known.append(entry)
    if not joints:
        return b""
    about = "the model's angle at the middle of the recorded travel, for records with these numbers"
    return json.dumps({"about": about, "joints": joints}, indent=2).encode() + b"\n"


def _zero(joint: str, record: JointCalibration, entries: object) -> Zero | None:
    if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
        raise CalibrationError(joint, "its zeros must be a list of objects", "calibrate again")
    for entry in reversed(entries):  # the last was written last
        if all(entry.get(name) == getattr(record, name) for name in _SAME):
            return _checked(joint, entry)
    return None


def _checked(joint: str, entry: Mapping[str, object]) -> Zero:
    by = entry.get("by")
    if by not in _SOURCES:
        raise CalibrationError(
            joint, f'"by" is {" or ".join(_SOURCES)}, not {quoted(by)}', "calibrate again"
        )
    try:
        middle_deg = checked_number(
            "middle_deg", entry.get("middle_deg"), lower=-180.0, upper=180.0
        )
    except ConfigError as error:
        raise CalibrationError(joint, str(error), "calibrate again") from error
    return Zero(by=str(by), angle=to_rad(middle_deg))
