"""Write files in one step, with one writer at a time.

A reader sees the old content or the new one, never half of it, even if the computer or the process
stops in between. A writer that reads first, to keep what others wrote, takes the folder's lock. The
lock is released when the process that holds it dies.
"""

from __future__ import annotations

import contextlib
import os
import re
import stat
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from so101_motion.common.errors import ConfigError

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

LONGEST_WAIT = 10.0  # How long to wait for another writer [s]; writing takes milliseconds. Chosen.

_ABANDONED = 60.0
"""A temporary file older than this was left by a writer that was killed [s]. Chosen; writing takes
milliseconds."""


def write(path: Path, data: bytes) -> None:
    """Write ``data`` to ``path`` in one step, and flush it to the disk.

    A link is followed, and the permissions of an existing file stay. A device such as
    ``/dev/stdout`` is written to directly. If it cannot be written, the old content stays.
    """
    path = Path(os.path.realpath(path))
    mode = path.stat().st_mode if path.exists() else None
    if mode is not None and not stat.S_ISREG(mode):
        path.write_bytes(data)
        return
    remove_old_leftovers(path.parent)
    beside = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.tmp")
    try:
        with beside.open("wb") as file:
            if mode is not None and sys.platform != "win32":
                os.fchmod(file.fileno(), stat.S_IMODE(mode))
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
    flush(path.parent)


def save(what: str, path: Path, data: bytes, *, make_folder: bool = False) -> None:
    """Write as ``write`` does; ``ConfigError`` about ``what`` if the file cannot be written."""
    try:
        if make_folder:
            path.parent.mkdir(parents=True, exist_ok=True)
        write(path, data)
    except OSError as error:
        reason = f"cannot be written: {error.strerror or error}"
        raise ConfigError(what, str(path), reason) from error


def flush(folder: Path) -> None:
    """Flush new and removed file names in ``folder`` to the disk."""
    if sys.platform == "win32":
        return  # folders cannot be opened there; the file system sees to it by itself
    opened = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def remove_old_leftovers(folder: Path) -> None:
    """Remove old temporary files that killed writers left in ``folder``."""
    now = time.time()  # as the file system has it
    for left in folder.glob(".*.tmp"):
        with contextlib.suppress(OSError):  # somebody else's, or gone already
            if _OURS.search(left.name) and now - left.stat().st_mtime > _ABANDONED:
                left.unlink()


_OURS = re.compile(r"\.\d+-\d+\.tmp$")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other writers out of ``folder``; ``TimeoutError`` if another keeps the lock too long."""
    if sys.platform == "win32":
        opened = os.open(folder / ".so101.lock", os.O_RDWR | os.O_CREAT)
    else:
        opened = os.open(folder, os.O_RDONLY)
    try:
        _lock(opened, folder)
        yield
    finally:
        os.close(opened)  # which lets go of the lock


def _lock(opened: int, folder: Path) -> None:
    pause = threading.Event()
    until = time.monotonic() + LONGEST_WAIT
    while True:
        try:
            if sys.platform == "win32":
                msvcrt.locking(opened, msvcrt.LK_NBLCK, 1)
            else:
                fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            if time.monotonic() > until:
                raise TimeoutError(f"another program keeps writing in {folder}") from None
            pause.wait(0.002)
        else:
            return
