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
WITNESS = 4
"""The witness's real-time priority: before whatever is measured."""


@contextlib.contextmanager
def witnessed() -> Iterator[list[tuple[float, float]]]:
    """Have a witness on every processor; the list has its standstills after the block [s].

    A standstill of one processor is one of a whole Python program, if the thread that holds the
    interpreter lock was on it.
    """
    standstills: list[tuple[float, float]] = []
    with _one_on_each("witness") as witnesses:
        yield standstills
        for witness in witnesses:
            standstills += map(tuple, json.loads(witness.communicate()[0]))


@contextlib.contextmanager
def awake() -> Iterator[None]:
    """Keep every processor busy with a process that gives way to all others."""
    with _one_on_each("busy"):
        yield


@contextlib.contextmanager
def _one_on_each(task: str) -> Iterator[list[subprocess.Popen[str]]]:
    """Have one process on each processor that ends with the block."""
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


def _witness() -> None:
    """Keep time until standard input ends; then say when that was not possible."""
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
