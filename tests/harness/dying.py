"""Kill a process that writes files at a chosen step, or let none of its files grow.

``dies_at`` counts every step that the process takes in a folder (open, rename, remove, make, list,
lock), and every ``fsync`` before and after it; ``dies_writing`` kills it in the middle of a write.
Call them only in a forked child.
"""

import itertools
import os
import resource
import signal
import sys

STEPS = {
    "open", "os.rename", "os.remove", "os.mkdir", "os.listdir", "os.scandir", "fcntl.flock",
    "os.chmod", "os.link",
}  # fmt: skip


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


def without_rights():
    """Give up root's right to ignore file permissions."""
    if os.geteuid() == 0:
        os.setgid(65534)
        os.setuid(65534)
