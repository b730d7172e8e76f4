"""Programs as JSON files, that people can read and programs can make.

A file looks like this::

    {
     "schema": "so101/program/1",
     "rounds": 3,
     "waypoints": [
      {"name": "aside", "q_deg": [40, -40, 35, 60, 0], "pass": true},
      {"name": "over the mug", "q_deg": [10, -40, 35, 60, 0], "aperture_percent": 80},
      {"name": "at the mug", "q_deg": [10, -20, 30, 70, 0], "aperture_percent": 0, "pause_s": 0.5}
     ]
    }

``"rounds": "endless"`` runs it until it is stopped; a jaw that is not named stays as it is. The arm
stops at each waypoint, but for those with ``"pass": true``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from so101_motion import user_files
from so101_motion.config import suggest
from so101_motion.errors import ConfigError
from so101_motion.program.waypoints import Program, Waypoint

SCHEMA = "so101/program/1"

_FILE_NAME = re.compile(r"\w[\w .-]*")
_ENDLESS = "endless"


def folder() -> Path:
    """Where the user's programs are.

    Raises:
        ConfigError: This user has no home.
    """
    return user_files.folder() / "programs"


def file_of(name: str) -> Path:
    """The file of the user's program ``name``, there or not.

    Raises:
        ConfigError: It cannot be the name of a file.
    """
    name = user_files.checked_name(name, what="program")
    if not _FILE_NAME.fullmatch(name):
        raise ConfigError(
            "program name", name, "must be letters, digits, spaces and _ . -, such as stack cubes"
        )
    return folder() / f"{name}.json"


def names() -> tuple[str, ...]:
    """The user's programs, by name."""
    return tuple(sorted(file.stem for file in folder().glob("*.json")))


def find(name: str) -> Path:
    """The file that is meant by the name of a program, or of a file.

    Raises:
        ConfigError: There is none; the message names the nearest program.
    """
    if Path(name).suffix == ".json" or Path(name).is_file():
        return Path(name)
    known = names()
    if name not in known:
        raise ConfigError(
            "program", name, f"is no program of yours and no file; {suggest(name, known)}"
        )
    return file_of(name)


def read(path: Path) -> Program:
    """The program in a file.

    Raises:
        ConfigError: It cannot be read, or something in it cannot be meant; the message names it.
    """
    content = user_files.read(path, schema=SCHEMA)
    _refuse_unknown(content, ("schema", "rounds", "waypoints"), "program")
    given = content.get("waypoints")
    if not isinstance(given, list):
        raise ConfigError("waypoints", given, "must be a list of waypoints")
    return Program(
        waypoints=tuple(_waypoint(number, each) for number, each in enumerate(given, 1)),
        rounds=_rounds(content.get("rounds", 1)),
    )


def write(program: Program, path: Path) -> None:
    """Save a program; its folder is made if need be.

    Raises:
        ConfigError: It cannot be written; what was there is as it was.
    """
    rounds = _ENDLESS if program.rounds is None else program.rounds
    waypoints = [_written(waypoint) for waypoint in program.waypoints]
    user_files.write(path, {"rounds": rounds, "waypoints": waypoints}, schema=SCHEMA)


def delete(name: str) -> None:
    """Remove the user's program ``name``.

    Raises:
        ConfigError: There is none, or it cannot be removed.
    """
    file = file_of(name)
    try:
        file.unlink()
    except OSError as error:
        raise ConfigError("program", name, f"cannot be removed: {error.strerror}") from error


def _rounds(given: object) -> int | None:
    if given == _ENDLESS:
        return None
    if isinstance(given, bool) or not isinstance(given, int):
        raise ConfigError("rounds", given, f'must be a whole number, or "{_ENDLESS}"')
    return given


def _written(waypoint: Waypoint) -> dict[str, object]:
    said: dict[str, object] = {
        "name": waypoint.name,
        "q_deg": user_files.joints_to_deg(waypoint.q),
    }
    if waypoint.aperture is not None:
        said["aperture_percent"] = round(100.0 * waypoint.aperture, 2)
    if waypoint.pause > 0.0:
        said["pause_s"] = waypoint.pause
    if waypoint.passes:
        said["pass"] = True
    return said


def _waypoint(number: int, given: object) -> Waypoint:
    key = f"waypoint {number}"
    if not isinstance(given, Mapping):
        raise ConfigError(key, given, 'must be {"name": ..., "q_deg": [...]}')
    _refuse_unknown(given, ("name", "q_deg", "aperture_percent", "pause_s", "pass"), key)
    aperture_percent = _number(given, "aperture_percent", key)
    try:
        return Waypoint(
            name=user_files.checked_name(given.get("name", key), what="waypoint"),
            q=user_files.joints_from_deg(given.get("q_deg"), key="q_deg"),
            aperture=None if aperture_percent is None else aperture_percent / 100.0,
            pause=_number(given, "pause_s", key) or 0.0,
            passes=_flag(given, "pass"),
        )
    except ConfigError as error:
        raise ConfigError(f"{key}: {error.key}", error.value, error.reason) from None


def _number(given: Mapping[str, object], name: str, key: str) -> float | None:
    value = given.get(name)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigError(f"{key}: {name}", value, "must be a number")
    return float(value)


def _flag(given: Mapping[str, object], name: str) -> bool:
    value = given.get(name, False)
    if not isinstance(value, bool):
        raise ConfigError(name, value, "must be true or false")
    return value


def _refuse_unknown(given: Mapping[str, object], known: tuple[str, ...], what: str) -> None:
    for name in given:
        if name not in known:
            raise ConfigError(what, name, f"has no such entry; {suggest(name, known)}")
