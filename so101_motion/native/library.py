"""Find and load the compiled library that was built from exactly these sources.

Its file name contains a hash of the sources and the platform, so a library of another version or
for another processor is never loaded. Nothing is loaded before somebody plans or drives joints.

At import this file needs only the standard library, because ``build_native.py`` uses it before
anything else is installed.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
import os
import platform
import sys
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

FOLDER = Path(__file__).resolve().parent


class Native(NamedTuple):
    """The loaded library."""

    library: ctypes.CDLL  # the library
    lanes: int  # how many configurations it checks at once on this processor


def library_file(system: str = sys.platform, machine: str = "", folder: Path = FOLDER) -> Path:
    """Path of the library for these sources and a platform."""
    known = hashlib.blake2b(digest_size=6)
    for source in sorted(folder.glob("*.[ch]")):
        known.update(source.name.encode() + b"\0" + source.read_bytes())
    machine = machine or platform.machine()
    return folder / f"native-{known.hexdigest()}-{system}-{machine.lower()}.so"


@cache
def native() -> Native:
    """Load the library, once.

    Raises:
        WorkerError: It was not built, or cannot be loaded.
    """
    from so101_motion.common.errors import WorkerError

    file = library_file()
    if not file.is_file():
        raise WorkerError(
            "the compiled part of so101_motion is missing; build it with a C compiler or with"
            ' "pip install ziglang": python build_native.py in a checkout'
        )
    try:
        library = ctypes.CDLL(str(file))
        lanes = int(library.so101_start(int(os.environ.get("SO101_LANES", "8"))))
        for made in (
            library.so101_new,
            library.so101_search_new,
            library.so101_motion_new,
            library.so101_flood_new,
        ):
            made.restype = ctypes.c_void_p
        library.so101_motion_cut.restype = library.so101_averaging.restype = ctypes.c_double
    except (OSError, AttributeError, ValueError) as error:
        raise WorkerError(f"the compiled part of so101_motion cannot be loaded: {error}") from error
    return Native(library, lanes)


@cache
def quick() -> ctypes.PyDLL:
    """The library for calls of microseconds: they keep the interpreter lock, slow to come back.

    Raises as ``native`` does.
    """
    library = ctypes.PyDLL(None, handle=native().library._handle)
    number, at, whole, bits = ctypes.c_double, ctypes.c_void_p, ctypes.c_int, ctypes.c_uint32
    inputs: tuple[Any, ...]
    for name, inputs in (
        ("servo_stiffness", (at,)),
        ("servo_error_for", (at, number)),
        ("servo_drive", (at, number)),
        ("servo_lag", (at,)),
        ("servo_distance", (at, number, number)),
        ("servo_friction", (at, number, number, number)),
        ("servo_stray", (at, number)),
        ("stopping_distance", (number, number)),
        ("cut_off", (number,)),
    ):
        function = getattr(library, f"so101_{name}")
        function.restype, function.argtypes = number, inputs
    for name, inputs in (  # of each control cycle
        ("held_up", (at, at, at, whole, at)),
        ("estimate_hear", (at, at, ctypes.c_char_p, number, number)),
        ("estimate_take", (at, at, ctypes.c_char_p, number, number, at, at)),
        ("estimate_look", (at, at, number)),
        ("trim_measure", (at, at, at, bits, number)),
        ("goals_point", (at, at, at, whole, whole, whole, bits, number)),
        ("goals_send", (at, bits, bits, whole, number, at)),
        ("surely_borne", (at, number, at)),
        ("guard_look", (at, number, whole)),
        ("guard_proves", (at, at, at, whole, whole)),
        ("nearest_within", (at, whole)),
        ("path_to_rest", (at, whole, whole, at)),
        ("following_step", (at, number, whole)),
        ("jog_want", (at, at)),
        ("jog_choose", (at, at, whole, whole)),
        ("jog_ahead", (at, at)),
        ("jog_to_rest", (at,)),
        ("jog_take", (at, number)),
    ):
        getattr(library, f"so101_{name}").argtypes = inputs
    return library


def shown(structure: ctypes.Structure, name: str, *shape: int) -> Any:
    """An array that shows numbers of a structure of the library, from a field on."""
    import numpy as np

    at, count = vars(type(structure))[name].offset, math.prod(shape)
    return np.frombuffer(memoryview(structure).cast("B"), np.float64, count, at).reshape(shape)
