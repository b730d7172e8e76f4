"""A sweep that takes no time: random numbers by shard, some of which fail or kill their process.

Run as a script, ``toy_sweep.py FOLDER`` kills a run with -9 at each step that it takes in the file
system, starts the next run after each death, and prints the SHA-256s.
"""

import itertools
import os
import signal
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from so101_motion.common.errors import ConfigError
from so101_motion.tasks.sweeps import run_sweep


@dataclass(frozen=True, kw_only=True)
class ToySweep:
    """Numbers by seed and shard; ``fails`` fail as long as ``mended`` is no file."""

    seed: int = 0
    shards: int = 5
    fails: tuple[int, ...] = ()
    mended: str = ""
    kills: tuple[int, ...] = ()

    kind = "toy"
    unit = "numbers"

    @property
    def items(self):
        return 10 * self.shards

    def facts(self):
        return asdict(self)

    def open(self):
        return self._shard

    def _shard(self, shard):
        if shard in self.fails and not Path(self.mended).is_file():
            raise ConfigError("shard", shard, "is not what it should be")
        if shard in self.kills:
            os.kill(os.getpid(), signal.SIGKILL)
        random = np.random.default_rng((self.seed, shard))
        return {"value": random.normal(size=(10, 2)), "number": np.arange(10) + 10 * shard}


def at_each_step(base):
    """Kill a run at each step in the file system."""
    from harness.dying import dies_at

    for step in itertools.count():
        folder = base / str(step)
        child = os.fork()
        if child == 0:
            dies_at(step, folder)
            run_sweep(ToySweep(shards=3), folder)
            os._exit(0)
        lived = os.WIFEXITED(os.waitpid(child, 0)[1])
        print(run_sweep(ToySweep(shards=3), folder).sha256)  # noqa: T201
        if lived:
            return


if __name__ == "__main__":
    os.fsync = lambda _: None  # a process that dies takes nothing with it; only computers do
    at_each_step(Path(sys.argv[1]))
