"""The calibration record: what the ticks of each joint's servo mean.

The record is the published module's: an object by joint name with six whole numbers each. It is
also LeRobot's, which writes five of them (no ``norm_mode``). Some programs leave joints out or
write null, so a record may lack joints; its user has to supply defaults.

The published module takes any numbers between 0 and 4095; here a joint is refused when its numbers
cannot be this arm's, and the message names it and what to do. ``usable`` takes the others, as if
the file lacked the joint; ``parse`` takes all or none. A record of another arm (ids of other
joints) or one that says something twice is refused as a whole: nothing in it can be trusted.

A joint without ``drive_mode`` has 0, as in the published module. One without ``homing_offset`` is
refused, although it has 0 there: the published module never writes the offset, while here the servo
gets it, and its joint's zero would be off by what the servo holds.

Files are in ``store``, other formats in ``lerobot``, and the zero of a joint is in ``zero``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from so101_motion.common.errors import CalibrationError, quoted
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.drivers.bus.registers import TICKS_PER_TURN
from so101_motion.files.json_file import Object

JOINTS = (*ARM_JOINTS, GRIPPER_JOINT)  # the joints along the cable, base to jaw

SERVO_IDS: Mapping[str, int] = {joint: place for place, joint in enumerate(JOINTS, start=1)}
"""The servo id of each joint of a finished arm."""

FIELDS = ("id", "drive_mode", "homing_offset", "range_min", "range_max", "norm_mode")
"""The fields of each joint, in the order of the file."""

_REQUIRED = ("id", "homing_offset", "range_min", "range_max")

LARGEST_OFFSET = 2047
"""Largest homing offset that every firmware stores [tick]; register 31 has eleven bits for it."""

_HALF_TURN = 2048
"""Half a turn [tick]: the offset one beyond the largest, which the published module's file may have
where the servo itself holds the largest."""

NARROWEST = 57
"""Narrowest range that counts as a travel [tick], 5 deg; with less the joint was not moved."""

WIDEST = 4000
"""Widest travel of a joint that has stops [tick]; the arm's joints turn by 2,340 at most. With
more, the recording went across the encoder's seam. Only wrist_roll may be recorded as a whole
turn."""

GRIPPER_TRAVEL = 1251  # the jaw's travel [tick]: 110 deg, the joint limits of the robot description

_WIDEST_GRIPPER = 1.25 * GRIPPER_TRAVEL  # the published module's guard; real arms: up to 1.17
_AGAIN = "calibrate the arm again"


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldCalibration:
    """The calibration that a servo holds, in registers 31, 9 and 11; by default a new servo's."""

    homing_offset: int = 0  # what it subtracts from its encoder's count [tick]
    range_min: int = 0  # smallest goal it accepts [tick]
    range_max: int = TICKS_PER_TURN - 1  # largest

    @property
    def has_travel(self) -> bool:
        """Whether the limits are a recorded travel; new servos have a whole turn, or none."""
        return 0 < self.range_max - self.range_min < TICKS_PER_TURN - 1

    @property
    def is_blank(self) -> bool:
        """Whether it is no calibration: the servo is new, or was reset."""
        return self.homing_offset == 0 and not self.has_travel


@dataclass(frozen=True, slots=True, kw_only=True)
class JointCalibration(HeldCalibration):
    """The calibration of one joint."""

    id: int
    drive_mode: int = 0  # not 0 if the servo counts down with the joint angle
    range_min: int = 500  # smallest position of the travel [tick], as the servo reports it
    range_max: int = 3500  # largest
    # how LeRobot-like programs scale it: 1 as 0..100, 2 as -100..100, 3 in degrees
    norm_mode: int = 3

    @property
    def held(self) -> HeldCalibration:
        """What its servo is to hold."""
        return HeldCalibration(
            homing_offset=self.homing_offset, range_min=self.range_min, range_max=self.range_max
        )

    def to_json(self) -> dict[str, int]:
        return {name: getattr(self, name) for name in FIELDS}


Calibration = Mapping[str, JointCalibration]
"""What is known of the joints, by name; joints may be missing."""


def default(joint: str) -> JointCalibration:
    """The calibration used when none is known: the encoder's middle, and a safe jaw."""
    servo_id = SERVO_IDS[joint]
    if joint == GRIPPER_JOINT:
        return JointCalibration(id=servo_id, range_min=2048, range_max=3248, norm_mode=1)
    return JointCalibration(id=servo_id)


def from_registers(
    joint: str, servo_id: int, held: HeldCalibration
) -> tuple[JointCalibration, str | None]:
    """Make the calibration from what a servo holds, with a note if that looks wrong.

    A jaw whose limits are much wider than its travel has never been calibrated. Driven to such a
    limit it would press against its stop forever, so it gets the default.

    Returns:
        The calibration, and a note for the user, without the joint's name, or None.
    """
    known, limits = replace(default(joint), id=servo_id), f"{held.range_min} to {held.range_max}"
    if not 0 <= held.range_min < held.range_max < TICKS_PER_TURN:
        return (
            known,
            f"the limits in the servo ({limits}) make no sense, so defaults are used; {_AGAIN}",
        )
    if joint == GRIPPER_JOINT and held.range_max - held.range_min > _WIDEST_GRIPPER:
        return (
            replace(known, homing_offset=held.homing_offset),
            f"the limits in the servo ({limits}) are wider than the jaw travels, so a narrower"
            f" default is used; {_AGAIN}",
        )
    found = replace(known, **asdict(held))
    if looks_as_new(joint, found):
        return found, "new servo, not calibrated yet; calibrate the arm"
    return found, None


_STOPPED = tuple(joint for joint in JOINTS if joint != "wrist_roll")


def looks_as_new(joint: str, found: JointCalibration) -> bool:
    """Whether a servo was never calibrated: its limits are wider than its joint's travel."""
    return joint in _STOPPED and found.range_max - found.range_min > WIDEST


# Reading


def parse(content: object) -> dict[str, JointCalibration]:
    """Parse the content of a calibration file, all of it."""
    entries = _entries(content)
    found = {joint: _joint(joint, entry) for joint, entry in entries.items()}
    for joint, entry in found.items():
        _check(joint, entry)
    _check_order(found)
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class UsablePart:
    """What can be used of a calibration."""

    calibration: dict[str, JointCalibration]  # its joints, without the refused ones
    refused: Mapping[str, str]  # the joints whose numbers cannot be used, and why not
    notes: tuple[str, ...]  # what the user should know about both
    has_norm_mode: bool  # whether it has that field, which LeRobot does not write


def usable(content: object) -> UsablePart:
    """Parse what can be used of a calibration file; raises if nothing can be."""
    found: dict[str, JointCalibration] = {}
    refusals: dict[str, CalibrationError] = {}
    notes: list[str] = []
    for joint, entry in _entries(content).items():
        try:
            read = _joint(joint, entry)
            if abs(read.homing_offset) == _HALF_TURN:
                held = LARGEST_OFFSET if read.homing_offset > 0 else -LARGEST_OFFSET
                notes.append(
                    f"{joint}: homing_offset {read.homing_offset} is more than a servo stores;"
                    f" {held} is used, 0.09 deg beside it"
                )
                read = replace(read, homing_offset=held)
            _check(joint, read)
        except CalibrationError as error:
            refusals[joint] = error
        else:
            found[joint] = read
    if not found:
        raise next(iter(refusals.values()))
    _check_order(found)
    notes += (
        f"{joint} is not taken from the calibration: {error.reason}; the values in its servo"
        f" are used; {error.next_step}"
        for joint, error in refusals.items()
    )
    reasons = {joint: error.reason for joint, error in refusals.items()}
    has_norm_mode = any(
        isinstance(entry, Mapping) and "norm_mode" in entry for entry in _entries(content).values()
    )
    return UsablePart(
        calibration=found, refused=reasons, notes=tuple(notes), has_norm_mode=has_norm_mode
    )


def _entries(content: object) -> dict[str, object]:
    if not isinstance(content, Mapping):
        raise CalibrationError(
            None,
            f"a calibration is an object with an entry for each joint, not {quoted(content)}",
            "check the path",
        )
    for name in _repeated(content):
        if name in JOINTS:
            raise CalibrationError(name, "is in it twice, so one of them is wrong", _AGAIN)
    content = without_prefix(content)
    entries = {
        joint: content[joint]
        for joint in JOINTS
        if content.get(joint) is not None  # null: the published module's mark of a lost joint
    }
    if "motor_names" in content:
        reason = "it is LeRobot's format of before June 2025, which lacks the servos' offsets"
        raise CalibrationError(None, reason, _AGAIN)
    if not entries:
        raise CalibrationError(
            None, "it holds no joint of this arm: " + ", ".join(JOINTS), "check the path"
        )
    for joint, entry in entries.items():
        for name in _repeated(entry):
            if name in FIELDS:
                raise CalibrationError(joint, f"{name} is given twice, so one is wrong", _AGAIN)
        _check_id(joint, entry)
    return entries


def misplaced(ids: Iterable[int], travels: Mapping[str, int]) -> str:
    """What is wrong with the order of an arm's ids; empty if nothing shows.

    The jaw's travel is half of the others', that of wrist_roll is the widest. Roll itself shows
    nothing: it is often recorded as a full turn. ``travels`` are by joint [tick].
    """
    first, *others = sorted(ids) or [1]
    if len(others) == len(JOINTS) - 1 == others[-1] - first and first != 1:
        return (
            f"the ids run from {first} to {others[-1]}, not from 1 to {len(JOINTS)}, so each servo"
            " has the id of another joint"
        )
    if len(travels) < len(JOINTS):
        return ""
    pan, lift, jaw = (travels[joint] for joint in ("shoulder_pan", "shoulder_lift", "gripper"))
    least, most = 0.8 * GRIPPER_TRAVEL, 1.3 * GRIPPER_TRAVEL  # public jaws: 0.85 to 1.17 of it
    if least < pan < most < jaw and lift > 1.15 * jaw:
        return (
            "the ids run from the jaw to the base, 6 to 1: the servo with the id 1 has the jaw's"
            " travel, the one with the id 6 a joint's"
        )
    return ""


NEW_IDS = "so101 setup --start-over, then so101 calibrate"  # what to do about misplaced ids


def _check_order(found: Calibration) -> None:
    travels = {joint: entry.range_max - entry.range_min for joint, entry in found.items()}
    if wrong := misplaced((), travels):
        raise CalibrationError(None, wrong, NEW_IDS)


def without_prefix(content: Mapping[str, object]) -> Mapping[str, object]:
    """The entries by this arm's names, also of a robot that says ``arm_shoulder_pan`` and so on."""
    if any(joint in content for joint in JOINTS):
        return content
    ends = ("shoulder_pan", "shoulder_lift")
    found = [n.removesuffix(ends[0]) for n in content if str(n).endswith(f"_{ends[0]}")]
    prefixes = [prefix for prefix in found if prefix + ends[1] in content]
    if len(prefixes) > 1:
        raise CalibrationError(
            None,
            f"it holds several arms: {', '.join(sorted(prefixes))}",
            "copy the entries of one of them into a file of its own",
        )
    return {
        joint: content.get(prefix + joint) for prefix in prefixes for joint in JOINTS
    } or content


def check(calibration: Calibration) -> None:
    parse({joint: entry.to_json() for joint, entry in calibration.items()})


def _joint(joint: str, entry: object) -> JointCalibration:
    if not isinstance(entry, Mapping):
        raise CalibrationError(joint, f"must be an object, not {quoted(entry)}", _AGAIN)
    numbers = {name: _whole(joint, name, entry[name]) for name in FIELDS if name in entry}
    missing = [name for name in _REQUIRED if name not in numbers]
    if missing:
        raise CalibrationError(joint, f"{', '.join(missing)} missing", _AGAIN)
    if not numbers.get("norm_mode"):
        numbers["norm_mode"] = default(joint).norm_mode
    return JointCalibration(**numbers)


def _check(joint: str, found: JointCalibration) -> None:
    problem = _problem(joint, found)
    if problem is not None:
        raise CalibrationError(joint, *problem)


def _check_id(joint: str, entry: object) -> None:
    place = SERVO_IDS[joint]
    if not isinstance(entry, Mapping) or "id" not in entry:
        return
    given = _whole(joint, "id", entry["id"])
    if given != place:
        swapped = JOINTS[given - 1] if 1 <= given <= len(JOINTS) else "no joint"
        raise CalibrationError(
            joint,
            f"is servo {place} of this arm, but the record says {given} (that is {swapped})",
            "check that the file belongs to this arm",
        )


def _whole(joint: str, name: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value % 1 != 0:
        raise CalibrationError(joint, f"{name} must be a whole number, not {quoted(value)}", _AGAIN)
    if abs(value) > 1e6:
        raise CalibrationError(joint, f"{name} is {quoted(value)}, which is impossible", _AGAIN)
    return int(value)


def _repeated(content: object) -> tuple[str, ...]:
    return content.repeated if isinstance(content, Object) else ()


def _problem(joint: str, found: JointCalibration) -> tuple[str, str] | None:
    """What is wrong and what to do, or None."""
    lower, upper = found.range_min, found.range_max
    if found.drive_mode not in (0, 1):
        return f"drive_mode is 0 or 1, not {found.drive_mode}", _AGAIN
    if abs(found.homing_offset) > LARGEST_OFFSET:
        return (
            f"homing_offset {found.homing_offset} is more than a servo stores ({LARGEST_OFFSET})",
            "hold the joint nearer to the middle of its travel and calibrate again",
        )
    if lower > upper:
        return (
            f"range_min {lower} is above range_max {upper}",
            "swap the two if the file was edited by hand, else calibrate the arm again",
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
            f"range {lower} to {upper} is more than the joint can turn, so its encoder passed the"
            " end of its scale during the recording",
            "calibrate again, with the joint in the middle of its travel when homing is set",
        )
    if not 0 <= found.norm_mode <= 3:
        return f"norm_mode is 0 to 3, not {found.norm_mode}", _AGAIN
    return None


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Make the folder of ``path``, and turn an ``OSError`` into a ``CalibrationError``."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        reason = f"{path} cannot be written: {error.strerror or error}"
        raise CalibrationError(None, reason, "check the path and its permissions") from error
