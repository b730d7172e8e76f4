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
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from so101_motion.common.encoder_zeros import KEY
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_deg, to_rad
from so101_motion.files import atomic, json_file
from so101_motion.files.json_file import Object

LARGEST = 1_000_000  # Largest file that is read [byte]. Chosen.

LARGEST_OF_ALL = 20_000_000
"""The same for guided paths and programs; the longest recording has a fifth of that."""

LONGEST_NAME = 40  # most characters of a name that a user gives; chosen, it fits on a button

_KINDS = tuple(
    f"so101/{kind}/{number}"
    for kind in ("poses", "program", "cell-program", "guided-path")
    for number in (1, 2, 3)
)
"""The schemas of files that may have zeros."""

_WIDEST_DEG = 360.0  # larger joint angles in a file are refused [deg]


def folder() -> Path:
    """The folder of the user's files; ``ConfigError`` if this user has no home."""
    try:
        return user_data_folder() / "so101_motion"
    except OSError as error:
        raise ConfigError("home", None, f"this user has no folder for files: {error}") from error


def checked_name(name: object, *, what: str) -> str:
    """Strip the blanks around a name; refuse one that is empty, too long, or not printable."""
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
    """Refuse names that Windows reserves or cuts short, so that files can be copied there."""
    if _RESERVED.fullmatch(name) or name[-1:] in (" ", "."):
        raise ConfigError(what, name, "cannot be the name of a file on Windows; choose another")


def with_zeros(schema: str) -> str:
    """The schema of a file whose joint angles are kept with the zeros of their calibration."""
    return f"{schema.rpartition('/')[0]}/2"


def read(
    path: Path, *, schema: str, also: Collection[str] = (), largest: int = LARGEST
) -> Mapping[str, object]:
    """Read a JSON object with ``schema``, such as ``"so101/poses/1"``, or one of ``also``.

    Raises:
        ConfigError: It is not there, cannot be read, has more than ``largest`` bytes, or is
            something else.
    """
    what = _kind(schema)
    found = json_file.read_setting(what, path, largest)
    content = found if isinstance(found, Object) else Object()
    written = content.get("schema")
    if written == schema or written in also:
        if content.repeated:
            raise ConfigError(what, str(path), f"has {', '.join(content.repeated)} twice")
        return dict(content)
    if isinstance(written, str) and written.startswith(schema.rpartition("/")[0]):
        reason = f"is written as {written}, which this version cannot read; update it"
    else:
        reason = f'is not a {what} file; its "schema" must be "{schema}"'
    raise ConfigError(what, str(path), reason)


def write(
    path: Path, content: Mapping[str, object], *, schema: str, indent: int | None = 1
) -> None:
    """Write a JSON object, and its folder if needed; if it cannot be, the old content stays."""
    text = json.dumps({"schema": schema, **content}, indent=indent, ensure_ascii=False)
    atomic.save(_kind(schema), path, f"{text}\n".encode(), make_folder=True)


def without_zeros(path: Path, name: str = "") -> int:
    """Remove the zeros from a file, so that its angles are used as they are.

    Args:
        path: A file of poses, of a program of one arm or several, or of a guided path.
        name: The only pose of a file of poses, or arm of a program, to remove them from.

    Returns:
        From how many entries they were removed.
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
    """Lock the folder of ``path``, so that the file can be read, changed and written back."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic.locked(path.parent):
            yield
    except OSError as error:
        reason = f"cannot be used: {error.strerror or error}"
        raise ConfigError("folder", str(path.parent), reason) from error


def joints_to_deg(q: Array) -> list[float]:
    """Joint angles in degrees, rounded to a ten-thousandth, as files hold them."""
    return [round(float(angle), 4) + 0.0 for angle in to_deg(q)]


def joints_from_deg(given: object, *, key: str) -> Array:
    """Joint angles from a file, shape (5,), [rad]; ``ConfigError`` if they are not five."""
    listed = given if isinstance(given, list) else []
    if len(listed) != 5 or not all(
        type(each) in (int, float) and abs(each) <= _WIDEST_DEG for each in listed
    ):
        raise ConfigError(key, given, "must be five joint angles in degrees")
    return np.asarray(to_rad(np.array(listed, dtype=np.float64)))


def _kind(schema: str) -> str:
    return schema.split("/")[1].replace("-", " ")


def user_data_folder() -> Path:
    """The data folder of this user; ``OSError`` without a home."""
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
