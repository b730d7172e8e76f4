"""Pack the arrays of a shard into the bytes of its file, and hash them."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[Any]]
"""The arrays of a shard by name."""


class Packed(NamedTuple):
    """A packed shard; workers make it, and one process writes it.

    Attributes:
        data: The bytes of its file.
        digest: The digest of its arrays.
    """

    data: bytes
    digest: str


def packed(columns: Columns) -> Packed:
    """Pack the arrays of a shard as an npz file."""
    file = io.BytesIO()
    np.savez_compressed(file, **columns)  # type: ignore[arg-type]  # arrays by name only
    return Packed(file.getvalue(), digest(columns))


def digest(columns: Columns) -> str:
    """The SHA-256 of arrays: their names, types, shapes and values, in the order of the names."""
    whole = hashlib.sha256()
    for name in sorted(columns):
        array = np.ascontiguousarray(columns[name])
        whole.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        whole.update(array.tobytes())
    return whole.hexdigest()
