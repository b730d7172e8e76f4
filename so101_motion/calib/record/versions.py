"""Keep earlier versions of calibration files where viam-server does not delete them.

viam-server removes a module's data directory when the module is missing from the configuration for
a moment, or fails to start once. So every calibration that is saved or used is kept a second time,
in the data directory of the user the program runs as, in a folder for each file:

    ~/.local/share/so101_motion/calibrations/arm-3f2a91c04b/
        of.txt                              path of the file
        0007_20260511T101112Z.json          its content, byte for byte
        0007_20260511T101112Z.zero.json     the content of its file of zeros

The last version is the second copy, the others are the backups. They are ordered by number, not by
time: a single-board computer without a battery starts in 1970.
"""

from __future__ import annotations

import hashlib
import os
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from so101_motion.files import atomic
from so101_motion.files.user_storage import user_data_folder

KEPT = 20  # how many versions of a file are kept; a version has about 1.5 kB. Chosen

_NAME = re.compile(r"(\d+)_(\d{8}T\d{6}Z)\.json")
_TIME = "%Y%m%dT%H%M%SZ"


@dataclass(frozen=True, slots=True, kw_only=True)
class Version:
    """An earlier content of a calibration file."""

    number: int  # counts up; the last version has the largest
    kept_at: datetime  # when it was kept
    path: Path  # its copy


def zero_path(path: Path) -> Path:
    return path.with_name(f"{path.stem}.zero.json")


def root() -> Path:
    """The folder with the versions of all files; OSError if this user has no home."""
    return user_data_folder() / "so101_motion" / "calibrations"


def folder(path: Path) -> Path:
    digest = hashlib.sha256(os.fsencode(path)).hexdigest()[:10]
    return root() / f"{path.stem[:40]}-{digest}"


def subject(kept: Path) -> Path | None:
    """The file whose versions the folder ``kept`` holds; None if it does not say."""
    try:
        return Path((kept / "of.txt").read_text(encoding="utf-8").strip())
    except (OSError, ValueError):
        return None


def versions(path: Path) -> tuple[Version, ...]:
    """The versions of the file at ``path``, the last first; empty if none can be kept."""
    try:
        return listed(folder(path))
    except OSError:
        return ()


def listed(kept: Path) -> tuple[Version, ...]:
    found = []
    for entry in kept.glob("*.json"):
        match = _NAME.fullmatch(entry.name)
        if match is not None:
            kept_at = datetime.strptime(match[2], _TIME).replace(tzinfo=UTC)
            found.append(Version(number=int(match[1]), kept_at=kept_at, path=entry))
    return tuple(sorted(found, key=lambda version: -version.number))


def keep(path: Path, data: bytes, zeros: bytes | None) -> Path:
    """Keep a content of the file at ``path``, unless the last version is the same; return it."""
    kept = folder(path)
    kept.mkdir(parents=True, exist_ok=True)
    with atomic.locked(kept):
        before = listed(kept)
        if before and contents(before[0].path) == (data, zeros):
            return before[0].path
        if not (kept / "of.txt").exists():
            atomic.write(kept / "of.txt", f"{path}\n".encode("utf-8", "surrogateescape"))
        number = before[0].number + 1 if before else 1
        copy = kept / f"{number:04d}_{datetime.now(UTC).strftime(_TIME)}.json"
        if zeros is not None:
            atomic.write(zero_path(copy), zeros)  # first: a version is there when its record is
        atomic.write(copy, data)
        for old in before[KEPT - 1 :]:
            old.path.unlink(missing_ok=True)
            zero_path(old.path).unlink(missing_ok=True)
    return copy


def contents(path: Path) -> tuple[bytes, bytes | None]:
    """Read a calibration file and the file of zeros beside it, byte for byte."""
    beside = zero_path(path)
    return path.read_bytes(), beside.read_bytes() if beside.is_file() else None
