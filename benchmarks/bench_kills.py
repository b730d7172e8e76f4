"""Kill sweeps (kill -9) at random instants; the atlas must come out the same.

An atlas is made by two workers, or by a Dask cluster, and killed again and again until it is
complete; then the next one begins. Each kill hits the process that runs the sweep, a worker, or
Dask's scheduler. When the sweep has ended, the same command is given again. The SHA-256 of each
atlas must be that of an undisturbed one, and no worker may be left over.

``python -m benchmarks.bench_kills --kills 50 --seed 0``; another seed is another row.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack, suppress
from pathlib import Path

from benchmarks import _common
from benchmarks.bench_sweep import cluster
from so101_motion.planning.collision.scene import Scene
from so101_motion.tasks.sweeps import ReachSweep, run_sweep, scene_text

SPACING_MM = 12
SOON, EARLY = 0.2, 3.0
"""The latest instant of a kill after a number of shards, and after the start of a run [s]."""

LEFT = 20.0
"""How long an orphan may take to end [s]; generous, for a loaded machine."""


class Attack:
    """Kills sweeps.

    Args:
        kills: How many.
        seed: Of what is killed, and when.
        shards: Of the atlas.
    """

    def __init__(self, kills: int, seed: int, shards: int) -> None:
        self._shards = shards
        self._left, self._random = kills, random.Random(seed)
        self.killed: Counter[str] = Counter()
        self.atlases = self.resumed = self.wrong = self.orphans = 0

    def run(self, folder: Path, sha256: str) -> None:
        """Make atlases until so many kills are done."""
        while self._left > 0:
            with_dask = self.atlases % 3 == 2
            said = (self._on_dask if with_dask else self._on_processes)(folder / str(self.atlases))
            self.atlases += 1
            self.wrong += said != sha256

    def _on_processes(self, out: Path) -> str:
        while True:
            process = _sweep(out, "--workers", "2")
            victim = self._random.choice(("running process", "worker"))
            if not self._waits(process, out):
                return _ended(process)
            children = _children(process.pid)
            workers = [pid for pid in children if "spawn_main" in _command(pid)]
            if victim == "worker" and workers:
                self._kill(self._random.choice(workers), victim)
                return _ended(process)  # goes on by itself
            self._kill(process.pid, "running process")
            process.communicate()
            self.orphans += _still_there(children)
            self.resumed += 1

    def _on_dask(self, out: Path) -> str:
        while True:
            with ExitStack() as stack:
                address, scheduler, workers = stack.enter_context(cluster())
                process = _sweep(out, "--dask", address)
                stack.callback(process.kill)
                victim = self._random.choice(("Dask scheduler", "Dask worker", "running process"))
                if not self._waits(process, out):
                    return _ended(process)
                pids = {"Dask scheduler": scheduler.pid, "running process": process.pid}
                self._kill(pids.get(victim, workers[0].pid), victim)
                if victim == "Dask worker":
                    return _ended(process)
                process.communicate()  # without a scheduler it must end by itself
                self.resumed += 1

    def _waits(self, process: subprocess.Popen[str], out: Path) -> bool:
        """Wait for the next instant; whether there is one before the sweep ends.

        Most come with a random number of shards, so that they do not depend on how fast the
        computer is; one of five while it begins.
        """
        if self._left <= 0:
            return False
        shards = self._random.randrange(self._shards) if self._random.random() < 0.8 else 0
        while process.poll() is None and len(list(out.glob("shards/*.npz"))) < shards:
            time.sleep(0.005)
        with suppress(subprocess.TimeoutExpired):
            process.wait(self._random.uniform(0.0, SOON if shards else EARLY))
        return process.poll() is None

    def _kill(self, pid: int, what: str) -> None:
        os.kill(pid, signal.SIGKILL)
        self.killed[what] += 1
        self._left -= 1
        print(f"{self.killed.total()}: {what}, atlas {self.atlases}", flush=True)


def _sweep(out: Path, *by: str) -> subprocess.Popen[str]:
    asked = ("reach", "--spacing-mm", str(SPACING_MM), "--out", str(out), "--json", *by)
    command = [sys.executable, "-m", "so101_motion.cli", "sweep", *asked]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)


def _ended(process: subprocess.Popen[str]) -> str:
    said = process.communicate()[0]
    return str(json.loads(said)["sha256"]) if process.returncode == 0 else "failed"


def _children(pid: int) -> list[int]:
    try:
        return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def _command(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return ""


def _still_there(pids: list[int]) -> int:
    """How many processes have not ended in time."""
    until = time.monotonic() + LEFT
    while left := [pid for pid in pids if "python" in _command(pid)]:
        if time.monotonic() > until:
            return len(left)
        time.sleep(0.05)
    return 0


def main() -> None:
    """Kill, and write the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    wanted = parser.parse_args()
    whole = ReachSweep(spacing=1e-3 * SPACING_MM, scene=scene_text(Scene()))
    attack = Attack(wanted.kills, wanted.seed, whole.shards)
    with tempfile.TemporaryDirectory() as folder:
        expected = run_sweep(whole, Path(folder) / "whole").sha256
        attack.run(Path(folder), expected)
    row = {
        "what": f"atlas, 12 mm, seed {wanted.seed}",
        "n": attack.killed.total(),
        "atlases": attack.atlases,
        **{f"{what} killed": count for what, count in sorted(attack.killed.items())},
        "command given again": attack.resumed,
        "another result": attack.wrong,
        "workers left over": attack.orphans,
    }
    _common.update("bench_kills", [row], peers=("dask", "distributed"))
    if attack.wrong or attack.orphans:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
