"""Find and load the compiled library, if there is one that was made of these very sources.

Its file carries a hash of the sources and the platform in its name, so a library that a later
version left behind, or one for another processor, is never loaded. Nothing is loaded before
somebody plans. ``SO101_NATIVE=off`` leaves it alone.

The standard library is all this needs, because ``build_native.py`` runs it before anything else is
installed.
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
"""Makes the library; at the top of a checkout."""


class Native(NamedTuple):
    """What became of loading it.

    Attributes:
        library: The library, None if there is none to be used.
        lanes: How many configurations it checks at once on this processor.
        reason: Why there is no library; empty if there is.
    """

    library: ctypes.CDLL | None
    lanes: int
    reason: str


def library_file(system: str = sys.platform, machine: str = "", folder: Path = FOLDER) -> Path:
    """Where the library for these sources and a platform is, or will be."""
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
