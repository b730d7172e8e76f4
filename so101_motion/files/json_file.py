"""Read JSON files strictly, those of a calibration above all: no huge or deep ones, no devices.

The standard parser also drops the first of two values with the same name; ``Object`` remembers such
names, so that the reader of the file can refuse them. ``NaN`` and ``Infinity`` are parsed; the
reader of the field refuses them, because it can name the field.
"""

from __future__ import annotations

import json
import stat
from pathlib import Path

from so101_motion.common import git_lfs
from so101_motion.common.errors import CalibrationError, ConfigError, quoted

LARGEST = 65_536  # Largest file that is read [byte]; a calibration has about 1000 bytes. Chosen.


class Object(dict[str, object]):
    """A JSON object that remembers which of its names were given more than once."""

    repeated: tuple[str, ...] = ()  # those names

    @classmethod
    def of_pairs(cls, pairs: list[tuple[str, object]]) -> Object:
        made = cls(pairs)
        if len(made) < len(pairs):
            names = [name for name, _ in pairs]
            made.repeated = tuple(name for name in made if names.count(name) > 1)
        return made


def read(path: Path) -> object:
    """Read and parse a calibration file, or one beside it; ``CalibrationError`` if that fails."""
    return parse(read_bytes(path), str(path))


def read_bytes(path: Path) -> bytes:
    """Read the bytes of a small file; ``CalibrationError`` if it is none, or cannot be read."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise CalibrationError(None, f"{path} is not a file", "name a calibration file")
        with path.open("rb") as file:
            data = file.read(LARGEST + 1)
    except OSError as error:
        reason = f"{path} cannot be read: {error.strerror or error}"
        raise CalibrationError(None, reason, "check the path and its permissions") from error
    except ValueError as error:  # a zero byte in the name
        reason = f"{quoted(path)} is not a file name: {error}"
        raise CalibrationError(None, reason, "check it") from error
    if len(data) > LARGEST:
        reason = f"{path} is larger than a calibration can be ({LARGEST} bytes)"
        raise CalibrationError(None, reason, "check the path")
    return data


def parse(data: bytes, name: str) -> object:
    """Parse a calibration; ``CalibrationError``, with its ``name``, if it is no JSON."""
    if git_lfs.is_pointer(data):
        raise CalibrationError(None, f"{name} {git_lfs.POINTER}", git_lfs.PULL)
    try:
        return content(data)
    except ValueError as error:
        step = "restore it, or calibrate the arm again"
        raise CalibrationError(None, f"{name} {error}", step) from error


def read_setting(what: str, path: Path, largest: int) -> object:
    """Read and parse the file of a setting.

    Raises:
        ConfigError: It is not there, cannot be read, is larger than ``largest`` bytes or no JSON;
            the message calls it ``what``.
    """
    data = setting_bytes(what, path, largest)
    try:
        return content(data)
    except ValueError as error:
        raise ConfigError(what, str(path), str(error)) from error


def setting_bytes(what: str, path: Path, largest: int) -> bytes:
    """The bytes of a file; ``ConfigError`` if it cannot be read, or has more than ``largest``."""
    try:
        size = path.stat().st_size
        data = path.read_bytes() if size <= largest else b""
    except OSError as error:
        raise ConfigError(what, str(path), f"cannot be read: {error.strerror}") from error
    if size > largest:
        reason = f"has {size} bytes, more than the {largest} that are read"
        raise ConfigError(what, str(path), reason)
    return data


def content(data: bytes) -> object:
    """Parse JSON in UTF-8, UTF-16 or UTF-32, of ``Object``; ``ValueError`` if it is none."""
    if git_lfs.is_pointer(data):
        raise ValueError(f"{git_lfs.POINTER}; {git_lfs.PULL}")
    try:
        text = data.decode(json.detect_encoding(data))
        parsed: object = json.loads(text, object_pairs_hook=Object.of_pairs)
    except RecursionError as error:
        raise ValueError("is not JSON that is read: nested too deeply") from error
    except ValueError as error:
        raise ValueError(f"is not JSON: {error}") from error
    return parsed
