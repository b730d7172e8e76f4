"""Every file we write: its writer killed at every step, without room, in a read-only folder.

Laws: a reader finds the old content or the new, nothing else; writing again works; a writer that
fails raises an error of ours, and leaves everything as it was.

A process of its own, because it forks::

    PYTHONPATH=tests python -m campaign.kept_files --seed 1 --each 1000
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from harness import dying

from so101_motion.calib.motors.setup_view import SetupProgress
from so101_motion.calib.procedure import journal
from so101_motion.calib.record import lerobot, store
from so101_motion.calib.record.record import JOINTS, HeldCalibration, JointCalibration
from so101_motion.calib.record.zero import Zero
from so101_motion.common.errors import So101Error
from so101_motion.files.saved_poses import SavedPoses
from so101_motion.files.scene_file import read_scene, write_scene
from so101_motion.files.trajectory_export import export
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.timing.trajectory import Trajectory
from so101_motion.tasks.guided import GuidedPath
from so101_motion.tasks.guided import files as guided_files
from so101_motion.tasks.program import files as program_files
from so101_motion.tasks.program.program import Program, Waypoint

PAGE = 4096


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


def _write_journal(folder, n):
    journal.write(folder / "arm.json", journal.Journal(before=_held(0), meanwhile=_held(n)))


def _held(n):
    return {
        joint: HeldCalibration(homing_offset=n, range_min=700, range_max=3000) for joint in JOINTS
    }


def _read_journal(folder):
    held = journal.read(folder / "arm.json").meanwhile
    return _one({each.homing_offset for each in held.values()})


def _reach(folder, n):
    SetupProgress(folder / "progress.json", "port").reach("motors", f"step {n}")


def _reached(folder):
    return int(SetupProgress(folder / "progress.json", None).step.split()[-1])


def _q(n):
    return np.full(5, 0.01 * n)


def _number(q):
    return _one({round(100 * float(each)) for each in q})


def _write_program(folder, n):
    waypoints = tuple(Waypoint(name=f"w{i}", q=_q(n)) for i in range(40))
    program_files.write(Program.of_waypoints(waypoints, rounds=1), folder / "program.json")


def _read_program(folder):
    read = program_files.read(folder / "program.json")
    assert len(read.waypoints) == 40
    return _one({_number(each.q) for each in read.waypoints})


def _write_guided(folder, n):
    q = np.tile(_q(n), (300, 1))
    path = GuidedPath(t=np.arange(300) * 0.1, q=q, aperture=np.zeros(300))
    guided_files.write(path, folder / "path.json", replace=True)


def _read_guided(folder):
    read = guided_files.read(folder / "path.json")
    assert len(read.q) == 300
    return _one({_number(each) for each in read.q})


def _write_scene(folder, n):
    write_scene(Scene(floor_z=-0.001 * n), folder / "scene.json")


def _read_scene(folder):
    return round(-1000.0 * read_scene(folder / "scene.json").floor_z)


def _export(folder, n):
    q = np.tile(_q(n), (200, 1))
    rest = np.zeros_like(q)
    export(Trajectory(dt=0.01, q=q, qd=rest, qdd=rest, duration=1.99), folder / "motion.csv")


def _exported(folder):
    lines = (folder / "motion.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines if line[:1].isdigit()]
    assert len(rows) == 200
    return _one({_number(np.radians([float(each) for each in row[1:6]])) for row in rows})


def _export_lerobot(folder, n):
    lerobot.export(_calibration(n), folder / "lerobot.json")


def _exported_lerobot(folder):
    read = json.loads((folder / "lerobot.json").read_text())
    assert len(read) == 6
    return _one({each["homing_offset"] for each in read.values()})


KINDS = (
    Kept("calibration", _save_calibration, _load_calibration),
    Kept("restored calibration", _restore_calibration, _load_calibration),
    Kept("deleted calibration", _lose_and_load_calibration, _load_calibration, is_silent=True),
    Kept("journal", _write_journal, _read_journal),
    Kept("setup progress", _reach, _reached, is_silent=True),
    Kept(
        "poses",
        lambda folder, n: SavedPoses(folder / "poses.json").save("mine", _q(n)),
        lambda folder: _number(SavedPoses(folder / "poses.json").own()[0].q),
    ),
    Kept("program", _write_program, _read_program),
    Kept("guided path", _write_guided, _read_guided),
    Kept("scene", _write_scene, _read_scene),
    Kept("motion", _export, _exported),
    Kept("calibration for LeRobot", _export_lerobot, _exported_lerobot),
)


class Attack:
    """Attacks on the writer of one kind of file."""

    def __init__(self, kind, folder, rng, broken):
        self.kind, self._folder, self._rng, self._broken = kind, folder, rng, broken
        self._numbers, self.done = 0, Counter()
        fresh = self._fresh()
        self.kind.write(fresh, 1)  # what is imported now is not imported by a dying process
        self.kind.read(fresh)
        self._size = max(path.stat().st_size for path in fresh.rglob("*") if path.is_file())

    def _fresh(self):
        """A folder with the old file in it."""
        self._numbers += 1
        folder = self._folder / str(self._numbers)
        folder.mkdir(parents=True)
        os.environ["VIAM_MODULE_DATA"] = str(folder)
        os.environ["XDG_DATA_HOME"] = str(folder / "home")
        self.kind.write(folder, 0)
        return folder

    def kill_at_steps(self, first, stride):
        """Kill it at its steps ``first``, ``first + stride``, ... until it lives."""
        while True:
            folder = self._fresh()
            said = self._child(lambda folder=folder, n=first: self._die(dying.dies_at, n, folder))
            self._judge_killed(folder, f"killed at step {first}")
            self.done["killed at a step"] += 1
            if said is not None:
                return
            first += stride

    def kill_in_write(self, size):
        folder = self._fresh()
        self._child(lambda: self._die(dying.dies_writing, size))
        self._judge_killed(folder, f"killed when {size} bytes were written")
        self.done["killed in a write"] += 1

    def _die(self, how, *arguments):
        folder = self._folder / str(self._numbers)
        how(*arguments)
        self.kind.write(folder, 1)
        return "lived"

    def _judge_killed(self, folder, what):
        try:
            found = self.kind.read(folder)
            if found not in (0, 1):
                self._object(f"{what}: then it held {found}")
            for left in folder.rglob("*.tmp"):
                os.utime(left, (1.0, 1.0))  # as if that were long ago
            self.kind.write(folder, 2)
            if self.kind.read(folder) != 2:
                self._object(f"{what}: what is written next is not kept")
            left = [path.name for path in folder.glob("*.tmp")] + [*folder.glob(".*.tmp")]
            if left:
                self._object(f"{what}: {left} stay behind")
        except Exception as error:
            self._object(f"{what}: then {type(error).__name__}: {error}")
        shutil.rmtree(folder)

    def no_room(self, size):
        """Files cannot grow beyond ``size`` bytes."""
        folder = self._fresh()
        said = self._child(lambda: self._fail(dying.fails_writing, size, folder))
        self._judge_failed(folder, f"no room beyond {size} bytes", said, fits=size >= self._size)

    def read_only(self):
        folder = self._fresh()
        for path in (self._folder, folder, *folder.rglob("*")):
            path.chmod(0o555 if path.is_dir() else 0o444)
        said = self._child(lambda: self._fail(dying.without_rights, None, folder))
        for path in (folder, *folder.rglob("*")):
            path.chmod(0o755 if path.is_dir() else 0o644)
        self._judge_failed(folder, "in a read-only folder", said, fits=False)

    def _fail(self, how, size, folder):
        how() if size is None else how(size)
        return _outcome(self.kind, folder)

    def _judge_failed(self, folder, what, said, *, fits):
        self.done[what.split(" beyond")[0]] += 1
        allowed = {"ours", "written"} if fits or self.kind.is_silent else {"ours"}
        if said not in allowed:
            self._object(f"{what}: {said}")
        try:
            found = self.kind.read(folder)
            if found not in ({0, 1} if said == "written" else {0}):
                self._object(f"{what}: {said}, and then it held {found}")
            left = [str(path) for path in folder.rglob("*.tmp")]
            if left:
                self._object(f"{what}: {left} stay behind")
        except Exception as error:
            self._object(f"{what}: then {type(error).__name__}: {error}")
        shutil.rmtree(folder)

    def _child(self, act):
        """What ``act`` returned in a child of ours; None if that was killed."""
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(read)
            try:
                said = act()
            except BaseException as error:
                said = f"{type(error).__name__}: {error}"
            os.write(write, said.encode()[:4000])
            os._exit(0)
        os.close(write)
        with os.fdopen(read, "rb") as pipe:
            said = pipe.read().decode()
        os.waitpid(child, 0)
        return said or None

    def _object(self, what):
        self._broken.append(f"{self.kind.name}: {what}")

    def all(self, each):
        """As many of each attack as asked for, or as there are."""
        stride = 1 if each >= 100 else 7
        self.kill_at_steps(self._rng.randrange(stride), stride)
        sizes = sorted({0, 1, self._size // 2, self._size - 1, self._size, PAGE})
        sizes += [self._rng.randrange(self._size) for _ in range(max(each - len(sizes), 0))]
        for size in self._rng.sample(sizes, min(each, len(sizes))):
            self.kill_in_write(size)
            self.no_room(size)
        self.read_only()


def run(seed, each):
    """Attack the writers of all kinds of files."""
    done, broken = Counter(), []
    shm = Path("/dev/shm")
    base = Path(tempfile.mkdtemp(dir=shm if shm.is_dir() else None))
    base.chmod(0o755)
    os.fsync = lambda _: None  # no computer dies here, only processes
    try:
        for kind in KINDS:
            rng = random.Random(f"{seed} {kind.name}")
            attack = Attack(kind, base / kind.name.replace(" ", "-"), rng, broken)
            attack.all(each)
            done += attack.done
    finally:
        shutil.rmtree(base, ignore_errors=True)
    return {"done": dict(done), "failures": broken}


def _outcome(kind, folder):
    """How writing ended, in a word."""
    try:
        kind.write(folder, 1)
    except So101Error:
        return "ours"
    except BaseException as error:
        return f"{type(error).__name__}: {error}"
    return "written"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--each", type=int, default=100, help="how many sizes of each kind of file")
    asked = parser.parse_args()
    json.dump(run(asked.seed, asked.each), sys.stdout)


if __name__ == "__main__":
    main()
