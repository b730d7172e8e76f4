"""Kill a process that writes files at a chosen step, or fill its disk.

``dies_at`` counts every step that the process takes in a folder (open, rename, remove, make, list,
lock), and every ``fsync`` before and after it; ``dies_writing`` kills it in the middle of a write.
Call them only in a forked child.
"""

import ctypes
import itertools
import os
import resource
import signal
import sys

STEPS = {
    "open", "os.rename", "os.remove", "os.mkdir", "os.listdir", "os.scandir", "fcntl.flock",
    "os.chmod", "os.link",
}  # fmt: skip
_NEW_USER, _NEW_MOUNTS = 0x10000000, 0x00020000


def dies_at(step, folder):
    """Kill this process with -9 before its ``step``-th step in ``folder``."""
    steps, real = itertools.count(), os.fsync

    def count():
        if next(steps) == step:
            os.kill(os.getpid(), signal.SIGKILL)

    def hook(event, arguments):
        if event in STEPS and (event == "fcntl.flock" or str(folder) in str(arguments)):
            count()

    def fsync(opened):
        count()
        real(opened)
        count()

    os.fsync = fsync
    sys.addaudithook(hook)


def dies_writing(size):
    """Kill this process when it has written ``size`` bytes of a file and goes on."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def fails_writing(size):
    """Let no file of this process grow beyond ``size`` bytes; writing more raises an
    ``OSError``."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def small_disk(folder, size):
    """Mount a disk of ``size`` bytes on ``folder``, for this process only; the reason if it
    fails."""
    libc, user = ctypes.CDLL(None, use_errno=True), (os.getuid(), os.getgid())
    if libc.unshare(_NEW_USER | _NEW_MOUNTS) != 0:
        return f"no namespace of its own: {os.strerror(ctypes.get_errno())}"
    try:
        with open("/proc/self/setgroups", "w") as file:
            file.write("deny")
        for name, mine in zip(("uid_map", "gid_map"), user, strict=True):
            with open(f"/proc/self/{name}", "w") as file:
                file.write(f"0 {mine} 1")
    except OSError as error:
        return f"no user of its own: {error.strerror}"
    options = f"size={size}".encode()
    if libc.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", 0, options) != 0:
        return f"no disk of its own: {os.strerror(ctypes.get_errno())}"
    return None


def without_rights():
    """Give up root's right to ignore file permissions."""
    if os.geteuid() == 0:
        os.setgid(65534)
        os.setuid(65534)
