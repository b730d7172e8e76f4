"""Distribute test files over pytest's workers: those that mostly wait, and those that compute.

Of three workers or more the first drives the browser, the second starts processes, and the others
compute. A worker that computes yields the processor to those two. Tests that need real time are
left to the first two; when none are left, these compute as well. A second browser is started only
when there is nothing else to do.

Of two workers the first takes all tests that need real time before any other, and the second
computes first; a worker that has no file of its kind left takes one of the other kind.
"""

import os

from xdist.scheduler import LoadFileScheduling

BROWSERS = ("tests/browser/",)
PROCESSES = (
    "tests/unit/common/test_realtime.py",  # its worker must not have yielded yet
    "tests/module/",
    "tests/campaign/test_campaign.py",  # a module process is stopped and continued there
    "tests/bus/test_eeprom_writes.py",  # verbs in a terminal, on servos that answer in real time
    "tests/bus/test_cli_guided.py",  # programs that wait 30 ms for each of the servos here
)
"""Tests that start real processes and need real priorities."""

REAL_TIME = (*BROWSERS, *PROCESSES)
COMPUTED = "all others"
ANY = "all"

LONG = (*REAL_TIME, "tests/campaign/", "tests/bus/", "tests/plugin/", "tests/properties/")
"""Start with these, in this order, so that no worker ends alone with a long file."""

_NICENESS = 10
"""Chosen: real time goes first, but the emulated servos of another worker still answer in 30 ms."""


def longest_first(items):
    """The tests, with the files that take long first."""
    return sorted(items, key=lambda item: _place(item.nodeid))


def _place(nodeid):
    return next((i for i, start in enumerate(LONG) if nodeid.startswith(start)), len(LONG))


class Yielding:
    """A worker's plugin: with three workers or more, lowers its priority once it computes."""

    def __init__(self, workerinput):
        self._is_due = workerinput["workercount"] > 2

    def pytest_runtest_setup(self, item):
        if self._is_due and not item.nodeid.startswith(REAL_TIME):
            self._is_due = False
            os.nice(_NICENESS)


def kinds(name, count):
    """What a worker, one of ``count`` that are called gw0 and so on, takes: kinds of files in the
    order in which it prefers them."""
    number = int(name.removeprefix("gw"))
    if count == 1 or number >= count:  # such a one is there in place of one that has died
        return [ANY]
    if count == 2:
        return [REAL_TIME, COMPUTED] if number == 0 else [COMPUTED, REAL_TIME]
    return [[BROWSERS, COMPUTED], [PROCESSES, COMPUTED, BROWSERS], [COMPUTED]][min(number, 2)]


def is_of(path, kind):
    """Whether a file is of a kind."""
    if kind == COMPUTED:
        return not path.startswith(REAL_TIME)
    return kind == ANY or path.startswith(kind)


class Lanes(LoadFileScheduling):
    """Gives each worker the next file of the first kind that it takes and that is left."""

    def _assign_work_unit(self, node):
        path = self._next_for(node)
        if path is None:
            node.shutdown()
            return
        self.workqueue.move_to_end(path, last=False)
        super()._assign_work_unit(node)

    def _next_for(self, node):
        """The file for a worker; None if others that are there will take what is left."""
        others = [each for each in self.nodes if each is not node and not each.shutting_down]
        taken_by_others = [
            kind for each in others for kind in kinds(each.gateway.id, self.numnodes)
        ]
        for kind in kinds(node.gateway.id, self.numnodes):
            for path in self.workqueue:
                if is_of(path, kind):
                    return path
        for path in self.workqueue:
            if not any(is_of(path, kind) for kind in taken_by_others):
                return path
        return None
