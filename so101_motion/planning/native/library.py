"""Find and load the compiled library, if there is one built from exactly these sources.

Its file name contains a hash of the sources and the platform, so a library of another version or
for another processor is never loaded. Nothing is loaded before the first plan. ``SO101_NATIVE=off``
switches it off.

This file needs only the standard library, because ``build_native.py`` uses it before anything else
is installed.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import sys
from functools import cache
from pathlib import Path
from typing import NamedTuple

FOLDER = Path(__file__).resolve().parent

BUILD = "build_native.py"
"""The script that builds the library, at the top of a checkout."""


class Native(NamedTuple):
    """The loaded library, or why there is none.

    Attributes:
        library: The library, or None.
        lanes: How many configurations it checks at once on this processor.
        reason: Why there is no library; empty if there is.
    """

    library: ctypes.CDLL | None
    lanes: int
    reason: str


def library_file(system: str = sys.platform, machine: str = "", folder: Path = FOLDER) -> Path:
    """Path of the library for these sources and a platform."""
    known = hashlib.blake2b(digest_size=6)
    for source in sorted(folder.glob("*.[ch]")):
        known.update(source.name.encode() + b"\0" + source.read_bytes())
    machine = machine or platform.machine()
    return folder / f"native-{known.hexdigest()}-{system}-{machine.lower()}.so"


@cache
def native() -> Native:
    """The library, loaded once."""
    if os.environ.get("SO101_NATIVE") == "off":
        return Native(None, 0, "switched off by SO101_NATIVE=off")
    file = library_file()
    if not file.is_file():
        return Native(None, 0, f"not built; python {BUILD} in a checkout builds it")
    try:
        library = ctypes.CDLL(str(file))
        lanes = int(library.so101_start(int(os.environ.get("SO101_LANES", "16"))))
        library.so101_new.restype = library.so101_search_new.restype = ctypes.c_void_p
    except (OSError, AttributeError, ValueError) as error:
        return Native(None, 0, f"cannot be loaded: {error}")
    return Native(library, lanes, "")
