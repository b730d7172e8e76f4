"""Keep the control loop on time on a busy computer.

What makes a control loop of a hundred ticks a second late, and what helps:

* other programs want the processor: a thread with a real-time priority goes before them all
  (``use_realtime_priority``; needs the right to, which root has and ``LimitRTPRIO`` in a service
  file gives);
* other threads of this program hold the interpreter lock, for up to 5 ms at a time by default;
* a thread that holds that lock loses its processor to another program, and the loop waits until it
  gets it back, whatever priority the loop has: 10 ms at a time beside two busy programs, 650 ms
  were seen beside a browser that draws. So every thread of such a program gets the lowest real-time
  priority, and where that is not allowed a larger share of the processor;
* the garbage collector scans everything that was ever imported, 60,000 objects, once in a while,
  and holds that lock for 10 to 20 ms (``reduce_jitter`` is for these three).

Measured with a client that asks 50 times a second and a planner that never rests, on two processors
that other programs use too: p99 3.5 ms late without all this, 1.3 ms with it.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import sys
from importlib import import_module
from types import ModuleType

_log = logging.getLogger(__name__)

_LEAST = 1  # of the real-time priorities: before all ordinary programs, behind the kernel's threads
_LOOP = 2  # a control loop goes before the other threads of its own program
_TURN = 0.0005
"""How long a thread may keep the interpreter lock while another wants it [s]. Chosen: a twentieth
of a tick; with much less, switching between threads costs more than it gains."""

LOOK_FOR_SIGNALS = 0.5
"""Longest single wait of the main thread [s]. Chosen. Python handles a signal between two
instructions; one that comes just before a thread blocks is handled only when that wait ends."""

_FEWEST_PROCESSORS = 2
"""With fewer processors, a program that computes without end at a real-time priority would keep all
other programs from running."""

_NICENESS = -11
"""Gives this program 12 times the processor time of an ordinary one, if both want all of it. Sound
servers use the same value."""


def use_realtime_priority() -> bool:
    """Give the calling thread a real-time priority; return whether that was allowed.

    Only for a thread that sleeps most of the time: no ordinary program gets its processor while it
    runs.
    """
    try:
        # What this thread may start is to be ordinary again.
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(_LOOP))
    except (AttributeError, OSError) as error:  # not on this system, or not for us
        _log.debug("no real-time priority: %s", error)
        return False
    return True


def reduce_jitter() -> None:
    """Configure this process so that no thread delays another for long.

    Threads switch more often, this thread and those it starts go before ordinary programs (if that
    is allowed), and the garbage collector ignores what was imported. For a program that has
    imported what it needs and is about to begin its work. On a computer with a single processor,
    the program only gets a larger share of it.
    """
    sys.setswitchinterval(_TURN)
    if not _go_first():
        _change_niceness(0, _NICENESS)
    gc.collect()
    gc.freeze()


def import_quietly(name: str) -> ModuleType:
    """Import a module, and let the garbage collector ignore what that brings."""
    if name in sys.modules:
        return import_module(name)  # waits for a thread that is still at it
    gc.disable()  # nothing that is imported is garbage, and looking takes a twentieth of the time
    try:
        return import_module(name)
    finally:
        gc.freeze()
        gc.enable()


def restore_normal_priority() -> None:
    """Undo the raised priority that a child inherits from a process with ``reduce_jitter``."""
    with contextlib.suppress(AttributeError):  # not on this system
        if os.sched_getscheduler(0) == os.SCHED_RR:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    _change_niceness(_NICENESS, 0)


def _go_first() -> bool:
    """Give this thread, and those it starts, the lowest real-time priority; whether that worked.

    A niceness that the user has chosen stays as it is.
    """
    try:
        if (os.cpu_count() or 1) < _FEWEST_PROCESSORS or os.getpriority(os.PRIO_PROCESS, 0) != 0:
            return False
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(_LEAST))
    except (AttributeError, OSError) as error:  # not on this system, or not for us
        _log.debug("no real-time priority for the program: %s", error)
        return False
    return True


def _change_niceness(before: int, after: int) -> None:
    """Set the niceness ``after``, unless it is no longer ``before``."""
    try:
        if os.getpriority(os.PRIO_PROCESS, 0) == before:
            os.setpriority(os.PRIO_PROCESS, 0, after)
    except (AttributeError, OSError) as error:  # not on this system, or not for us
        _log.debug("no niceness of %d: %s", after, error)
