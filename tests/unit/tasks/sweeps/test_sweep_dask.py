"""A sweep on a real Dask cluster on loopback, one of whose workers is killed in the middle.

The extra ``dev`` brings Dask; the tests are skipped where it is not installed.
"""

import json
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager

import pytest

from so101_motion.planning.collision.scene import Scene
from so101_motion.tasks.sweeps import ReachSweep, run_sweep, scene_text

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.long

PATIENCE = 240.0


@contextmanager
def running(*arguments):
    process = subprocess.Popen(
        [sys.executable, "-m", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def eventually(what):
    until = time.monotonic() + PATIENCE
    while not (found := what()):
        assert time.monotonic() < until
        time.sleep(0.02)
    return found


def test_a_killed_worker_changes_nothing(tmp_path):
    file, out = tmp_path / "scheduler.json", tmp_path / "out"
    quiet = ("--scheduler-file", str(file), "--no-dashboard")
    with ExitStack() as stack:
        here = ("--host", "127.0.0.1", "--port", "0")
        stack.enter_context(running("dask", "scheduler", *quiet, *here))
        eventually(file.exists)
        address = eventually(lambda: json.loads(file.read_text() or "{}").get("address"))
        first, _ = (
            stack.enter_context(running("dask", "worker", *quiet, "--nthreads", "1", "--no-nanny"))
            for _ in range(2)
        )
        eventually(lambda: "Registered to" in first.stdout.readline())
        asked = ("reach", "--spacing-mm", "20", "--out", str(out), "--dask", address)
        sweep = stack.enter_context(running("so101_motion.cli", "sweep", *asked))
        eventually(lambda: list(out.glob("shards/*.npz")))
        first.kill()
        said = sweep.communicate(timeout=PATIENCE)[0]
        with distributed.Client(address, set_as_default=False) as client:
            loaded = client.run_on_scheduler(lambda: "so101_motion" in sys.modules)
    expected = run_sweep(ReachSweep(spacing=0.02, scene=scene_text(Scene())), tmp_path / "whole")
    assert not loaded  # a scheduler hands shards on, it needs nothing of this package
    assert said.splitlines()[-1] == f"sha256 {expected.sha256}"
