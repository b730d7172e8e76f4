"""Find the calibration files on this computer.

In this order, likeliest first: this module's data directory; places where this package has saved
one for this user; the data and program folders of other modules (the published module saved into
its program folder, where a calibration from before an upgrade may still be); LeRobot's
folders; and kept copies of files that are gone.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from so101_motion.calib.record import lerobot, store
from so101_motion.calib.record import versions as history
from so101_motion.calib.record.record import JOINTS
from so101_motion.calib.record.store import Stored
from so101_motion.common.errors import CalibrationError
from so101_motion.files import json_file

_MOST = 200  # how many files are looked at in one place. Chosen; a home may hold anything


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundFile:
    """A file that looks like a calibration of an SO-101."""

    path: Path  # where it is, absolute
    # ``"module data"``, ``"saved"`` (by this package, anywhere), ``"module folder"``, ``"LeRobot"``
    # or ``"kept copy"``
    origin: str
    role: str  # ``"follower"``, ``"leader"`` or ``"unknown"``, by the folder that LeRobot has it in
    # name of the arm: the file's name without its ending; for a kept copy, the path of the file
    # that is gone
    name: str
    stored: Stored | None  # its content; None when it cannot be used
    problem: str  # why it cannot be used; empty when it can


def find() -> tuple[FoundFile, ...]:
    """Find all calibration files where programs for this arm put them, the likeliest first.

    Nothing is written or restored, and files that are no calibration are left out.
    """
    found: dict[Path, FoundFile] = {}
    for origin, role, paths in _places():
        for path in islice(paths, _MOST):
            if path not in found and (one := _found(path, origin, role)) is not None:
                found[path] = one
    for path, gone in _kept_copies():
        if (one := _found(path, "kept copy", "unknown", str(gone))) is not None:
            found[path] = one
    return tuple(found.values())


def _places() -> Iterator[tuple[str, str, Iterable[Path]]]:
    """Origin, role and files of each place; the files are searched when they are iterated."""
    data = os.environ.get("VIAM_MODULE_DATA")
    if data:
        yield "module data", "unknown", _files(Path(data), "*.json")
    yield "saved", "unknown", (path for _, path in _kept() if os.path.exists(path))
    home = _home()
    viam = Path(os.environ.get("VIAM_HOME") or (home / ".viam" if home else "/root/.viam"))
    yield "module data", "unknown", _files(viam / "module-data", "*/*/*.json")
    yield "module folder", "unknown", _files(Path.cwd(), "*.json")
    yield "module folder", "unknown", _files(viam / "packages" / "data" / "module", "*/*.json")
    yield "module folder", "unknown", _files(Path("/tmp"), "*calibration*.json")
    if home is None:
        return
    base = lerobot.folder()
    for role, group, kinds in (
        ("follower", "robots", (*lerobot.FOLLOWERS, *lerobot.MOBILE)),
        ("leader", "teleoperators", lerobot.LEADERS),
    ):
        for kind in kinds:
            yield "LeRobot", role, _files(base / group / kind, "*.json")


def _home() -> Path | None:
    try:
        return Path.home()
    except RuntimeError:
        return None


def _files(folder: Path, pattern: str) -> Iterator[Path]:
    try:
        yield from sorted(path.resolve() for path in folder.glob(pattern))
    except OSError:
        return


def _kept_copies() -> Iterator[tuple[Path, Path]]:
    for folder, path in _kept():
        versions = history.listed(folder)
        if versions and not path.exists():
            yield versions[0].path, path


def _kept() -> Iterator[tuple[Path, Path]]:
    """Where versions of a file are kept, and that file, there or gone."""
    try:
        folders = sorted(history.root().iterdir())
    except OSError:
        return
    for folder in folders:
        path = history.subject(folder)
        if path is not None:
            yield folder, path


def _found(path: Path, origin: str, role: str, name: str = "") -> FoundFile | None:
    stored, problem = None, ""
    try:
        if not _is_about_joints(path):
            return None
        stored = store.read(path)
    except CalibrationError as error:
        problem = str(error)
    return FoundFile(
        path=path,
        origin=origin,
        role=role,
        name=name or path.stem,
        stored=stored,
        problem=problem,
    )


def _is_about_joints(path: Path) -> bool:
    """Whether the file is meant as a calibration; other files must not cause complaints."""
    try:
        content = json_file.read(path)
    except CalibrationError:
        return False
    if not isinstance(content, dict) or path.name.endswith(".zero.json"):
        return False
    return any(str(name).endswith(JOINTS) for name in content)
