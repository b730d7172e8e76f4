"""Files we write: their writer killed at every step, without room, in a read-only folder.

A reader finds the old content or the new, nothing else; writing again works; a writer that fails
raises an error of ours and leaves everything as it was. Of the files that are written in one step
by ``files/atomic.py`` the guided path stands for all.
"""

import contextlib
import itertools
import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from harness.dying import Death, no_room_beyond

from so101_motion.calib.record import store
from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.calib.record.zero import Zero
from so101_motion.common.errors import So101Error
from so101_motion.tasks.guided import GuidedPath
from so101_motion.tasks.guided import files as guided_files

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits the size of files")


@dataclass(frozen=True)
class Kept:
    """A kind of file.

    Attributes:
        name: What it holds.
        write: Writes one of the contents 0, 1, 2 ... to a folder.
        read: Tells which content is there.
        is_silent: Whether it may be lost without a word, for it can be done without.
    """

    name: str
    write: Any
    read: Any
    is_silent: bool = False


def _calibration(n):
    return {
        joint: JointCalibration(id=i, homing_offset=n, range_min=900 + n, range_max=3100 + n)
        for i, joint in enumerate(JOINTS, 1)
    }


def _save_calibration(folder, n):
    zeros = {"elbow_flex": Zero(by="stops", angle=n / 10)}
    store.save(folder / "arm.json", _calibration(n), zeros=zeros)


def _restore_calibration(folder, n):
    """The content 1 is brought back from the versions; all others are saved."""
    if n == 1:
        store.restore(folder / "arm.json")
        return
    for each in (1, 0) if n == 0 else (n,):
        _save_calibration(folder, each)


def _lose_and_load_calibration(folder, n):
    """For 1 the file is deleted, as viam-server does, and loading brings 0 back."""
    if n != 1:
        _save_calibration(folder, n)
        return
    with contextlib.suppress(PermissionError):
        for path in sorted(folder.glob("arm.*")):  # the file itself first
            path.unlink()
    store.load(folder / "arm.json")


def _load_calibration(folder):
    found = store.load(folder / "arm.json")
    numbers = {each.homing_offset for each in found.calibration.values()}
    numbers.add(round(10 * found.zeros["elbow_flex"].angle))
    return _one(numbers)


def _one(numbers):
    (number,) = numbers
    return number


def _number(q):
    return _one({round(100 * float(each)) for each in q})


def _write_guided(folder, n):
    q = np.full((300, 5), 0.01 * n)
    path = GuidedPath(t=np.arange(300) * 0.1, q=q, aperture=np.zeros(300))
    guided_files.write(path, folder / "path.json", replace=True)


def _read_guided(folder):
    read = guided_files.read(folder / "path.json")
    assert len(read.q) == 300
    return _one({_number(each) for each in read.q})


KINDS = (
    Kept("calibration", _save_calibration, _load_calibration),
    Kept("restored calibration", _restore_calibration, _load_calibration),
    Kept("deleted calibration", _lose_and_load_calibration, _load_calibration, is_silent=True),
    Kept("guided path", _write_guided, _read_guided),
)
each_kind = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)


@pytest.fixture
def fresh(kind, tmp_path, monkeypatch):
    """Makes folders with the old content in them."""
    numbers = itertools.count()

    def make():
        folder = tmp_path / f"{next(numbers)}"
        folder.mkdir()
        monkeypatch.setenv("VIAM_MODULE_DATA", str(folder))
        monkeypatch.setenv("XDG_DATA_HOME", str(folder / "home"))
        kind.write(folder, 0)
        return folder

    monkeypatch.setattr(os, "fsync", lambda _: None)  # no computer dies here
    return make


def leftovers(folder):
    return [str(path) for path in folder.rglob("*.tmp")]


@each_kind
def test_a_writer_that_is_killed_leaves_the_old_content_or_the_new_and_the_next_one_writes(
    kind, fresh
):
    found = []
    for step in itertools.count():
        folder = fresh()
        died = Death(folder).comes(step, lambda folder=folder: kind.write(folder, 1))
        found.append(kind.read(folder))
        for left in leftovers(folder):
            os.utime(left, (1.0, 1.0))  # as if that were long ago
        kind.write(folder, 2)
        assert kind.read(folder) == 2
        assert leftovers(folder) == []
        if not died:
            break
    assert found == sorted(found)
    assert {*found} == ({0, 1} if kind.name != "deleted calibration" else {0})
    assert len(found) > 2


def outcome(kind, folder):
    """How writing the new content ends."""
    try:
        kind.write(folder, 1)
    except So101Error:
        return "refused"
    return "written"


def check_failed(kind, folder, said, *, fits=False):
    assert said == "refused" or fits or kind.is_silent
    assert kind.read(folder) in ((0, 1) if said == "written" else (0,))
    assert leftovers(folder) == []


@each_kind
def test_without_room_the_old_content_stays(kind, fresh):
    folder = fresh()
    size = max(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    for most in (0, 1, size // 2, size - 1, size, 2 * size):
        folder = fresh()
        with no_room_beyond(most):
            said = outcome(kind, folder)
        check_failed(kind, folder, said, fits=most >= size)


@each_kind
def test_in_a_read_only_folder_the_old_content_stays(kind, fresh):
    folder = fresh()
    said = []
    refused = PermissionError(13, "Permission denied")
    Death(folder, refused).comes(0, lambda: said.append(outcome(kind, folder)))
    check_failed(kind, folder, said[0])


def test_nothing_else_opens_files_for_writing():
    """But the records of a teleoperation, which grow, pipes, and the copies of data sets, whose
    folder gets its name in the end."""
    opens = re.compile(r"""open\([^)]*["'][wax]b?["']|\.write_(text|bytes)\(""")
    writers = {
        path.name
        for part in ("so101_motion", "viewer", "lerobot_robot_so101_motion")
        for path in (Path(__file__).parents[3] / part).rglob("*.py")
        if opens.search(path.read_text())
    }
    others = {"recording.py", "convert.py", "child_process.py", "episode_writer.py"}
    assert writers == {"atomic.py", *others}
