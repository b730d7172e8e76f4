"""Save and load guided paths as JSON files; ``docs/teleoperation.md`` has an example.

Schema 2 has ``"encoder_zeros"``, the zeros of the calibration it was recorded with.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.common.encoder_zeros import KEY, EncoderZeros, shift, zeros_from, zeros_to
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_rad
from so101_motion.files import user_storage
from so101_motion.tasks.guided.path import GuidedPath

SCHEMA = "so101/guided-path/1"

_DECIMALS = 4  # of times in a file [s]
KEPT = 20  # how many deleted paths can be restored; chosen, a long one is a file of megabytes
_DELETED = "deleted"  # the folder beside the paths for those


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SavedPath:
    """A path in a folder."""

    name: str  # its name: the file's name without its ending
    path: GuidedPath
    recorded_at: str  # when it was recorded, as in the file
    zeros: EncoderZeros | None = None  # of the arm that it was recorded with; None if not known


def file_of(folder: Path, name: object) -> Path:
    """The file of the path called ``name``, existing or not; ``ConfigError`` for no file's name."""
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w .-]{0,79}", name):
        raise ConfigError("name", name, "must be letters, digits, spaces and _ . -, such as wave")
    user_storage.refuse_reserved(name, what="name")
    return folder / f"{name.removesuffix('.json')}.json"


def write(
    path: GuidedPath, file: Path, *, replace: bool = False, zeros: EncoderZeros | None = None
) -> None:
    """Save a path with the zeros of its arm; ``ConfigError`` if that cannot be."""
    refuse_taken(file, replace=replace)
    t = np.round(path.t, _DECIMALS)
    kept = np.flatnonzero(np.append(True, np.diff(t) > 0.0))  # rounding may give equal times
    path, t = path.taken(kept), t[kept]
    content: dict[str, Any] = {
        "recorded_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "joints": list(ARM_JOINTS),
        "time_s": t.tolist(),
        "q_deg": np.round(to_deg(path.q), 4).tolist(),
    }
    if path.aperture is not None:
        content["aperture_percent"] = np.round(100.0 * path.aperture, 2).tolist()
    content |= zeros_to(zeros)
    schema = user_storage.with_zeros(SCHEMA) if KEY in content else SCHEMA
    user_storage.write(file, content, schema=schema, indent=None)


def refuse_taken(file: Path, *, replace: bool = False) -> None:
    """Refuse a file that ``write`` would refuse, before the recording starts."""
    if file.suffix.lower() != ".json":
        raise ConfigError("path", str(file), "must end with .json")
    if not replace and file.exists():
        raise ConfigError("path", str(file), "is there already; choose another name or replace it")


def read(file: Path, zeros: EncoderZeros | None = None) -> GuidedPath:
    """Read a path, converted to the zeros of the arm that is to replay it.

    ``ConfigError`` if it is not valid, or the zeros are another arm's (``encoder_zeros.shift``).
    """
    saved = _read(file)
    path, made_with = saved.path, saved.zeros
    off = shift(made_with, zeros, what=f"the path {file.stem}", file=file)
    return GuidedPath(t=path.t, q=path.q + off, aperture=path.aperture) if off.any() else path


def listed(folder: Path) -> list[SavedPath]:
    """List the paths in a folder by name; leaves other files out."""
    found = []
    for file in sorted(folder.glob("*.json")):
        try:
            found.append(_read(file))
        except ConfigError:
            continue
    return found


def set_aside(file: Path) -> str:
    """Delete a path, but keep its file for ``restore``; returns what it is kept as.

    The last ``KEPT`` are kept. ``ConfigError`` if there is none, or it cannot be moved.
    """
    _read(file)  # refuses files that are not ours
    folder = file.parent / _DELETED
    with user_storage.locked(folder / file.name):
        kept = sorted((k, each) for each in folder.glob("*.json") if (k := _number(each.stem)))
        kept_as = f"{kept[-1][0] + 1 if kept else 1} {file.stem}"
        _move(file, folder / f"{kept_as}.json")
        for _, each in kept[: max(len(kept) + 1 - KEPT, 0)]:
            each.unlink(missing_ok=True)
    return kept_as


def restore(folder: Path, kept_as: str) -> Path:
    """Put a path that was set aside back under its name; returns its file.

    ``ConfigError`` if it is not kept, another path has that name now, or it cannot be moved.
    """
    reason = f"is gone; only the last {KEPT} deleted paths are kept"
    if not _number(kept_as):
        raise ConfigError("kept_as", kept_as, reason)
    file = file_of(folder, kept_as.partition(" ")[2])
    kept = folder / _DELETED / f"{kept_as}.json"
    with user_storage.locked(kept):
        if not kept.exists():
            raise ConfigError("kept_as", kept_as, reason)
        refuse_taken(file)
        _move(kept, file)
    return file


def _number(kept_as: str) -> int:
    """The number that a path is kept with; 0 if it has none."""
    number, _, name = kept_as.partition(" ")
    return int(number) if name and re.fullmatch("[1-9][0-9]{0,8}", number) else 0


def _move(file: Path, to: Path) -> None:
    try:
        file.rename(to)
    except OSError as error:
        raise ConfigError("path", str(file), f"cannot be moved: {error.strerror}") from error


def _read(file: Path) -> SavedPath:
    if not file.exists():
        names = ", ".join(sorted(each.stem for each in file.parent.glob("*.json")))
        hint = f"; there are: {names}" if names else ""
        raise ConfigError("path", str(file), f"there is no such path{hint}")
    content = user_storage.read(
        file,
        schema=SCHEMA,
        largest=user_storage.LARGEST_OF_ALL,
        also=(user_storage.with_zeros(SCHEMA),),
    )
    return SavedPath(
        name=file.stem,
        path=_understood(content),
        recorded_at=str(content.get("recorded_at", "")),
        zeros=zeros_from(content),
    )


def _understood(content: Mapping[str, object]) -> GuidedPath:
    joints = content.get("joints")
    if joints != list(ARM_JOINTS):
        raise ConfigError("joints", joints, f"must be {', '.join(ARM_JOINTS)}, in this order")
    jaw = _numbers(content, "aperture_percent") if "aperture_percent" in content else None
    try:
        return GuidedPath(
            t=_numbers(content, "time_s"),
            q=to_rad(_numbers(content, "q_deg")),
            aperture=None if jaw is None else jaw / 100.0,
        )
    except ValueError as error:
        raise ConfigError("path", "...", str(error)) from error


def _numbers(content: Mapping[str, object], key: str) -> Array:
    try:
        return np.array(content.get(key), dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ConfigError(key, "...", "must be a list of numbers, of equal length") from error
