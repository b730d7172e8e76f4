"""What each test costs: seconds of clock and processors, with its child processes and browser.

    python -m pytest -p timing --junitxml times.xml ...   # PYTHONPATH must name this folder
    python tests/timing.py times.xml                      # the table, and the dearest tests
    make timing                                           # both, for all; also in tests/README.md

A test that starts a process that others use pays for it until it is ended.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree

import psutil
import pytest

README = Path(__file__).with_name("README.md")
BEGIN, END = "<!-- times: make timing -->\n", "<!-- end of times -->"


def _spent() -> float:
    """Processor seconds of this process and of those below it, ended ones included."""
    total, here = 0.0, psutil.Process()
    for each in (here, *here.children(recursive=True)):
        with suppress(psutil.NoSuchProcess):
            total += sum(each.cpu_times()[:4])
    return total


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item):
    item.began = _spent()
    return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item):
    try:
        return (yield)
    finally:
        item.user_properties.append(("processors_s", max(0.0, _spent() - item.began)))


def main(path: Path, *, writes: bool) -> None:
    """Print the table of the folders, for the README too, then the most expensive tests."""
    folders: defaultdict[str, list[float]] = defaultdict(lambda: [0, 0.0, 0.0])
    times = []
    for case in ElementTree.parse(path).iter("testcase"):
        places = case.get("classname", "").split(".")[1:]
        folder = "/".join(places[: 2 if places[0] == "unit" else 1]) if places[1:] else "(top)"
        spent = case.find(".//property[@name='processors_s']")
        cost = float(case.get("time", 0)), 0.0 if spent is None else float(spent.get("value", 0))
        times.append((cost, f"{'/'.join(places)}::{case.get('name')}"))
        for key in (folder, "all"):
            folders[key] = [a + b for a, b in zip(folders[key], (1, *cost), strict=True)]
    table = "| folder | tests | clock [s] | processors [s] |\n|---|---|---|---|\n"
    for name, (count, wall, processor) in sorted(folders.items(), key=lambda row: -row[1][2]):
        table += f"| `{name}` | {count} | {wall:.0f} | {processor:.0f} |\n"
    print(table)
    if writes:
        before, _, rest = README.read_text().partition(BEGIN)
        README.write_text(before + BEGIN + table + END + rest.partition(END)[2])
    for (wall, processor), name in sorted(times, key=lambda row: -max(row[0]))[:60]:
        print(f"{wall:7.2f} {processor:7.2f}  {name}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), writes="--write" in sys.argv)
