"""What our modules find in Windows' Python, in every process with this folder on PYTHONPATH.

Other packages see the system as it is. What ours import of the standard library has no more than
on Windows, ``sys.platform`` is ``win32``, and ``HIDDEN_PACKAGES`` are not installed for them.
"""

import builtins
import enum
import fcntl
import os
import select
import signal
import socket
import subprocess
import sys
import types

OURS = {"so101_motion", "so101_viewer", "so101_description", "lerobot_robot_so101_motion"}
MISSING = {"fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty"}
MISSING |= set(os.environ.get("HIDDEN_PACKAGES", "").split())
BUILT_HERE = ".native.library"  # loads the library of this system
LACKING = {
    os: "fork forkpty openpty posix_openpt ttyname getuid geteuid getgid getpgrp tcgetpgrp killpg"
    " setsid nice fchmod chown mkfifo sched_ SCHED_ getpriority setpriority PRIO_ pidfd_open uname"
    " set_blocking O_CLOEXEC O_NONBLOCK O_NOCTTY O_DIRECTORY statvfs sysconf wait3",
    signal: "SIGHUP SIGALRM SIGCHLD SIGKILL SIGPIPE SIGQUIT SIGUSR1 SIGUSR2 SIGTSTP SIGWINCH"
    " ITIMER_ alarm pause setitimer pthread_ SIG_BLOCK SIG_SETMASK sigwait pidfd_send_signal",
    select: "poll POLL epoll EPOLL",
    socket: "AF_UNIX send_fds recv_fds",
}


class Without(types.ModuleType):
    """A module that lacks attributes, or has others."""

    def __init__(self, module, lacking=(), **other):
        super().__init__(module.__name__)
        vars(self).update(_module=module, _lacking=tuple(lacking), **other)

    def __getattr__(self, name):
        if name.startswith(self._lacking):
            raise AttributeError(f"module {self._module.__name__} of Windows has no {name}")
        return getattr(self._module, name)

    def __setattr__(self, name, value):
        setattr(self._module, name, value)


class Popen(subprocess.Popen):
    """Windows' own refuses what only POSIX knows."""

    def __init__(self, command, *, creationflags=0, **options):
        if options.keys() & {"pass_fds", "preexec_fn", "start_new_session", "process_group"}:
            raise ValueError(f"not supported on Windows: {options}")
        super().__init__(command, **options)


def locking(opened, mode, size):
    """As ``msvcrt.locking``."""
    fcntl.lockf(opened, fcntl.LOCK_EX | fcntl.LOCK_NB, size)


def kbhit():
    return bool(select.select([sys.stdin], [], [], 0.0)[0])


def getwch():
    return os.read(sys.stdin.fileno(), 1).decode()


WINDOWS = {module.__name__: Without(module, names.split()) for module, names in LACKING.items()}
WINDOWS["os"].__dict__["set_handle_inheritable"] = os.set_inheritable
HAS = {name: getattr(signal, name) for name in ("SIGINT", "SIGILL", "SIGABRT", "SIGFPE", "SIGTERM")}
WINDOWS["signal"].__dict__["Signals"] = enum.IntEnum("Signals", HAS)
WINDOWS["sys"] = Without(sys, platform="win32")
WINDOWS["subprocess"] = Without(subprocess, Popen=Popen, CREATE_NEW_PROCESS_GROUP=512)
WINDOWS["msvcrt"] = Without(
    types.ModuleType("msvcrt"), locking=locking, LK_NBLCK=2, kbhit=kbhit, getwch=getwch
)
real_import = builtins.__import__


def windows_import(name, globals=None, locals=None, fromlist=(), level=0):
    """Import what Windows has, if one of our modules asks."""
    asks = str((globals or {}).get("__name__", "")).partition(".")[0]
    if asks in OURS and level == 0:
        if name.partition(".")[0] in MISSING:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        if name in WINDOWS and not str(globals["__name__"]).endswith(BUILT_HERE):
            return WINDOWS[name]
    return real_import(name, globals, locals, fromlist, level)


builtins.__import__ = windows_import
