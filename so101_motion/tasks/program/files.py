"""Save and load programs as JSON files; ``docs/cell.md`` has an example.

A program of one arm names it ``"arm"``. Files of before are read as well: those of one arm had
``"waypoints"``, and its ``"encoder_zeros"`` beside them; those of several had another schema.
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
    ARM,
    LONGEST_PAUSE,
    MOST,
    SLOWEST,
    Program,
    Step,
    Waypoint,
    nameless,
)

SCHEMA = "so101/program/3"
OLDER = tuple(f"so101/{kind}/{number}" for kind in ("program", "cell-program") for number in (1, 2))
"""The schemas of before, for one arm and for several; 2 had zeros."""

ENTRIES = ("schema", "rounds", "loops", "steps", "waypoints")
"""The entries of a program, with those of before."""

ZerosOfArms = Mapping[str, EncoderZeros | None]  # of the arms' calibrations; None if not known

_FILE_NAME = re.compile(r"\w[\w .-]*")
_ENDLESS = "endless"
_FIGURES = ("aperture_percent", "pause_s", "speed_percent")


def folder() -> Path:
    return user_storage.folder() / "programs"


def cell_folder() -> Path:
    return user_storage.folder() / "cell_programs"


def file_of(name: str, in_folder: Path | None = None) -> Path:
    """The file of the user's program ``name``, existing or not; by default in ``folder``."""
    name = user_storage.checked_name(name, what="program")
    if not _FILE_NAME.fullmatch(name):
        raise ConfigError(
            "program name", name, "must be letters, digits, spaces and _ . -, such as stack cubes"
        )
    user_storage.refuse_reserved(name, what="program name")
    return (in_folder or folder()) / f"{name}.json"


def names(in_folder: Path | None = None) -> tuple[str, ...]:
    return tuple(sorted(file.stem for file in (in_folder or folder()).glob("*.json")))


def find(name: str) -> Path:
    """Find a program's file by the program's name, or by the file's own path."""
    if Path(name).suffix == ".json" or Path(name).is_file():
        return Path(name)
    known = names()
    if name not in known:
        raise ConfigError(
            "program", name, f"is neither a saved program nor a .json file; {_offer(name, known)}"
        )
    return file_of(name)


def _offer(name: str, known: tuple[str, ...]) -> str:
    none = "none is saved; save one on the Program tab of so101 view"
    return suggest(name, known) if known else none


def read(path: Path, arms: ZerosOfArms | None = None) -> Program:
    """Read a program, converted to the zeros of the arms that are to run it, if they are given.

    Then a program of one arm runs on the only one there is, whatever it is called. ``ConfigError``
    names what is not valid, or that the zeros are another arm's (``encoder_zeros.shift``).
    """
    largest = user_storage.LARGEST_OF_ALL
    content = user_storage.read(path, schema=SCHEMA, also=OLDER, largest=largest)
    program, made_with = program_from(content), _zeros_from(content)
    if arms is None:
        return program
    now = arms
    if len(arms) == 1 and len(program.arms) == 1:
        now = dict(zip(program.arms, arms.values(), strict=True))
    off = {}
    for name in program.arms:
        what, entry = f"the program {path.stem}", "" if name == ARM else name
        what += f", {entry}" if entry else ""
        off[name] = shift(made_with.get(name), now.get(name), what=what, file=path, name=entry)
    moved = (
        {name: replace(each, q=each.q + off[name]) for name, each in step.items()}
        for step in program.steps
    )
    return replace(program, steps=tuple(moved)).on(arms)


def program_from(content: Mapping[str, object]) -> Program:
    """Make a program from the parsed JSON of a file; ``ConfigError`` names what is not valid."""
    Attributes(content, (*ENTRIES, "arms", KEY), kind="entry of a program")
    key = "waypoints" if "waypoints" in content else "steps"
    given = content.get(key)
    if not isinstance(given, list):
        raise ConfigError(key, given, f"must be a list of {key}")
    if key == "waypoints" and "steps" in content:
        raise ConfigError(key, "...", 'and "steps" are the same; leave one out')
    steps = [{ARM: each} for each in given] if key == "waypoints" else given
    return Program(
        steps=tuple(_step(number, each) for number, each in enumerate(steps, 1)),
        rounds=rounds_from(content.get("rounds", 1)),
        loops=loops_from(content.get("loops", [])),
    )


def _step(number: int, content: object) -> Step:
    if not isinstance(content, Mapping):
        raise ConfigError(f"step {number}", content, 'must be {"left": {"q_deg": [...]}, ...}')
    return {
        str(name): waypoint_from(nameless(number, name), each) for name, each in content.items()
    }


def _zeros_from(content: Mapping[str, object]) -> ZerosOfArms:
    """The zeros that a program was made with; those of one arm were not in ``arms`` before."""
    given = content.get("arms", {})
    if not isinstance(given, Mapping):
        raise ConfigError("arms", given, 'must be {"left": {"encoder_zeros": ...}, ...}')
    listed = {ARM: content, **given} if KEY in content else given
    return {
        str(name): zeros_from(each) for name, each in listed.items() if isinstance(each, Mapping)
    }


def write(program: Program, path: Path, arms: ZerosOfArms | None = None) -> None:
    """Save a program with the zeros of its arms, if known; makes its folder if need be."""
    zeros = {name: zeros_to(each) for name, each in (arms or {}).items()}
    known = {name: each for name, each in zeros.items() if each}
    content = program_to(program) | ({"arms": known} if known else {})
    user_storage.write(path, content, schema=SCHEMA)


def program_to(program: Program) -> dict[str, object]:
    steps = [{name: waypoint_to(each) for name, each in step.items()} for step in program.steps]
    loops = {"loops": loops_to(program.loops)} if program.loops else {}
    return {"rounds": rounds_to(program.rounds), **loops, "steps": steps}


def loops_to(loops: Iterable[Loop]) -> list[dict[str, int]]:
    """Loops as JSON values, their steps counted from 1."""
    return [{"from": each.first + 1, "to": each.last + 1, "times": each.times} for each in loops]


def loops_from(given: object) -> tuple[Loop, ...]:
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
    """Delete the user's program ``name``; ``ConfigError`` if there is none."""
    file = file_of(name, in_folder)
    try:
        file.unlink()
    except OSError as error:
        raise ConfigError("program", name, f"cannot be removed: {error.strerror}") from error


def rounds_to(rounds: int | None) -> int | str:
    return _ENDLESS if rounds is None else rounds


def rounds_from(given: object) -> int | None:
    if given == _ENDLESS:
        return None
    if isinstance(given, bool) or not isinstance(given, (int, float)):
        raise ConfigError("rounds", given, f'must be a whole number, or "{_ENDLESS}"')
    return checked_count("rounds", given)  # Viam's requests have no whole numbers


def waypoint_to(waypoint: Waypoint) -> dict[str, object]:
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
    if waypoint.item is not None:
        content |= {"item": waypoint.item} | ({"place": waypoint.place} if waypoint.place else {})
    if waypoint.speed < 1.0:
        content["speed_percent"] = round(100.0 * waypoint.speed, 2)
    return content


def waypoint_from(what: str, content: object) -> Waypoint:
    """A waypoint from the parsed JSON of a file, called ``what`` in messages and by default."""
    if not isinstance(content, Mapping):
        raise ConfigError(what, content, 'must be {"name": ..., "q_deg": [...]}')
    try:
        given = Attributes(
            content,
            ("name", "q_deg", "pass", "item", "place", *_FIGURES),
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
            item=given.text("item", "") or None,
            place=given.text("place", ""),
        )
    except ConfigError as error:
        raise ConfigError(f"{what}: {error.key}", error.value, error.reason) from None
