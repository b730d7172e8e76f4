"""Distribute test files over workers: some mostly wait, the others compute all the time.

With as many workers as there are processors, one that waits for a real process or a browser leaves
its processor idle: of 13 minutes on two processors, 5 minutes of each. So with more than two
workers, half of them take the files of real time first. The others take all other files first, and
yield their processor; whoever has no file of its kind left takes one of the other kind.
"""

import os

from xdist.scheduler import LoadFileScheduling

REAL_TIME = (
    "tests/unit/common/test_realtime.py",  # its worker must not have yielded yet
    "tests/browser/",
    "tests/module/",
    "tests/campaign/test_share.py",  # a module process is stopped and continued there
    "tests/bus/test_hops.py",  # looks at every call, so the emulated servos are slow to answer
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
