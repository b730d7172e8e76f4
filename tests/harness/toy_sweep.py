"""A sweep that takes no time: random numbers by shard, some of which fail or kill their process."""

import os
import signal
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from so101_motion.common.errors import ConfigError


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
