"""Connect to a Dask cluster; the only place that uses Dask (extra ``cluster``)."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from typing import Any

from so101_motion.common.errors import ConfigError, MachineUnavailable

_AHEAD = 4
"""Shards under way for each thread of the cluster. Chosen: some are always on the network."""

_PATIENCE = 10.0
"""How long a scheduler may take to answer [s]. Chosen."""


@contextmanager
def dask_executor(address: str) -> Iterator[tuple[Executor, int]]:
    """An executor on a Dask cluster, and how many shards to have under way in it.

    Its workers need this package, in the same version.

    Args:
        address: The scheduler's, such as ``"tcp://scheduler:8786"``.

    Raises:
        ConfigError: Dask is not installed.
        MachineUnavailable: No scheduler answers there, or it has no workers.
    """
    try:
        import distributed
    except ImportError as error:
        reason = "needs dask and distributed; try: pip install 'so101-motion[cluster]'"
        raise ConfigError("dask", address, reason) from error
    try:
        connect: Any = distributed.Client
        client = connect(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise MachineUnavailable(address, f"no Dask scheduler answers: {error}") from error
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            reason = f"its Dask scheduler has no workers; start some: dask worker {address}"
            raise MachineUnavailable(address, reason)
        # pure=False: Dask would otherwise return a cached result for a shard that it knows.
        yield client.get_executor(pure=False), _AHEAD * threads
