"""Read and save the identified servo figures of an arm: ``arm.servos.json`` beside its calibration.

Like the zeros they are not in the calibration itself, which other programs use as well. Earlier
versions are kept like those of calibrations (``versions.py``) and can be restored.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from so101_motion.calib.record import versions as history
from so101_motion.common.attributes import checked_number
from so101_motion.common.errors import CalibrationError, ConfigError
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_m, to_mm, to_rad
from so101_motion.drivers.servo_types import ServoFigures
from so101_motion.files import atomic, json_file

_ABOUT = "figures of each servo, as shares of its type's; see the documentation of this software"

_BOUNDS = {"torque": (0.3, 3.0), "friction": (0.0, 5.0), "dead_time": (0.0, 5.0)}
"""Smallest and largest share that is accepted. Chosen, generously."""

_MOST_PLAY_DEG = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HandLoad:
    """The load in the hand during the identification."""

    mass: float  # its mass [kg]
    com: tuple[float, float, float]  # its centre of mass in the tool frame [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoRecord:
    """The result of an identification."""

    at: str  # its time, as an ISO date and time with its zone
    volts: float  # the supply at that time [V]
    servos: Mapping[str, ServoFigures]  # figures by joint; joints may be missing
    load: HandLoad | None = None  # the load in the hand; None for an empty hand


def servos_path(path: Path) -> Path:
    return path.with_name(f"{path.stem}.servos.json")


def read(path: Path) -> ServoRecord | None:
    """Read the servo figures of the calibration at ``path``; None if there are none."""
    file = servos_path(path)
    return _parsed(json_file.read(file), file) if file.exists() else None


def read_file(file: Path) -> ServoRecord:
    return _parsed(json_file.read(file), file)


def save(path: Path, found: ServoRecord) -> Path:
    """Save the figures beside ``path``; joints that are missing keep theirs. Returns the file."""
    file = servos_path(path)
    with atomic.locked(path.parent):
        try:
            before = read(path)
        except CalibrationError:
            before = None
        known = dict(before.servos) if before else {}
        whole = ServoRecord(
            at=found.at, volts=found.volts, servos={**known, **found.servos}, load=found.load
        )
        if file.exists():
            history.keep(file, file.read_bytes(), None)
        data = _text(whole)
        atomic.write(file, data)
        history.keep(file, data, None)
    return file


def before(path: Path) -> ServoRecord | None:
    """What was found before the present figures were; None if nothing was.

    Restored figures follow what they once followed.
    """
    file = servos_path(path)
    kept = history.versions(file)
    now = file.read_bytes() if file.exists() else b""
    same = (i for i, each in enumerate(kept) if each.path.read_bytes() == now)
    for version in kept[next(same, -1) + 1 :]:
        try:
            return read_file(version.path)
        except CalibrationError:
            continue
    return None


def restore(path: Path) -> ServoRecord:
    file = servos_path(path)
    with atomic.locked(path.parent):
        now = file.read_bytes() if file.exists() else b""
        for version in history.versions(file):
            data, _ = history.contents(version.path)
            if data != now:
                found = _parsed(json_file.parse(data, str(version.path)), version.path)
                if now:
                    history.keep(file, now, None)
                atomic.write(file, data)
                return found
    raise CalibrationError(
        None, f"there is no earlier version of {file} that differs", "identify the arm again"
    )


def _text(record: ServoRecord) -> bytes:
    servos = {}
    for joint in ARM_JOINTS:
        if joint in record.servos:
            each = record.servos[joint]
            servos[joint] = {
                "torque": round(each.torque, 4),
                "friction": round(each.friction, 4),
                "dead_time": round(each.dead_time, 4),
                "play_deg": None if each.play is None else round(to_deg(each.play), 3),
            }
    load = record.load
    content = {
        "about": _ABOUT,
        "at": record.at,
        "volts": round(record.volts, 2),
        "servos": servos,
        "load": None
        if load is None
        else {
            "mass_kg": round(load.mass, 4),
            "com_mm": [round(to_mm(each), 2) for each in load.com],
        },
    }
    return json.dumps(content, indent=2).encode() + b"\n"


_AGAIN = "restore it, or identify the arm again"


def _parsed(content: object, file: Path) -> ServoRecord:
    if not isinstance(content, Mapping) or not isinstance(content.get("servos"), Mapping):
        raise CalibrationError(None, f'{file} holds no "servos"', "identify the arm again")
    load = content.get("load")
    try:
        return ServoRecord(
            at=str(content.get("at", "")),
            volts=checked_number("volts", content.get("volts"), lower=0.0, upper=30.0),
            servos={
                joint: _figures(joint, entry)
                for joint, entry in content["servos"].items()
                if joint in ARM_JOINTS
            },
            load=_load(load) if isinstance(load, Mapping) else None,
        )
    except ConfigError as error:
        raise CalibrationError(None, f"{file}: {error}", _AGAIN) from error


def _load(content: Mapping[str, object]) -> HandLoad:
    com = content.get("com_mm")
    if not isinstance(com, list) or len(com) != 3:
        raise ConfigError("com_mm", com, "must be three numbers")
    x, y, z = (checked_number("com_mm", each, lower=-1000.0, upper=1000.0) for each in com)
    mass = checked_number("mass_kg", content.get("mass_kg"), lower=-0.5, upper=5.0)
    return HandLoad(mass=mass, com=(to_m(x), to_m(y), to_m(z)))


def _figures(joint: str, entry: object) -> ServoFigures:
    if not isinstance(entry, Mapping):
        raise ConfigError(joint, entry, "must be an object")
    shares = {
        name: checked_number(f"{joint}.{name}", entry.get(name), lower=lower, upper=upper)
        for name, (lower, upper) in _BOUNDS.items()
    }
    play = entry.get("play_deg")
    if play is not None:
        most = _MOST_PLAY_DEG
        play = to_rad(checked_number(f"{joint}.play_deg", play, lower=0.0, upper=most))
    return ServoFigures(**shares, play=play)
