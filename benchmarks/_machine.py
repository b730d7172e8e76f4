"""Detect standstills of a virtual machine, keep its processors awake, and look at processes.

A virtual machine stands still now and then, and its processors wake up late: a thread of the
highest priority that sleeps 1 ms was late by 1.9 ms at p99 and 17.7 ms at worst while the
processors could sleep, and by 0.2 and 6.4 ms while a process of idle priority kept each busy.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

LOOK_PERIOD = 0.002
LATE_WITNESS = 0.005
WITNESS = 4
"""The witness's real-time priority: above everything that is measured."""


@contextlib.contextmanager
def witnessed() -> Iterator[list[tuple[float, float]]]:
    """Run a witness on every processor; after the block the list has their standstills [s].

    A standstill of one processor stops a whole Python program if the thread with the interpreter
    lock is on it.
    """
    standstills: list[tuple[float, float]] = []
    with _one_on_each("witness") as witnesses:
        yield standstills
        for witness in witnesses:
            standstills += map(tuple, json.loads(witness.communicate()[0]))


@contextlib.contextmanager
def awake() -> Iterator[None]:
    """Keep every processor busy with a process of idle priority."""
    with _one_on_each("busy"):
        yield


@contextlib.contextmanager
def _one_on_each(task: str) -> Iterator[list[subprocess.Popen[str]]]:
    """Run one process on each processor until the block ends."""
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", "benchmarks._machine", task, str(processor)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for processor in sorted(os.sched_getaffinity(0))
    ]
    try:
        yield processes
    finally:
        for process in processes:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                assert pipe is not None
                pipe.close()


def cpu_time(pid: int) -> float:
    """Processor time of a process so far, without its ended children's [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory(pid: int) -> int:
    """Resident memory of a process [bytes]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def proportional(pid: int) -> int:
    """Its share of the memory that processes have (PSS) [bytes]; those of a program add up.

    Run nothing else of the same environment: what another process reads as well is shared, too.
    """
    rows = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return 1024 * sum(int(row.split()[1]) for row in rows if row.startswith("Pss:"))


def _witness() -> None:
    """Sleep and look at the clock until standard input ends; then print when it was late."""
    with contextlib.suppress(OSError):  # before the control loop, if that is allowed
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(WITNESS))
    standstills, here = [], time.monotonic()
    ended = threading.Thread(target=sys.stdin.read, daemon=True)
    ended.start()
    while ended.is_alive():
        time.sleep(LOOK_PERIOD)
        before, here = here, time.monotonic()
        if here - before > LOOK_PERIOD + LATE_WITNESS:
            standstills.append((before, here))
    json.dump(standstills, sys.stdout)


def _be_busy() -> None:
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    while True:
        pass


if __name__ == "__main__":
    os.sched_setaffinity(0, {int(sys.argv[2])})
    _witness() if sys.argv[1] == "witness" else _be_busy()
