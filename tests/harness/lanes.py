"""Distribute test files over workers: some mostly wait, the others compute all the time.

Half of the workers take the files of real time first: they wait for real processes and browsers, so
that not all processors are idle at once, and no two browsers draw at the same time. The others take
all other files first; whoever has no file of its kind left takes one of the other kind. With more
than two workers those that compute yield their processor.
"""

import os

from xdist.scheduler import LoadFileScheduling

REAL_TIME = (
    "tests/unit/common/test_realtime.py",  # its worker must not have yielded yet
    "tests/browser/",
    "tests/module/",
    "tests/campaign/test_share.py",  # a module process is stopped and continued there
    "tests/test_first_hour_page.py",
)
"""Where processes, browsers and priorities are real."""

LONG = (*REAL_TIME, "tests/campaign/", "tests/bus/", "tests/plugin/", "tests/properties/")
"""These begin first, in this order, so that no worker is left alone with a long file."""

_NICENESS = 10
"""Chosen: real time goes first, but the emulated servos of another worker still answer within 30 ms
and the browser, which draws without a GPU at a niceness of 15, gets a quarter of a processor."""


def longest_first(items):
    """The tests in another order of their files: those that take long first."""
    return sorted(items, key=lambda item: _place(item.nodeid))


def _place(nodeid):
    return next((i for i, start in enumerate(LONG) if nodeid.startswith(start)), len(LONG))


def yield_processor(workerinput):
    """Let a worker that computes go behind those that mostly wait."""
    count = workerinput["workercount"]
    if count > 2 and not waits(workerinput["workerid"], count):
        os.nice(_NICENESS)


def waits(name, count):
    """Whether a worker, one of so many that are called gw0 and so on, takes files of real time."""
    return int(name.removeprefix("gw")) < count // 2


class Lanes(LoadFileScheduling):
    """Gives each worker the next file of its kind, or of the other kind if none is left."""

    def _assign_work_unit(self, node):
        in_real_time = waits(node.gateway.id, self.numnodes)
        for path in self.workqueue:
            if path.startswith(REAL_TIME) == in_real_time:
                self.workqueue.move_to_end(path, last=False)
                break
        super()._assign_work_unit(node)
