"""A process that dies in this one: at any step that leaves a trace, or without room on its disk."""

import math
import sys
from collections.abc import Callable
from contextlib import contextmanager


class Died(BaseException):
    """The process is gone."""


class Death:
    """Counts what leaves a trace in a folder, and ends the process at one of them.

    A trace is a file opened for writing, renamed or removed, or a new folder; more can be counted
    by ``trace``. Nothing that the dying code tries to clean up has an effect. With another
    ``error`` the process lives, and every trace is refused with that.
    """

    _hook: Callable | None = None  # audit hooks stay for good, so there is one for all

    def __init__(self, folder, error=Died):
        self._folder, self._error = str(folder), error
        self.count = 0
        self.at = math.inf
        self.is_dead = False
        if Death._hook is None:
            sys.addaudithook(lambda event, args: Death._hook(event, args))
        Death._hook = self._audit

    def trace(self):
        self.count += not self.is_dead
        self.is_dead |= self.count > self.at
        if self.is_dead:
            raise self._error

    def comes(self, at, doing):
        """Do something, and die at its trace number ``at``; whether it came to that."""
        self.count, self.at = 0, at
        try:
            doing()
        except Died:
            return True
        finally:
            self.is_dead, self.at = False, math.inf
        return False

    def _audit(self, event, args):
        if event not in ("open", "os.rename", "os.remove", "os.mkdir"):
            return
        if not str(args[0]).startswith(self._folder):
            return
        if event != "open" or (isinstance(args[2], int) and args[2] & 0o3):
            self.trace()
        elif self.is_dead and self._error is Died:
            raise Died


@contextmanager
def no_room_beyond(size):
    """Let no file grow beyond ``size`` bytes; writing more raises an ``OSError``."""
    import resource  # Windows has none

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
