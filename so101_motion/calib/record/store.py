"""Read, save and restore calibration files.

A calibration is a file that other programs know (``record``) and beside it a file with the zeros
(``zero``). Saving keeps the file's entries of other joints. It takes these steps, each of
which is all or nothing:

    1. the present content is kept as a version (``versions``)
    2. the zeros: those of the old record and those of the new
    3. the record
    4. the new record and zeros are kept as a version, which is the second copy
    5. the zeros: those of the new record only

So whenever saving is cut short, the file holds the old record or the new one, and the zeros belong
to it. Writers wait for each other; readers never wait.

If a file in the module's data directory is gone, viam-server has deleted it, as it does when the
module leaves the configuration for a moment; ``load`` restores it. If a file anywhere else is gone,
the user has removed it, and it is not restored.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

from so101_motion.calib.record import record
from so101_motion.calib.record import versions as history
from so101_motion.calib.record.record import JOINTS, Calibration, JointCalibration
from so101_motion.calib.record.versions import Version, versions, zero_path
from so101_motion.calib.record.zero import Zero, about_homing, read_zeros, zeros_text
from so101_motion.common.errors import CalibrationError, quoted
from so101_motion.files import atomic, json_file

__all__ = ["Stored", "Version", "earlier", "load", "read", "resolve", "restore", "save", "versions"]

NO_ZEROS: Mapping[str, Zero] = MappingProxyType({})


@dataclass(frozen=True, slots=True, kw_only=True)
class Stored:
    """The content of a calibration file, with its zeros."""

    path: Path  # where it is, absolute
    calibration: Mapping[str, JointCalibration]  # by joint; joints may be missing
    # the joints' zeros; joints that are missing here have theirs in the middle
    zeros: Mapping[str, Zero]
    notes: tuple[str, ...]  # what the user should know about it
    # the joints that are missing here, because their numbers in the file cannot be used; and why
    # not
    refused: Mapping[str, str] = field(default_factory=dict)
    zero_note: str = ""  # what to tell unless ``joint_zero`` is chosen; see ``zero.about_homing``


def resolve(path: str) -> Path:
    """Make a calibration file's path absolute: a relative one is in the module's data directory.

    viam-server names that directory in ``VIAM_MODULE_DATA``; without it (from the command line) a
    relative path starts at the working directory. Resolve once and keep the result.
    """
    try:
        given = Path(path).expanduser()
        return (Path(os.environ.get("VIAM_MODULE_DATA") or ".") / given).resolve()
    except (RuntimeError, ValueError, OSError) as error:
        raise CalibrationError(
            None, f"{quoted(path)} cannot be a path: {error}", "give another"
        ) from error


# Reading


def read(path: Path) -> Stored:
    """Read the file at ``path``; writes and restores nothing.

    A joint whose numbers are impossible is left out, with a note; the others are used. The file may
    be ours, the published module's or LeRobot's.
    """
    data = json_file.read_bytes(path)
    while True:
        found = _understood(path, data)
        before, data = data, json_file.read_bytes(path)
        if data == before:  # so the zeros, read in between, are those of this record
            return found


def _understood(path: Path, data: bytes) -> Stored:
    content, zero_note = json_file.parse(data, str(path)), ""
    try:
        found = record.usable(content)
        calibration = found.calibration
        zeros, notes = read_zeros(zero_path(path), calibration)
        if found.has_norm_mode:
            zero_note = about_homing(calibration, zeros)
    except CalibrationError as error:
        raise CalibrationError(
            error.joint, f"{error.reason} (in {path})", error.next_step
        ) from error
    return Stored(
        path=path,
        calibration=calibration,
        zeros=zeros,
        notes=tuple(f"{note} (in {path})" for note in found.notes) + notes,
        refused=found.refused,
        zero_note=zero_note,
    )


def load(path: Path) -> Stored:
    """Read the file at ``path``; restores it if viam-server has deleted it.

    A file in the module's data directory has a second copy elsewhere from then on.
    """
    notes: tuple[str, ...] = ()
    if _is_module_data(path) and not path.exists():
        notes = _bring_back(path)
    try:
        found = read(path)
    except CalibrationError as error:
        if not versions(path):
            raise
        step = f"{error.next_step}; or take an earlier one: so101 calibration restore {path}"
        raise CalibrationError(error.joint, error.reason, step) from error
    if _is_module_data(path):
        notes += _keep(path)
    return replace(found, notes=found.notes + notes)


def _is_module_data(path: Path) -> bool:
    folder = os.environ.get("VIAM_MODULE_DATA")
    return bool(folder) and path.is_relative_to(Path(str(folder)).resolve())


def _bring_back(path: Path) -> tuple[str, ...]:
    for version in versions(path):
        try:
            read(version.path)
        except CalibrationError:
            continue  # a version that cannot be used is not restored
        try:
            data, zeros = history.contents(version.path)
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic.locked(path.parent):
                if zeros is not None:
                    atomic.write(zero_path(path), zeros)
                atomic.write(path, data)
        except OSError as error:
            return (f"{path} is gone and cannot be restored from {version.path}: {error}",)
        return (
            f"{path} was gone, as happens when the module leaves the configuration for a moment;"
            f" it was restored from the copy of {version.kept_at:%Y-%m-%d %H:%M} UTC in"
            f" {version.path.parent}",
        )
    return ()


def _keep(path: Path, zeros: bytes | None = None) -> tuple[str, ...]:
    """Keep the file's content as the last version; return a note if that fails.

    ``zeros`` is the content that the file of zeros is about to get; None for its present one.
    """
    try:
        data, beside = history.contents(path)
        history.keep(path, data, beside if zeros is None else zeros or None)
    except OSError as error:
        reason = error.strerror or error
        return (f"there is no second copy of {path}, because it cannot be written: {reason}",)
    return ()


# Writing


def keep_held(path: Path, held: Calibration) -> Path | None:
    """Keep what servos hold as a version of the file, not the last one; None if it is nonsense."""
    data = {joint: entry.to_json() for joint, entry in held.items()}
    try:
        whole = record.usable(data).calibration
    except CalibrationError:
        return None
    try:
        before = history.contents(path) if path.exists() else None
        kept = history.keep(path, _text(whole), None)
        if before is not None:
            history.keep(path, *before)
    except OSError as error:
        raise CalibrationError(
            None,
            f"what the servos hold cannot be kept: {error.strerror or error}",
            "make room in your home directory; nothing was changed",
        ) from error
    return kept


def save(path: Path, calibration: Calibration, *, zeros: Mapping[str, Zero] = NO_ZEROS) -> Stored:
    """Save ``calibration`` to the file at ``path``; the file's other joints stay."""
    record.check(calibration)
    with _writing(path):
        before = _salvaged(path)
        others = {joint: zero for joint, zero in before.zeros.items() if joint not in calibration}
        merged = {**before.calibration, **calibration}
        return _put(before, merged, {**others, **zeros})


def restore(path: Path, number: int | None = None) -> Stored:
    """Restore an earlier version, the last that differs by default; the present one is kept."""
    with _writing(path):
        wanted = earlier(path, number)
        return _put(_salvaged(path), wanted.calibration, wanted.zeros)


def earlier(path: Path, number: int | None = None) -> Stored:
    """The version that ``restore`` would take; writes nothing."""
    return _version(path, number) if number is not None else _last_other(_salvaged(path))


def _version(path: Path, number: int) -> Stored:
    kept = versions(path)
    for version in kept:
        if version.number == number:
            return _read_whole(version.path)
    known = ", ".join(str(version.number) for version in kept) or "none"
    raise CalibrationError(
        None, f"there is no version {number} of {path}", f"choose one of these: {known}"
    )


def _last_other(now: Stored) -> Stored:
    for version in versions(now.path):
        try:
            found = _read_whole(version.path)
        except CalibrationError:
            continue  # it cannot be used
        if (found.calibration, found.zeros) != (now.calibration, now.zeros):
            return found
    raise CalibrationError(
        None,
        f"there is no earlier version of {now.path} that differs",
        "calibrate the arm again",
    )


def _read_whole(path: Path) -> Stored:
    """Read a version to be restored, which must not lack a joint that it names."""
    found = read(path)
    if found.refused:
        joint, reason = next(iter(found.refused.items()))
        raise CalibrationError(joint, f"{reason} (in {path})", "choose another version")
    return found


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    with record.writing(path), atomic.locked(path.parent):
        yield


def _salvaged(path: Path) -> Stored:
    """Read what can be used of the file, so that one wrong joint does not lose the others."""
    found, problem = Stored(path=path, calibration={}, zeros={}, notes=()), ""
    if path.exists():
        try:
            found = read(path)
            problem = "; ".join(f"{joint}: {reason}" for joint, reason in found.refused.items())
        except CalibrationError as error:
            problem = error.reason
    if not problem:
        return found
    note = f"what was there before could not be used ({problem}); it is kept as a version"
    return replace(found, notes=(note,), refused={})


def _put(before: Stored, calibration: Calibration, zeros: Mapping[str, Zero]) -> Stored:
    """Replace the file's content in the steps listed at the top; the lock must be held."""
    path, beside = before.path, zero_path(before.path)
    notes = before.notes + _set_aside(path)
    _write_or_remove(beside, zeros_text((before.calibration, before.zeros), (calibration, zeros)))
    atomic.write(path, _text(calibration))
    now = zeros_text((calibration, zeros))
    notes += _keep(path, now)
    try:
        _write_or_remove(beside, now)
    except OSError as error:  # it is saved, and the zeros beside it fit it as well
        reason = error.strerror or error
        notes += (f"{beside} still holds the zeros of the calibration before: {reason}",)
    found = read(path)
    return replace(found, notes=found.notes + notes)


def _text(calibration: Calibration) -> bytes:
    data = {joint: calibration[joint].to_json() for joint in JOINTS if joint in calibration}
    return json.dumps(data, indent=2).encode() + b"\n"


def _set_aside(path: Path) -> tuple[str, ...]:
    """Keep the file's content as a version, or else beside it; return a note if that fails."""
    if not path.exists():
        return ()
    aside = path.with_name(path.name + ".bak")
    if path.stat().st_size > json_file.LARGEST:
        path.replace(aside)
        return (f"the old file is too large to be a calibration; it was moved to {aside}",)
    notes = _keep(path)
    if notes:
        atomic.write(aside, path.read_bytes())
    return notes


def _write_or_remove(path: Path, data: bytes) -> None:
    if data:
        atomic.write(path, data)
    elif path.exists():
        path.unlink()
        atomic.flush(path.parent)
