"""Read and write the user's own small JSON files: poses, programs, guided paths.

They are in the data directory of the user who runs the program and begin with a ``"schema"`` that
says what they are and in which version. They are written in one step, so a crash never leaves half
a file. People can read them: degrees, percent, seconds, with the unit in every name.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from so101_motion.common.encoder_zeros import KEY
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_deg, to_rad
from so101_motion.files import atomic, json_file
from so101_motion.files.json_file import Object

LARGEST = 1_000_000
"""Largest file that is read [byte]. Chosen."""

LARGEST_OF_ALL = 20_000_000
"""The same for guided paths and programs; the longest recording has a fifth of that."""

LONGEST_NAME = 40
"""Most characters of a name that a user gives; chosen, it fits on a button."""

_KINDS = tuple(
    f"so101/{kind}/{number}"
    for kind in ("poses", "program", "cell-program", "guided-path")
    for number in (1, 2, 3)
)
"""The schemas of files that may have zeros."""

_WIDEST_DEG = 360.0
"""Larger joint angles in a file are refused [deg]."""


def folder() -> Path:
    """The folder of the user's files.

    Raises:
        ConfigError: This user has no home.
    """
    try:
        return user_data_folder() / "so101_motion"
    except OSError as error:
        raise ConfigError("home", None, f"this user has no folder for files: {error}") from error


def remove_old_leftovers() -> None:
    """Remove old temporary files that killed writers left among the user's files."""
    with suppress(ConfigError):  # no home, nothing to remove
        home = folder()
        for each in (home, *(inner for inner in home.glob("*") if inner.is_dir())):
            atomic.remove_old_leftovers(each)


def checked_name(name: object, *, what: str) -> str:
    """Check a name and strip the blanks around it.

    Args:
        name: The name as typed or as read from a file.
        what: What it names, such as ``"pose"``.

    Raises:
        ConfigError: Empty, too long, or not printable.
    """
    short = name.strip() if isinstance(name, str) else ""
    if not short:
        raise ConfigError(f"{what} name", name, "type a name first")
    if len(short) > LONGEST_NAME:
        raise ConfigError(f"{what} name", short, f"is longer than {LONGEST_NAME} characters")
    if not short.isprintable():
        raise ConfigError(f"{what} name", short, "has characters that cannot be shown")
    return short


_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)\s*(\..*)?", re.IGNORECASE)


def refuse_reserved(name: str, *, what: str) -> None:
    """Refuse names that Windows reserves or cuts short, so that files can be copied there.

    Raises:
        ConfigError: No file can be called that.
    """
    if _RESERVED.fullmatch(name) or name[-1:] in (" ", "."):
        raise ConfigError(what, name, "cannot be the name of a file on Windows; choose another")


def with_zeros(schema: str) -> str:
    """The schema of a file whose joint angles are kept with the zeros of their calibration."""
    return f"{schema.rpartition('/')[0]}/2"


def read(
    path: Path, *, schema: str, also: Collection[str] = (), largest: int = LARGEST
) -> Mapping[str, object]:
    """Read the JSON object in the file at ``path``.

    Args:
        path: The file.
        schema: What it must be, such as ``"so101/poses/1"``.
        also: What else it may be, such as that of before.
        largest: Largest file that is read [byte].

    Raises:
        ConfigError: It is not there, cannot be read, or is something else.
    """
    what = _kind(schema)
    try:
        if path.stat().st_size > largest:
            raise ConfigError(what, str(path), f"is larger than a file of {what} can be")
        found = json_file.content(path.read_bytes())
    except OSError as error:
        raise ConfigError(what, str(path), f"cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ConfigError(what, str(path), str(error)) from error
    content = found if isinstance(found, Object) else Object()
    written = content.get("schema")
    if written == schema or written in also:
        if content.repeated:
            raise ConfigError(what, str(path), f"has {', '.join(content.repeated)} twice")
        return dict(content)
    if isinstance(written, str) and written.startswith(schema.rpartition("/")[0]):
        reason = f"is written as {written}, which this version cannot read; update it"
    else:
        reason = f'is not a file of {what}; its "schema" must be "{schema}"'
    raise ConfigError(what, str(path), reason)


def write(
    path: Path, content: Mapping[str, object], *, schema: str, indent: int | None = 1
) -> None:
    """Write ``content`` to the file at ``path``; makes its folder if needed.

    Raises:
        ConfigError: It cannot be written; the old content stays.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"schema": schema, **content}, indent=indent, ensure_ascii=False)
        atomic.write(path, f"{text}\n".encode())
    except OSError as error:
        reason = f"cannot be written: {error.strerror or error}"
        raise ConfigError(_kind(schema), str(path), reason) from error


def without_zeros(path: Path, name: str = "") -> int:
    """Remove the zeros from a file, so that its angles are used as they are.

    Args:
        path: A file of poses, of a program of one arm or several, or of a guided path.
        name: The only pose of a file of poses, or arm of a program, to remove them from.

    Returns:
        From how many entries they were removed.

    Raises:
        ConfigError: It cannot be read or written, or is something else.
    """
    removed = 0

    def bare(value: object, called: str) -> object:
        nonlocal removed
        if isinstance(value, list):
            return [bare(each, "") for each in value]
        if not isinstance(value, dict):
            return value
        if KEY in value and name in ("", called, value.get("name")):
            removed += 1
            value = {key: each for key, each in value.items() if key != KEY}
        return {key: bare(each, key) for key, each in value.items()}

    with locked(path):
        content = read(path, schema=_KINDS[0], also=_KINDS, largest=LARGEST_OF_ALL)
        kept, schema = bare(content, ""), str(content["schema"])
        if removed and isinstance(kept, dict):
            indent = None if "guided-path" in schema else 1
            write(path, kept, schema=schema, indent=indent)
    return removed


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Lock the folder of ``path``, so that the file can be read, changed and written back.

    Raises:
        ConfigError: The folder cannot be used.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic.locked(path.parent):
            yield
    except OSError as error:
        raise ConfigError(
            "folder", str(path.parent), f"cannot be used: {error.strerror or error}"
        ) from error


def joints_to_deg(q: Array) -> list[float]:
    """Joint angles in degrees, rounded to a ten-thousandth, as files hold them."""
    return [round(float(angle), 4) + 0.0 for angle in to_deg(q)]


def joints_from_deg(given: object, *, key: str) -> Array:
    """Joint angles from a file, shape (5,), [rad].

    Raises:
        ConfigError: Not five angles.
    """
    if (
        not isinstance(given, list)
        or len(given) != 5
        or not all(_is_number(each, _WIDEST_DEG) for each in given)
    ):
        raise ConfigError(key, given, "must be five joint angles in degrees")
    return np.asarray(to_rad(np.array(given, dtype=np.float64)))


def _is_number(value: object, largest: float) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= largest


def _kind(schema: str) -> str:
    return schema.split("/")[1].replace("-", " ")


def user_data_folder() -> Path:
    """The data folder of this user.

    Raises:
        OSError: This user has no home.
    """
    given = os.environ.get("XDG_DATA_HOME", "")
    if os.path.isabs(given):
        return Path(given)
    if sys.platform == "win32" and os.environ.get("LOCALAPPDATA"):
        return Path(os.environ["LOCALAPPDATA"])
    try:
        home = Path.home()
    except RuntimeError as error:
        raise OSError(str(error)) from error
    if sys.platform == "darwin":
        return home / "Library" / "Application Support"
    return home / ".local" / "share"
