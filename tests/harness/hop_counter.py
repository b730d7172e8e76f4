"""Counts the functions of ours that a request passes through.

A profile function (``sys.setprofile``) looks at a thread's stack whenever the thread hands the
request on: to another thread (a queue, an event, a future), to the planning process, or to the
port, or keeps it for the next tick (``KEPT_BY``). The functions of this package on those stacks,
each counted once, are the hops. A function that returns before its caller hands the request on is
none. The inside of the planning process counts as one.
"""

import concurrent.futures
import os
import sys
import threading
from pathlib import Path

import so101_motion

PACKAGE = str(Path(so101_motion.__file__).parent) + os.sep
PLANNING = "(planning, in a process of its own)"

KEPT_BY = ("ChannelPlayer.begin", "ChannelPlayer.turn", "PlannedMotion.sample")
"""What a motion that begins is left to, and what makes its setpoints."""

NOT_THE_MODULE = ("drivers/emulator/", "common/clock.py")
"""Ours, but no part of a walk: the servos' side, and what lets the simulated time pass."""

_C_CALLS = frozenset({"put", "send", "write", "start_new_thread"})
_CALLS = frozenset(
    {
        concurrent.futures.Future.set_result.__code__,
        concurrent.futures.Future.set_exception.__code__,
        threading.Event.set.__code__,
    }
)


class HopCounter:
    """Make one before the threads that it shall look at are started."""

    def __init__(self):
        self.hops, self.is_complete = [], False
        self._last, self._but, self._is_on = "", (), False
        threading.setprofile(self._profile)
        self.look_here()

    def look_here(self, *_):
        """Look at the present thread, too; as a callback, at the one that calls it."""
        sys.setprofile(self._profile)

    def start(self, last, but=()):
        """Count from now until ``last``; leave out stacks with a function of ``but``."""
        self._last, self._but, self._is_on = last, ("ServoDriver.read", *but), True

    def close(self):
        self._is_on = False
        threading.setprofile(None)
        sys.setprofile(None)

    def _profile(self, frame, event, called):
        if not self._is_on:
            return
        if event == "c_call":
            hands_on = called.__name__ in _C_CALLS
        else:
            code = frame.f_code
            kept = code.co_qualname in KEPT_BY or code.co_qualname == self._last
            hands_on = event == "call" and (kept or code in _CALLS)
        if not hands_on:
            return
        stack = functions_on(frame)
        if not stack or any(each.endswith(self._but) for each in stack):
            return
        self.hops += [each for each in stack if each not in self.hops]
        if stack[-1] == "arm/plan_messages MessageSocket.send" and PLANNING not in self.hops:
            self.hops.append(PLANNING)
        if stack[-1].endswith(self._last):
            self._is_on, self.is_complete = False, True


def functions_on(frame):
    """Our functions on a stack, the outermost first."""
    found = []
    while frame is not None:
        code, frame = frame.f_code, frame.f_back
        file = code.co_filename.partition(PACKAGE)[2]
        if file and not file.startswith(NOT_THE_MODULE):
            name = code.co_qualname.replace(".<locals>", "")
            found.append(f"{file.removesuffix('.py')} {name}")
    return found[::-1]
