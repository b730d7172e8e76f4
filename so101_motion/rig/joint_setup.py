"""Find the servos on a bus and the calibration of each.

For each servo the calibration file counts first, then its own registers, read again at each start,
then the defaults. For the zero see ``zero``: only a file can have more than the middle of the
travel, and only the configuration overrides a file.

If the servos hold another calibration than the file, that may be of another arm: they are not
driven; where they are only looked at, their own calibration is used. Opening an arm stores nothing:
where a servo holds no calibration, or limits a little different, the file's are in force until its
power goes.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from so101_motion.arm.gripper import JAW_CLOSED
from so101_motion.calib.procedure import eeprom, journal
from so101_motion.calib.record import compare, file_search, record, servo_file, store
from so101_motion.calib.record.record import JOINTS, HeldCalibration, JointCalibration
from so101_motion.calib.record.store import Stored
from so101_motion.calib.record.zero import MIDDLE, Zero, in_force, zero_ticks
from so101_motion.common.errors import (
    BusError,
    CalibrationError,
    OtherCalibration,
    PortUnavailable,
    ServoFault,
)
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.ticks import TICKS_PER_RAD, JointMap, Ticks
from so101_motion.drivers.servo_types import ServoFigures
from so101_motion.rig.port_settings import ServoSettings

_log = logging.getLogger(__name__)

_TRY_PERIOD = 0.25  # [s] between two tries to find the servos


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSetup:
    """One joint's calibration, its source, and the joint map made from it."""

    calibration: JointCalibration  # the record
    source: str  # ``"file"``, ``"registers"`` or ``"defaults"``
    map: JointMap  # ticks to radians
    zero: Zero = MIDDLE  # its zero and where that comes from; without meaning for the jaw

    def is_guessed(self, joint: str) -> bool:
        is_new = self.source == "registers" and record.looks_as_new(joint, self.calibration)
        return is_new or self.source == "defaults"


class Doubt(str):
    """A note on the calibration in use, without meaning for somebody who makes a new one."""

    __slots__ = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSetups:
    """The joints whose servos were found."""

    setups: Mapping[str, JointSetup]  # by joint, for every joint that has a servo
    notes: tuple[str, ...]  # what the user should know
    figures: Mapping[str, ServoFigures]  # the identified figures of servos, by joint


def find_joints(
    bus: Bus,
    settings: ServoSettings,
    required: Collection[str],
    *,
    timeout: float = 0.0,
    expected: Collection[str] = (),
) -> JointSetups:
    """Find the servos that ``settings`` name and their calibration.

    Joints that are ``required`` are set up even if their servos do not answer within ``timeout``
    [s]; those ``expected`` are waited for as well, and left out if they do not answer.

    Raises:
        OtherCalibration: Servos that are to be driven hold another one.
        ServoFault: The ids run the other way, as the travels that the servos hold show.
        BusError: The port went away, or an interrupted calibration could not be ended.
    """
    ids, file, joint_zero = settings.ids(), settings.file, settings.joint_zero
    present = _find(bus, ids, {*required, *expected}, timeout)
    drives = bool(required or expected)
    interrupted = _end_interrupted(bus, file, drives or settings.may_file_be_missing)
    held = {joint: _held(bus, ids[joint]) for joint in present}
    known = {joint: each for joint, each in held.items() if isinstance(each, HeldCalibration)}
    travels = {joint: each.range_max - each.range_min for joint, each in known.items()}
    wrong = record.misplaced((), travels)
    if wrong and drives:
        raise ServoFault(f"{wrong}; {record.NEW_IDS}", servo_id=ids[GRIPPER_JOINT])
    if file is None and settings.finds_file:
        file = _saved_for(known)
    stored, notes = _read_file(file, settings.may_file_be_missing)
    notes = (*interrupted, *map(Doubt, notes))
    notes += (f"{wrong}; {record.NEW_IDS}",) if wrong else ()
    filed = {entry.id: entry for entry in stored.calibration.values()} if stored else {}
    other = _other_calibration(bus, stored, filed, ids, known)
    if other is not None:
        if drives:
            raise other
        notes = (*notes, Doubt(f"{other}. Meanwhile angles are the servos' own"))
        stored, filed = None, {}
    if stored and stored.zero_note and joint_zero is None:
        notes = (*notes, Doubt(stored.zero_note))
    setups = {}
    doubtful: dict[str, list[str]] = {}  # of which joints each note is true
    for joint in JOINTS:
        if joint not in present and joint not in required:
            continue
        found, source, note = filed.get(ids[joint]), "file", None
        if found is None:
            found, source, note = _from_servo(joint, ids[joint], held.get(joint))
        is_own = stored is not None and found is stored.calibration.get(joint)
        filed_zero = stored.zeros.get(joint) if stored and is_own else None
        zero = in_force(filed_zero, (settings.zero_offsets or {}).get(joint), found, joint_zero)
        offset = _offset(found, known.get(joint)) if source == "file" else None
        if source == "file" and joint in known:
            note = _NOT_STORED if known[joint].is_blank else None
        mapped = joint_map(joint, found, offset=offset, zero=zero)
        setups[joint] = JointSetup(calibration=found, source=source, map=mapped, zero=zero)
        if note:
            doubtful.setdefault(note, []).append(joint)
    notes += tuple(Doubt(f"{', '.join(joints)}: {note}") for note, joints in doubtful.items())
    figures, doubts = _read_figures(file)
    return JointSetups(setups=setups, notes=notes + doubts, figures=figures)


def joint_map(joint: str, found: JointCalibration, *, offset: int | None, zero: Zero) -> JointMap:
    """Make the map from ticks to radians of one joint.

    The jaw's zero is such that the closed end of its travel is the model's closed jaw; ``zero`` is
    for an arm joint. ``offset`` is the homing offset that the servo has to hold, if the calibration
    came from a file [tick]; else None.
    """
    at_zero = zero_ticks(found, zero)
    if joint == GRIPPER_JOINT:
        closed_ticks = found.range_max if found.drive_mode else found.range_min
        at_zero = closed_ticks - (-1 if found.drive_mode else 1) * JAW_CLOSED * TICKS_PER_RAD
    return JointMap(
        servo_id=found.id,
        zero_ticks=at_zero,
        direction=-1 if found.drive_mode else 1,
        lower_ticks=Ticks(found.range_min),
        upper_ticks=Ticks(found.range_max),
        homing_offset=offset,
    )


def _find(bus: Bus, ids: Mapping[str, int], wanted: Collection[str], timeout: float) -> list[str]:
    """The joints whose servos answer; gives those ``wanted`` ``timeout`` seconds to do so."""
    pause = threading.Event()
    for attempt in range(1 + int(timeout / _TRY_PERIOD)):
        if attempt:
            pause.wait(_TRY_PERIOD)
        answering = bus.answering(ids.values())
        present = [joint for joint, servo_id in ids.items() if servo_id in answering]
        if all(joint in present for joint in wanted):
            break
    return present


def _end_interrupted(bus: Bus, path: Path | None, may_write: bool) -> tuple[str, ...]:
    """End a calibration that a crash interrupted, before its data is used to drive the servos."""
    if path is not None and not may_write:
        if not journal.path_for(path).exists():
            return ()
        return (
            f"a calibration to {path} was interrupted; it is completed or undone when the arm is"
            " next calibrated, or opened to be moved",
        )
    try:
        note = None if path is None else journal.recover(bus, path)
    except CalibrationError as error:
        return (str(error),)
    return (note,) if note else ()


def _read_file(path: Path | None, is_to_come: bool) -> tuple[Stored | None, tuple[str, ...]]:
    """Read the file; a bad file gives a note, because the servos hold a calibration as well."""
    if path is None:
        return None, ()
    try:
        found = store.load(path)
    except CalibrationError as error:
        elsewhere = _elsewhere(path)
        if is_to_come and not path.exists() and not elsewhere:
            return None, ()
        note = f"the calibration file is not used: {error}. The servos' own calibration is used"
        return None, (note + elsewhere,)
    return found, found.notes


def _read_figures(path: Path | None) -> tuple[Mapping[str, ServoFigures], tuple[str, ...]]:
    """Read the identified figures of the servos; a bad file gives a note, and types' are used."""
    try:
        found = None if path is None else servo_file.read(path)
    except CalibrationError as error:
        return {}, (f"the identified servo figures are not used: {error}",)
    return ({} if found is None else found.servos), ()


def _elsewhere(path: Path) -> str:
    """Say where else a file of that name is; the published module moved its files."""
    if path.exists():
        return ""
    others = [str(f.path) for f in file_search.find() if f.path.name == path.name and f.stored]
    return f". A file of that name is {' and '.join(others)}; copy it from there" if others else ""


_NOT_STORED = (
    "the servo holds no calibration, so the file's is used until its power goes off; if the servo"
    ' was mounted anew, calibrate it, otherwise store the file: "so101 calibration write"'
)


def _held(bus: Bus, servo_id: int) -> HeldCalibration | BusError:
    """What a servo holds, or why that is not known."""
    try:
        return eeprom.read_held(bus, servo_id)
    except PortUnavailable:
        raise
    except BusError as error:
        return error


def _saved_for(known: Mapping[str, HeldCalibration]) -> Path | None:
    """The calibration file that this package has saved and that agrees with the servos."""
    for found in file_search.find():
        if (
            found.origin == "saved"
            and found.stored is not None
            and compare.agrees(found.stored.calibration, known)
        ):
            return found.path
    return None


def _offset(found: JointCalibration, held: HeldCalibration | None) -> int:
    """The homing offset that a servo gets: the file's, unless its own is just a tick beside it."""
    if held and abs(held.homing_offset - found.homing_offset) <= compare.TOLERANCE:
        return held.homing_offset
    return found.homing_offset


def _other_calibration(
    bus: Bus,
    stored: Stored | None,
    filed: Mapping[int, JointCalibration],
    ids: Mapping[str, int],
    known: Mapping[str, HeldCalibration],
) -> OtherCalibration | None:
    """The error that the servos hold something else than the file, if they do."""
    named = {joint: filed[ids[joint]] for joint in known if ids[joint] in filed}
    rows = compare.conflicts(named, known)
    if stored is None or not rows:
        return None
    others = [
        str(found.path)
        for found in file_search.find()
        if found.stored is not None
        and found.path != stored.path
        and compare.agrees(found.stored.calibration, known)
    ]
    count = f", and {len(rows) - 1} more numbers differ" if len(rows) > 1 else ""
    whose = (
        f". They agree with {others[0]}, so this is probably the arm of that file: use that"
        if others
        else ". This may be another arm, whose file is another"
    )
    return OtherCalibration(
        stored.path,
        f"{stored.path} is not the calibration that the servos on {bus.port.name} hold:"
        f" {rows[0].sentence}{count}{whose}; if the file is right, store it in the servos: so101"
        f" calibration write {stored.path} --port {bus.port.name}, or on a Viam machine"
        ' {"command": "write_calibration"}',
    )


def _from_servo(
    joint: str, servo_id: int, held: HeldCalibration | BusError | None
) -> tuple[JointCalibration, str, str | None]:
    default = replace(record.default(joint), id=servo_id)
    if held is None:
        return default, "defaults", None
    if isinstance(held, BusError):
        return default, "defaults", f"{held}. Defaults are used"
    found, note = record.from_registers(joint, servo_id, held)
    believed = (found.range_min, found.range_max) == (held.range_min, held.range_max)
    return found, "registers" if believed else "defaults", note
