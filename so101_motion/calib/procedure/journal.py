"""Keep a journal of a running calibration, so that a crash at any instant loses nothing.

A calibration changes six servos and a file, one after the other. Before the first servo is changed,
a journal is written beside the calibration file: what each servo held, and what it gets during the
calibration. When the calibration is saved, the journal first records what servos and file are to
hold, and is removed last. So a process that finds a journal knows that a calibration was
interrupted, and how to end it (``recover``): if saving had begun it is completed, otherwise the
servos are put back. Either way the servos and the file agree again.

A journal may be old. If a servo now holds values that are not in it, the arm has been calibrated by
other means since; then nothing is changed and the journal is removed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from so101_motion.calib.procedure.eeprom import read_held, write_held
from so101_motion.calib.record import record, store
from so101_motion.calib.record.record import JOINTS, SERVO_IDS, Calibration, HeldCalibration
from so101_motion.calib.record.zero import Zero
from so101_motion.common.errors import BusError, CalibrationError, PortUnavailable
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.registers import HOMING_OFFSET
from so101_motion.files import atomic, json_file

_ABOUT = (
    "A calibration of an SO-101 arm was interrupted. The software needs this file to complete or"
    " undo it at its next start, and then removes the file."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Saving:
    """The calibration that servos and file are to hold."""

    calibration: Calibration
    zeros: Mapping[str, Zero]


@dataclass(frozen=True, slots=True, kw_only=True)
class Journal:
    """The journal of a running calibration."""

    before: Mapping[str, HeldCalibration]  # what each servo held before the calibration, by joint
    meanwhile: Mapping[str, HeldCalibration]  # what it gets during the calibration, by joint
    saving: Saving | None = None  # what servos and file are to hold; None before that is known
    # whether ``saving`` is to be carried through; else everything is put back
    is_decided: bool = False


def path_for(calibration_file: Path) -> Path:
    return calibration_file.with_name(f"{calibration_file.name}.unfinished")


def is_known(calibration_file: Path) -> bool:
    """Whether an arm was calibrated to this file, or such a calibration was interrupted."""
    paths = (calibration_file, path_for(calibration_file))
    return any(path.exists() for path in paths) or bool(store.versions(calibration_file))


def write(calibration_file: Path, journal: Journal) -> None:
    content: dict[str, object] = {
        "about": _ABOUT,
        "before": {joint: _row(held) for joint, held in journal.before.items()},
        "meanwhile": {joint: _row(held) for joint, held in journal.meanwhile.items()},
    }
    if journal.saving is not None:
        saving = journal.saving
        content["is_decided"] = journal.is_decided
        content["saving"] = {
            "calibration": {joint: entry.to_json() for joint, entry in saving.calibration.items()},
            "zeros": {joint: [zero.by, zero.angle] for joint, zero in saving.zeros.items()},
        }
    path = path_for(calibration_file)
    with record.writing(path):
        atomic.write(path, json.dumps(content, indent=2).encode() + b"\n")


def remove(calibration_file: Path) -> None:
    path = path_for(calibration_file)
    try:
        path.unlink(missing_ok=True)
        if path.parent.is_dir():
            atomic.flush(path.parent)
    except OSError as error:
        reason = f"{path} cannot be removed: {error.strerror or error}"
        raise CalibrationError(None, reason, "check the permissions of its folder") from error


def read(calibration_file: Path) -> Journal | None:
    """Read the journal of an interrupted calibration; None if there is none."""
    path = path_for(calibration_file)
    if not path.exists():
        return None
    content = json_file.read(path)
    try:
        return _parse(content)
    except (
        CalibrationError,
        ArithmeticError,
        AttributeError,
        LookupError,
        TypeError,
        ValueError,
    ) as error:
        raise CalibrationError(
            None,
            f"{path}, which an interrupted calibration left behind, cannot be understood: {error}",
            "remove it and calibrate again",
        ) from error


def recover(bus: Bus, calibration_file: Path) -> str | None:
    """End an interrupted calibration, if there is one; returns what was done, for the user."""
    journal = read(calibration_file)
    if journal is None:
        return None
    try:
        note = _end(bus, calibration_file, journal)
    except PortUnavailable:
        raise
    except BusError as error:
        raise CalibrationError(
            None,
            "a calibration was interrupted, and its servos' settings could not be restored:"
            f" {error}",
            f"if this servo is gone for good, remove {path_for(calibration_file)}",
        ) from error
    remove(calibration_file)
    return note


def _end(bus: Bus, calibration_file: Path, journal: Journal) -> str:
    saving = journal.saving
    if not all(
        _knows(journal, joint, read_held(bus, SERVO_IDS[joint])) for joint in journal.before
    ):
        return (
            "A calibration was interrupted, but the servos have been calibrated by other means"
            " since; nothing was changed."
        )
    if saving is None or not journal.is_decided:
        for joint, held in journal.before.items():
            write_held(bus, SERVO_IDS[joint], held)
        return (
            "A calibration was interrupted before it was saved; the servos' settings were restored."
        )
    for joint, entry in saving.calibration.items():
        write_held(bus, SERVO_IDS[joint], entry)
    store.save(calibration_file, saving.calibration, zeros=saving.zeros)
    return "A calibration was interrupted while it was saved; it is complete now."


def _knows(journal: Journal, joint: str, held: HeldCalibration) -> bool:
    """Whether a servo holds a value that this calibration wrote or found."""
    known = [journal.before[joint], journal.meanwhile[joint]]
    if journal.saving is not None:
        known.append(journal.saving.calibration[joint].held)
    looks_new = held == HeldCalibration(homing_offset=held.homing_offset)
    return held in known or (
        looks_new and any(held.homing_offset == k.homing_offset for k in known)
    )


def _row(held: HeldCalibration) -> list[int]:
    return [held.homing_offset, held.range_min, held.range_max]


def _parse(content: object) -> Journal:
    if not isinstance(content, Mapping):
        raise ValueError("it is not an object")
    before, meanwhile = _held_by_joint(content["before"]), _held_by_joint(content["meanwhile"])
    if before.keys() != meanwhile.keys():
        raise ValueError('"before" and "meanwhile" name different joints')
    saving = None
    if "saving" in content:
        calibration = record.parse(content["saving"]["calibration"])
        if calibration.keys() != before.keys():
            raise ValueError('"before" and "saving" name different joints')
        zeros = {
            joint: Zero(by=str(by), angle=float(angle))
            for joint, (by, angle) in content["saving"]["zeros"].items()
        }
        saving = Saving(calibration=calibration, zeros=zeros)
    return Journal(
        before=before,
        meanwhile=meanwhile,
        saving=saving,
        is_decided=content.get("is_decided") is True,
    )


def _held_by_joint(rows: Mapping[str, list[int]]) -> dict[str, HeldCalibration]:
    found = {}
    for joint, (offset, lower, upper) in rows.items():
        if joint not in JOINTS:
            raise ValueError(f"{joint} is not a joint of this arm")
        lowest, highest = HOMING_OFFSET.lower, HOMING_OFFSET.upper
        if not (lowest <= offset <= highest and 0 <= lower <= 4095 and 0 <= upper <= 4095):
            raise ValueError(f"{joint} cannot hold {offset}, {lower}, {upper}")
        found[joint] = HeldCalibration(
            homing_offset=int(offset), range_min=int(lower), range_max=int(upper)
        )
    return found
