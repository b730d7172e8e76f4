"""What each test costs: seconds of clock and processors, with its child processes and browser.

    python -m pytest -p timing --timing times.json ...    # PYTHONPATH must name this folder
    python tests/timing.py times.json                     # the table, and the dearest tests
    make timing                                           # both, for all; also in tests/README.md

With pytest-xdist each worker writes a file of its own, ``times.json.gw0`` and so on; the table adds
them up. Processor time is this process's, that of children that have ended, and what the kernel
says of those that live; a test that starts a process others use pays for it until it is ended.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from collections import defaultdict
from pathlib import Path

TICK = 1.0 / os.sysconf("SC_CLK_TCK")
_times: dict[str, list[float]] = {}


def pytest_addoption(parser):
    parser.addoption("--timing", metavar="FILE", help="write what each test costs")


def _living(pid: int) -> float:
    """Processor seconds of the processes below ``pid``, and of those that they have waited for."""
    total = 0.0
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in _read(task).split():
            fields = _read(Path(f"/proc/{child}/stat")).rpartition(")")[2].split()
            total += sum(int(each) for each in fields[11:15]) * TICK + _living(int(child))
    return total


def _read(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:  # it has ended meanwhile
        return ""


def _spent() -> float:
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime + _living(os.getpid())


class Timing:
    """Notes each test's two times from setup to teardown."""

    def __init__(self, path: str):
        self._path = path
        self._began = (0.0, 0.0)

    def pytest_runtest_logstart(self, nodeid):
        self._began = (time.monotonic(), _spent())

    def pytest_runtest_logfinish(self, nodeid):
        wall, processor = time.monotonic() - self._began[0], _spent() - self._began[1]
        before = _times.get(nodeid, [0.0, 0.0])
        _times[nodeid] = [before[0] + wall, before[1] + max(0.0, processor)]

    def pytest_sessionfinish(self):
        if _times:
            worker = os.environ.get("PYTEST_XDIST_WORKER")
            Path(f"{self._path}.{worker}" if worker else self._path).write_text(json.dumps(_times))


def pytest_configure(config):
    is_controller = config.getoption("numprocesses", None)
    if config.getoption("--timing") and not is_controller:
        config.pluginmanager.register(Timing(config.getoption("--timing")))


def _folder(nodeid: str) -> str:
    parts = nodeid.partition("::")[0].split("/")
    return "/".join(parts[1 : 3 if parts[1] == "unit" else 2]) if len(parts) > 2 else "(top)"


README = Path(__file__).with_name("README.md")
BEGIN, END = "<!-- times: make timing -->\n", "<!-- end of times -->"


def main(path: Path, *, writes: bool) -> None:
    """Print the table of the folders, for the README too, then the most expensive tests."""
    times: dict[str, list[float]] = {}
    for each in sorted(path.parent.glob(f"{path.name}*")):
        times |= json.loads(each.read_text())
    folders: defaultdict[str, list[float]] = defaultdict(lambda: [0, 0.0, 0.0])
    for nodeid, (wall, processor) in times.items():
        for key in (_folder(nodeid), "all"):
            folders[key] = [a + b for a, b in zip(folders[key], (1, wall, processor), strict=True)]
    table = "| folder | tests | clock [s] | processors [s] |\n|---|---|---|---|\n"
    for name, (count, wall, processor) in sorted(folders.items(), key=lambda row: -row[1][2]):
        table += f"| `{name}` | {count} | {wall:.0f} | {processor:.0f} |\n"
    print(table)
    if writes:
        before, _, rest = README.read_text().partition(BEGIN)
        README.write_text(before + BEGIN + table + END + rest.partition(END)[2])
    for nodeid, (wall, processor) in sorted(times.items(), key=lambda row: -max(row[1]))[:60]:
        print(f"{wall:7.2f} {processor:7.2f}  {nodeid}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), writes="--write" in sys.argv)
