"""Save and load programs as JSON files.

A file looks like this::

    {
     "schema": "so101/program/1",
     "rounds": 3,
     "waypoints": [
      {"name": "aside", "q_deg": [40, -40, 35, 60, 0], "pass": true},
      {"name": "over the mug", "q_deg": [10, -40, 35, 60, 0], "aperture_percent": 80},
      {"name": "at the mug", "q_deg": [10, -20, 30, 70, 0], "aperture_percent": 0,
       "pause_s": 0.5, "speed_percent": 40}
     ]
    }

``"loops": [{"from": 2, "to": 3, "times": 4}]`` repeats the second and third waypoint four times
before the program goes on; a loop may lie inside one other. ``"rounds": "endless"`` runs it until
it is stopped; without ``aperture_percent`` the jaw stays as it is. The arm stops at each waypoint
except those with ``"pass": true``. ``"speed_percent"`` slows down the step to a waypoint.
``"encoder_zeros"``, in schema 2, are the zeros of the arm's calibration (``encoder_zeros.py``).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from so101_motion.common.attributes import Attributes, suggest
from so101_motion.common.encoder_zeros import KEY, EncoderZeros, shift, zeros_from, zeros_to
from so101_motion.common.errors import ConfigError
from so101_motion.files import user_storage
from so101_motion.tasks.program.loops import Loop, checked_count
from so101_motion.tasks.program.program import (
    LONGEST_PAUSE,
    MOST,
    SLOWEST,
    Program,
    Waypoint,
)

SCHEMA = "so101/program/1"

_FILE_NAME = re.compile(r"\w[\w .-]*")
_ENDLESS = "endless"


def folder() -> Path:
    """The folder of the user's programs.

    Raises:
        ConfigError: This user has no home.
    """
    return user_storage.folder() / "programs"


def file_of(name: str, in_folder: Path | None = None) -> Path:
    """The file of the user's program ``name``, existing or not.

    Args:
        name: Name of the program.
        in_folder: The folder; that of the programs of one arm if not given.

    Raises:
        ConfigError: It cannot be the name of a file.
    """
    name = user_storage.checked_name(name, what="program")
    if not _FILE_NAME.fullmatch(name):
        raise ConfigError(
            "program name", name, "must be letters, digits, spaces and _ . -, such as stack cubes"
        )
    user_storage.refuse_reserved(name, what="program name")
    return (in_folder or folder()) / f"{name}.json"


def names(in_folder: Path | None = None) -> tuple[str, ...]:
    """List the user's programs by name; ``in_folder`` as in ``file_of``."""
    return tuple(sorted(file.stem for file in (in_folder or folder()).glob("*.json")))


def find(name: str) -> Path:
    """Find a program's file by the program's name, or by the file's own path.

    Raises:
        ConfigError: There is none; the message names the nearest program.
    """
    if Path(name).suffix == ".json" or Path(name).is_file():
        return Path(name)
    known = names()
    if name not in known:
        raise ConfigError(
            "program", name, f"is neither a saved program nor a .json file; {_offer(name, known)}"
        )
    return file_of(name)


def _offer(name: str, known: tuple[str, ...]) -> str:
    return suggest(name, known) if known else "save one on the Program tab of so101 view"


def read(path: Path, zeros: EncoderZeros | None = None) -> Program:
    """Read the program in a file, and convert it to the zeros of the arm that is to run it.

    Raises:
        ConfigError: It cannot be read, something in it is not valid, or the zeros are another
            arm's; see ``encoder_zeros.shift``.
    """
    content = user_storage.read(path, schema=SCHEMA, zeros=True)
    program = program_from(content)
    off = shift(zeros_from(content), zeros, what=f"the program {path.stem}", file=path)
    moved = (replace(each, q=each.q + off) for each in program.waypoints)
    return replace(program, waypoints=tuple(moved)) if off.any() else program


def program_from(content: Mapping[str, object]) -> Program:
    """Make a program from the parsed JSON of a file.

    Raises:
        ConfigError: Something in it is not valid; the message names it.
    """
    Attributes(content, ("schema", "rounds", "loops", "waypoints", KEY), kind="entry of a program")
    given = content.get("waypoints")
    if not isinstance(given, list):
        raise ConfigError("waypoints", given, "must be a list of waypoints")
    return Program(
        waypoints=tuple(
            waypoint_from(f"waypoint {number}", each) for number, each in enumerate(given, 1)
        ),
        rounds=rounds_from(content.get("rounds", 1)),
        loops=loops_from(content.get("loops", [])),
    )


def write(program: Program, path: Path, zeros: EncoderZeros | None = None) -> None:
    """Save a program with the zeros of its arm, if known; makes its folder if need be.

    Raises:
        ConfigError: It cannot be written; an existing file is unchanged.
    """
    known = zeros_to(zeros)
    schema = user_storage.with_zeros(SCHEMA) if known else SCHEMA
    user_storage.write(path, program_to(program) | known, schema=schema)


def program_to(program: Program) -> dict[str, object]:
    """A program as JSON values; ``program_from`` reads them back."""
    waypoints = [waypoint_to(waypoint) for waypoint in program.waypoints]
    loops = {"loops": loops_to(program.loops)} if program.loops else {}
    return {"rounds": rounds_to(program.rounds), **loops, "waypoints": waypoints}


def loops_to(loops: Iterable[Loop]) -> list[dict[str, int]]:
    """Loops as JSON values, their steps counted from 1."""
    return [{"from": each.first + 1, "to": each.last + 1, "times": each.times} for each in loops]


def loops_from(given: object) -> tuple[Loop, ...]:
    """Loops from a JSON value."""
    if not isinstance(given, list):
        raise ConfigError(
            "loops", given, 'must be a list such as [{"from": 2, "to": 3, "times": 4}]'
        )
    return tuple(_loop_from(f"loop {number}", each) for number, each in enumerate(given, 1))


def _loop_from(what: str, content: object) -> Loop:
    if not isinstance(content, Mapping):
        raise ConfigError(what, content, 'must be {"from": ..., "to": ..., "times": ...}')
    try:
        Attributes(content, ("from", "to", "times"), kind="entry")
        first, last = (
            checked_count(key, content.get(key), upper=MOST, unit="") for key in ("from", "to")
        )
        times = checked_count("times", content.get("times"), lower=2)
        return Loop(first=first - 1, last=last - 1, times=times)
    except ConfigError as error:
        raise ConfigError(f"{what}: {error.key}", error.value, error.reason) from None


def delete(name: str, in_folder: Path | None = None) -> None:
    """Delete the user's program ``name``; ``in_folder`` as in ``file_of``.

    Raises:
        ConfigError: There is none, or it cannot be removed.
    """
    file = file_of(name, in_folder)
    try:
        file.unlink()
    except OSError as error:
        raise ConfigError("program", name, f"cannot be removed: {error.strerror}") from error


def rounds_to(rounds: int | None) -> int | str:
    """A number of rounds as a JSON value."""
    return _ENDLESS if rounds is None else rounds


def rounds_from(given: object) -> int | None:
    """A number of rounds from a JSON value; None for endless."""
    if given == _ENDLESS:
        return None
    if isinstance(given, bool) or not isinstance(given, (int, float)):
        raise ConfigError("rounds", given, f'must be a whole number, or "{_ENDLESS}"')
    return checked_count("rounds", given)  # Viam's requests have no whole numbers


def waypoint_to(waypoint: Waypoint) -> dict[str, object]:
    """A waypoint as JSON values; ``waypoint_from`` reads them back."""
    content: dict[str, object] = {
        "name": waypoint.name,
        "q_deg": user_storage.joints_to_deg(waypoint.q),
    }
    if waypoint.aperture is not None:
        content["aperture_percent"] = round(100.0 * waypoint.aperture, 2)
    if waypoint.pause > 0.0:
        content["pause_s"] = waypoint.pause
    if waypoint.passes:
        content["pass"] = True
    if waypoint.speed < 1.0:
        content["speed_percent"] = round(100.0 * waypoint.speed, 2)
    return content


def waypoint_from(what: str, content: object) -> Waypoint:
    """A waypoint from the parsed JSON of a file.

    Args:
        what: Its name in messages, and by default.
        content: As ``json`` reads it.

    Raises:
        ConfigError: Something in it is not valid.
    """
    if not isinstance(content, Mapping):
        raise ConfigError(what, content, 'must be {"name": ..., "q_deg": [...]}')
    try:
        given = Attributes(
            content,
            ("name", "q_deg", "aperture_percent", "pause_s", "pass", "speed_percent"),
            kind="entry",
        )
        aperture = given.number("aperture_percent", -1.0, lower=0.0, upper=100.0, unit="%")
        slowest = 100.0 * SLOWEST
        speed = given.number("speed_percent", 100.0, lower=slowest, upper=100.0, unit="%")
        return Waypoint(
            name=user_storage.checked_name(content.get("name", what), what="waypoint"),
            q=user_storage.joints_from_deg(content.get("q_deg"), key="q_deg"),
            aperture=aperture / 100.0 if given.given("aperture_percent") else None,
            pause=given.number("pause_s", 0.0, lower=0.0, upper=LONGEST_PAUSE, unit="s"),
            passes=given.flag("pass", False),
            speed=speed / 100.0,
        )
    except ConfigError as error:
        raise ConfigError(f"{what}: {error.key}", error.value, error.reason) from None
