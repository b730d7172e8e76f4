"""The machine under a measurement in real time: a witness of its standstills, and awake processors.

A virtual machine stands still now and then, and a processor of it that sleeps is woken late: a
thread of the highest priority that sleeps 1 ms was late by 1.9 ms at p99 and 17.7 ms at worst while
the processors could sleep, 0.2 and 6.4 ms while a process without any priority kept each busy.
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

LOOK_PERIOD = 0.002
LATE_WITNESS = 0.005


@contextlib.contextmanager
def witnessed() -> Iterator[list[tuple[float, float]]]:
    """Have a witness; when the machine stood still is in the list when the block has ended [s]."""
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmarks._machine", "witness"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    standstills: list[tuple[float, float]] = []
    yield standstills
    standstills += map(tuple, json.loads(process.communicate()[0]))


@contextlib.contextmanager
def awake() -> Iterator[None]:
    """Keep every processor busy with a process that anybody else's goes before."""
    command = [sys.executable, "-m", "benchmarks._machine", "busy"]
    busy = [subprocess.Popen(command, stdin=subprocess.PIPE) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.communicate()


def _witness() -> None:
    """Keep time until standard input ends; then say when that was not possible."""
    with contextlib.suppress(OSError):  # before the control loop, if that is allowed
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(2))
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
    _witness() if sys.argv[1] == "witness" else _be_busy()
