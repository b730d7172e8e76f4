"""The folder of a sweep: ``sweep.json``, its manifest, and ``shards/000000.npz``, one file a shard.

A shard's file is there whole or not at all, so the files are the list of finished shards. The
SHA-256 of the result is made from the arrays, not from the files' bytes, so that another version of
the compressor does not change it.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion import __version__
from so101_motion.common.errors import ConfigError
from so101_motion.files import atomic, user_storage
from so101_motion.tasks.sweeps.sweep import Packed, Sweep

MANIFEST = "sweep.json"
_SHARDS = "shards"
_SCHEMA = "so101/sweep/1"
_LARGEST = 100_000_000  # of a manifest, which has the scene [byte]. Chosen.


class SweepFolder:
    """The folder of a sweep.

    Args:
        path: The folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._shards = path / _SHARDS

    @contextmanager
    def opened_for(self, sweep: Sweep) -> Iterator[None]:
        """Claim the folder for this sweep and lock it; ``ConfigError`` if it cannot be used."""
        with ExitStack() as lock:
            try:
                self.path.mkdir(parents=True, exist_ok=True)
                lock.enter_context(atomic.locked(self.path))
            except OSError as error:  # TimeoutError too
                raise self._refused(f"cannot be used: {error.strerror or error}") from error
            self._claim(sweep)
            yield

    def _claim(self, sweep: Sweep) -> None:
        if not (self.path / MANIFEST).exists():
            known = (MANIFEST, _SHARDS)
            names = [path.name for path in self.path.iterdir() if not path.name.startswith(".")]
            other = [name for name in names if name not in known]
            if other:
                raise self._refused(
                    f"holds other things ({sorted(other)[0]}); name a new folder for the sweep"
                )
            self.describe(sweep, done=0, failed={}, sha256=None)
        manifest, wanted = self.manifest(), _identity(sweep)
        changed = [key for key in wanted if manifest.get(key) != wanted[key]]
        if changed:
            raise self._refused(_difference(manifest, wanted, changed))
        self._shards.mkdir(exist_ok=True)

    def manifest(self) -> Mapping[str, Any]:
        """Read the manifest; ``ConfigError`` if there is none."""
        if not (self.path / MANIFEST).exists():
            raise self._refused("has no sweep; make one with so101 sweep")
        return user_storage.read(self.path / MANIFEST, schema=_SCHEMA, largest=_LARGEST)

    def describe(
        self, sweep: Sweep, *, done: int, failed: Mapping[int, str], sha256: str | None
    ) -> None:
        """Write the manifest; ``failed`` has the reasons, ``sha256`` comes last."""
        state = {
            "done": done,
            "failed": {str(shard): why for shard, why in sorted(failed.items())},
            "sha256": sha256,
        }
        user_storage.write(self.path / MANIFEST, {**_identity(sweep), **state}, schema=_SCHEMA)

    def write(self, shard: int, packed: Packed) -> None:
        atomic.write(self._file(shard), packed.data)

    def read(self, shard: int) -> dict[str, np.ndarray] | None:
        """Read the arrays of a shard; None if its file is missing or damaged."""
        try:
            with np.load(self._file(shard), allow_pickle=False) as file:
                return {name: file[name] for name in file.files}
        except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error):
            return None

    def _file(self, shard: int) -> Path:
        return self._shards / f"{shard:06d}.npz"

    def _refused(self, reason: str) -> ConfigError:
        return ConfigError("out", str(self.path), reason)


def combined(digests: Mapping[int, str], shards: int) -> str:
    """The SHA-256 of a result, from the digests of its shards, with failed ones marked."""
    lines = (f"{shard} {digests.get(shard, 'failed')}\n" for shard in range(shards))
    whole = hashlib.sha256()
    for line in lines:
        whole.update(line.encode())
    return whole.hexdigest()


def _identity(sweep: Sweep) -> dict[str, object]:
    facts = json.loads(json.dumps(sweep.facts()))  # tuples become lists, as they are read back
    made_by = {"so101_motion": __version__}
    return {"kind": sweep.kind, "facts": facts, "shards": sweep.shards, "made_by": made_by}


def _difference(
    manifest: Mapping[str, object], wanted: Mapping[str, object], keys: list[str]
) -> str:
    """Why a folder's sweep is not the wanted one."""
    was, now = manifest.get(keys[0]), wanted[keys[0]]
    name = keys[0]
    if isinstance(was, dict) and isinstance(now, dict):
        name = next(key for key in (*now, *was) if was.get(key) != now.get(key))
        was, now = was.get(name), now.get(name)
    if any(len(str(each)) > 60 for each in (was, now)):
        how = f"its {name} is different"
    else:
        how = f"its {name} is {json.dumps(was)}, and {json.dumps(now)} is asked for"
    return f"belongs to another sweep: {how}; name a new folder, or ask for the same again"
