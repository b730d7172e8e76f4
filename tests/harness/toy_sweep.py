"""A sweep that takes no time: random numbers by shard, some of which fail or kill their process.

Run as a script. ``toy_sweep.py FOLDER steps`` kills a run with -9 at each step that it takes in the
file system, starts the next run after each death, and prints the SHA-256s. With a number N instead
of ``steps`` it kills one sweep N times at random instants, and prints its SHA-256 and how many
shards there were before the last run.
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

SHARDS = 100  # of the sweep that is killed at random; two deaths leave half of them


@dataclass(frozen=True, kw_only=True)
class ToySweep:
    """Numbers by seed and shard.

    Attributes:
        fails: Shards that fail as long as ``mended`` is no file.
        kills: Shards that kill their process whenever they run.
    """

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


def at_random_instants(base, deaths):
    """Kill one sweep ``deaths`` times, at random instants after a new shard was written.

    The timer counts processor time, so that it does not matter how busy the computer is. Its signal
    ends a process that does not handle it as suddenly as -9 does.
    """
    random, sweep = np.random.default_rng(0), ToySweep(shards=SHARDS)
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    for _ in range(deaths):
        seconds = random.uniform(0.0005, 0.006)

        def start_timer(_, seconds=seconds):
            if not any(signal.getitimer(signal.ITIMER_PROF)):
                signal.setitimer(signal.ITIMER_PROF, seconds)

        child = os.fork()
        if child == 0:
            run_sweep(sweep, base, on_progress=start_timer)
            os._exit(0)
        assert os.WIFSIGNALED(os.waitpid(child, 0)[1]), "the sweep ended before it was killed"
    last = run_sweep(sweep, base)
    print(last.sha256, sweep.shards - last.computed)  # noqa: T201


def main(base, how):
    os.fsync = lambda _: None  # a process that dies takes nothing with it; only computers do
    if how == "steps":
        at_each_step(base)
    else:
        at_random_instants(base, int(how))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
