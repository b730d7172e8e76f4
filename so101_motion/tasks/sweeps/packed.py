"""A shard as it goes into its file. Workers pack it, for only one process writes."""

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
    """A shard.

    Attributes:
        data: The bytes of its file.
        digest: Of its arrays, see ``digest``.
    """

    data: bytes
    digest: str


def packed(columns: Columns) -> Packed:
    """The arrays of a shard as an npz file."""
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
