"""Read the metadata of a LeRobot data set, in versions 2.0, 2.1 and 3.

The path templates in ``info.json`` are untrusted text and are never filled in. Source: LeRobot
0.6.1, ``lerobot/datasets`` and ``scripts/convert_dataset_v21_to_v30.py``.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from so101_motion.common import git_lfs
from so101_motion.common.errors import ConfigError, quoted
from so101_motion.files import json_file

INFO, STATS = Path("meta/info.json"), Path("meta/stats.json")
EPISODES_2, EPISODE_STATS_2 = Path("meta/episodes.jsonl"), Path("meta/episodes_stats.jsonl")
EPISODES_3 = Path("meta/episodes")

UNITS = Path("meta/so101_units.json")
"""The file that declares the units in a data set of ours; LeRobot ignores it."""

CALIBRATION = "meta/so101_calibration{side}.json"
"""The calibration that those numbers were made with, an ordinary calibration file; of two arms with
``_left`` or ``_right`` before the suffix."""

LARGEST_INFO = 4_000_000  # of ``info.json`` [byte]; with a dozen cameras it has 10,000. Chosen.
LARGEST_LINES = 64_000_000  # of a ``.jsonl`` [byte]; with a thousand episodes it has 3 MB. Chosen.

OTHER_ARMS = ("koch", "omx", "moss", "aloha", "viperx", "openarm", "rebot", "hope_jr", "reachy2")
"""How LeRobot's robot types begin that have these joint names or similar ones, but other links,
zeros and travels than an SO-101."""

MOBILE = ("lekiwi", "xlerobot")  # robot types with SO-101 arms on a base, no table at their foot
MOST_FILES = 100_000  # most data files; version 2.1 has one for each episode. Chosen.
_LARGEST_POINTER = 1024  # [byte], by the specification of Git LFS
VERSIONS = ("v2.0", "v2.1", "v3.0")  # the known versions; a later v3 is read like v3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Feature:
    """A column of the data."""

    dtype: str  # LeRobot's: ``float32``, ``int64``, ``video``, ``image`` and others
    names: tuple[str, ...]  # names of its entries; empty if they have none


@dataclass(frozen=True, slots=True, kw_only=True)
class Metadata:
    """The metadata of a data set."""

    root: Path
    version: str  # such as ``"v2.1"``
    fps: float  # frames a second
    features: Mapping[str, Feature]  # the columns by name
    robot: str  # the robot type; empty if there is none
    episodes: int | None  # how many episodes there should be; None if it does not say
    frames: int | None  # how many frames; likewise
    info: Mapping[str, Any]  # all of ``info.json``

    @property
    def is_v3(self) -> bool:
        """Whether data files hold several episodes, and metadata is Parquet."""
        return self.version.startswith("v3")

    @property
    def is_mobile(self) -> bool:
        return self.robot.startswith(MOBILE)

    def data_files(self) -> tuple[Path, ...]:
        """The data files in the order of the episodes; ``ConfigError`` for none, or too many."""
        found = sorted(islice((self.root / "data").glob("*/*.parquet"), MOST_FILES + 1))
        if not found:
            reason = "holds no data files (data/*/*.parquet)"
            if self.episodes == 0:
                reason += ": its recording ended before an episode was saved"
            raise refusal(self.root, reason)
        if len(found) > MOST_FILES:
            raise refusal(self.root, f"holds more than {MOST_FILES} data files")
        return tuple(found)

    def lfs_pointers(self) -> tuple[Path, ...]:
        """The files whose data Git LFS has not downloaded; hidden folders are left out."""
        small = (
            path
            for path in sorted(self.root.glob("[!.]*/**/*"))
            if path.is_file() and path.stat().st_size < _LARGEST_POINTER
        )
        return tuple(path for path in small if is_lfs_pointer(path))


def is_lfs_pointer(path: Path) -> bool:
    """Whether a file only names the data that Git LFS would download."""
    with path.open("rb") as file:
        return git_lfs.is_pointer(file.read(40))


def why_broken(path: Path) -> str:
    """The reason for which a file that cannot be parsed is broken; empty if it is not known."""
    if is_lfs_pointer(path):
        return f"{git_lfs.POINTER}; {git_lfs.PULL}"
    with path.open("rb") as file:
        begin, size = file.read(4), file.seek(0, os.SEEK_END)
        file.seek(-min(4, size), os.SEEK_END)
        end = file.read()
    if not size:
        return "is empty: it was not written, or not downloaded"
    if begin == b"PAR1" and (size < 12 or end != b"PAR1"):
        return (
            "has no footer: the recording was ended before LeRobot finished the file (finalize),"
            " or the file was cut off; its frames cannot be read"
        )
    return ""


def refusal(path: Path, reason: str) -> ConfigError:
    return ConfigError("data set", str(path), reason)


def read_metadata(root: Path) -> Metadata:
    """Read ``meta/info.json``; ``ConfigError`` if it is not that of a known LeRobot data set."""
    if not (root / INFO).is_file():
        reason = "is no LeRobot data set: it has no meta/info.json"
        if not root.exists():
            reason = "is not there; give the folder that holds meta/ and data/"
        raise refusal(root, reason)
    info = read_object(root / INFO)
    version = info.get("codebase_version")
    if not isinstance(version, str) or not (version in VERSIONS or version.startswith("v3.")):
        known = ", ".join(VERSIONS)
        raise refusal(root, f"codebase_version is {quoted(version)}; known are {known}")
    fps = info.get("fps")
    if isinstance(fps, bool) or not isinstance(fps, (int, float)) or not 0.1 <= fps <= 1000.0:
        raise refusal(root, f"fps must be a number from 0.1 to 1000, not {quoted(fps)}")
    robot = info.get("robot_type")
    return Metadata(
        root=root,
        version=version,
        fps=float(fps),
        features=_features(root, info.get("features")),
        robot=robot[:80] if isinstance(robot, str) else "",
        episodes=_count(root, info, "total_episodes"),
        frames=_count(root, info, "total_frames"),
        info=info,
    )


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Read the JSON objects of a ``.jsonl`` file; ``ConfigError`` if they are not that."""
    lines = json_file.setting_bytes("data set", path, LARGEST_LINES).splitlines()
    return [_object(path, line, f"line {n}") for n, line in enumerate(lines, 1) if line.strip()]


def read_object(path: Path) -> dict[str, Any]:
    """Read the JSON object of a file; ``ConfigError`` if it is none, or too large."""
    return _object(path, json_file.setting_bytes("data set", path, LARGEST_INFO), "the file")


def _object(path: Path, data: bytes, what: str) -> dict[str, Any]:
    try:
        content = json_file.content(data)
    except ValueError as error:
        raise refusal(path, why_broken(path) or f"{what} {error}") from error
    if not isinstance(content, dict):
        raise refusal(path, f"{what} must be an object, not {quoted(content)}")
    return content


def _count(root: Path, info: Mapping[str, Any], key: str) -> int | None:
    value = info.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise refusal(root, f"{key} must be a number, not {quoted(value)}")
    if not math.isfinite(value) or not 0 <= value < 1e12:
        raise refusal(root, f"{key} cannot be {quoted(value)}")
    return int(value)


def _features(root: Path, content: object) -> dict[str, Feature]:
    if not isinstance(content, dict) or not content:
        raise refusal(root, f"features must be an object, not {quoted(content)}")
    return {str(name): _feature(root, str(name), entry) for name, entry in content.items()}


def _feature(root: Path, name: str, entry: object) -> Feature:
    if not isinstance(entry, dict) or not isinstance(entry.get("dtype"), str):
        raise refusal(root, f"feature {quoted(name)} must be an object with a dtype")
    names = entry.get("names")
    if isinstance(names, dict):  # as in {"motors": [...]}, the older form
        lists = [each for each in names.values() if isinstance(each, list)]
        names = lists[0] if len(lists) == 1 else None
    if not isinstance(names, list) or not all(isinstance(each, str) for each in names):
        names = []
    return Feature(dtype=entry["dtype"], names=tuple(names))
