"""Shared by all benchmarks: one BLAS thread, two clocks, the table and the JSON file.

Run a benchmark as a module from the top of the checkout: ``python -m benchmarks.bench_ik``.

Two clocks. Short pure computations are timed with :func:`measure`, by the CPU time of the calling
thread, because on a shared machine the wall clock measures other programs too; calls that wait for
other threads or processes are timed by the wall clock (``clock=time.perf_counter_ns``). Every row
says which. JSON values are SI (seconds); only the printed table scales them.
"""

from __future__ import annotations

import gc
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

RESULTS = Path(__file__).parent / "results"
"""The folder of the committed results."""

_ONE_THREAD = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}
_PACKAGES = ("numpy", "pin", "coal", "toppra", "ruckig", "viam-sdk", "so101-motion")
_OWN_RESULTS = "benchmarks/results"

Input = TypeVar("Input")
Output = TypeVar("Output")
Row = Mapping[str, Any]
Piece = TypeVar("Piece")


def from_tests(module: str) -> Any:
    """Import a module of the tests, such as ``"harness.emulated_rig"``."""
    tests = str(Path(__file__).parents[1] / "tests")
    if tests not in sys.path:
        sys.path.insert(0, tests)
    return import_module(module)


def single_thread() -> None:
    """Start this process again with one BLAS thread, unless it already has just one.

    The libraries read these variables when they are loaded, which has happened by now, so the
    process is started anew; call this first in ``main``.
    """
    if any(os.environ.get(name) != value for name, value in _ONE_THREAD.items()):
        os.environ.update(_ONE_THREAD)
        sys.stdout.flush()
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


def on_processor_time() -> None:
    """Make the time budgets of searches processor time of their thread, on a shared machine."""
    from so101_motion.planning.cell import together
    from so101_motion.planning.paths import compiled_search

    clock = SimpleNamespace(perf_counter=time.thread_time, monotonic=time.thread_time)
    for module in (compiled_search, together):
        vars(module)["time"] = clock


def machine() -> dict[str, Any]:
    """Processor, cores, memory [bytes], system, Python, and how fast it is at the moment.

    ``loop`` is the time of a fixed loop in plain Python [s]. On a virtual machine it changes by a
    factor of two with the load of other machines, and every other figure with it.
    """
    return {
        "cpu": _first_value("/proc/cpuinfo", "model name") or platform.processor() or "unknown",
        "cores": os.cpu_count(),
        "memory": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "loop": float(np.median([_loop() for _ in range(20)])),
    }


def _loop() -> float:
    begin = time.thread_time_ns()
    total = 0.0
    for i in range(100_000):
        total += 0.5 * i
    return (time.thread_time_ns() - begin) * 1e-9


def versions(*more: str) -> dict[str, str]:
    """Installed versions of the libraries that matter, and of ``more`` (peers)."""
    found = {}
    for package in (*_PACKAGES, *more):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def measure(
    call: Callable[[Input], Output],
    inputs: Iterable[Input],
    *,
    clock: Callable[[], int] = time.thread_time_ns,
) -> tuple[list[Output], list[float]]:
    """Call once for each input; return the results and how long each took [s].

    Garbage collection stays on, but existing objects are frozen out of it.

    Args:
        call: The function to time.
        inputs: Its arguments, one for each call.
        clock: Nanoseconds: CPU time of this thread, or ``time.perf_counter_ns`` for wall time.
    """
    outputs: list[Output] = []
    times: list[float] = []
    gc.collect()
    gc.freeze()
    for value in inputs:
        begin = clock()
        output = call(value)
        times.append((clock() - begin) * 1e-9)
        outputs.append(output)
    gc.unfreeze()
    return outputs, times


def summary(times: ArrayLike) -> dict[str, float]:
    """Count, median, 99th percentile and largest of ``times`` [s]."""
    values = np.asarray(times, dtype=np.float64)
    return {
        "n": len(values),
        "median": float(np.median(values)),
        "p99": float(np.percentile(values, 99.0)),
        "max": float(values.max()),
    }


def in_pieces(
    name: str, pieces: Mapping[str, Callable[[], Piece]], since: str | None = None
) -> list[Piece]:
    """Run the pieces of a long benchmark and return their results; an interrupted run is resumed.

    Each result is saved as JSON in the system's temporary folder, and used again by the next run of
    the same commit. With uncommitted changes nothing is used again.

    Args:
        name: The benchmark.
        pieces: The functions to call, by the name of the piece.
        since: An earlier commit whose results are still valid and may be used.
    """
    commit, known = since or _commit(), {}
    file = Path(tempfile.gettempdir()) / f"{name}-{commit}.jsonl"
    if file.exists() and commit.isalnum() and commit != "unknown":
        known = dict(map(json.loads, file.read_text().splitlines()))
    found = []
    with file.open("a") as kept:
        for key, call in pieces.items():
            if key not in known:
                begin = time.process_time()
                known[key] = json.loads(json.dumps(call()))
                kept.write(json.dumps([key, known[key]]) + "\n")
                kept.flush()
                print(f"{key}: {time.process_time() - begin:.0f} s of processor time", flush=True)
            found.append(known[key])
    return found


def write(name: str, rows: Sequence[Row], *, peers: Sequence[str] = ()) -> Path:
    """Print machine, versions and a table; write ``results/<name>.json``.

    Args:
        name: The benchmark, e.g. ``"bench_ik"``.
        rows: One mapping a line; the first key names the line. Usually a name, then
            :func:`summary`, then whatever else was measured. A float under ``median``, ``p99``
            or ``max`` is printed as a time.
        peers: Further packages whose versions belong in the record.

    Returns:
        The file written.
    """
    record: dict[str, Any] = {
        "benchmark": name,
        "commit": _commit(),
        "machine": machine(),
        "versions": versions(*peers),
        "rows": [dict(row) for row in rows],
    }
    print_table(name, rows)
    print("machine:", ", ".join(f"{key} {value}" for key, value in record["machine"].items()))
    print("versions:", ", ".join(f"{key} {value}" for key, value in record["versions"].items()))
    path = RESULTS / f"{name}.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(record, indent=1) + "\n")
    return path


def update(name: str, rows: Sequence[Row], *, peers: Sequence[str] = ()) -> Path:
    """Like ``write``, but keeps the rows of the file that are not measured now.

    Each row says which commit it is from.
    """
    path = RESULTS / f"{name}.json"
    known: dict[str, Row] = {}
    if path.exists():
        record = json.loads(path.read_text())
        for row in record["rows"]:
            known[row["what"]] = {"commit": record["commit"], **row}
    now = _commit()
    for row in rows:
        known[row["what"]] = {**row, "commit": now}
    return write(name, [*known.values()], peers=peers)


def print_table(title: str, rows: Sequence[Row]) -> None:
    """Print rows under the union of their keys, columns aligned."""
    keys = list(dict.fromkeys(key for row in rows for key in row))
    lines = [keys, *([_cell(key, row.get(key, "")) for key in keys] for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(keys))]
    print(f"\n{title}")
    for line in lines:
        cells = [line[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True)]
        print("  ".join(cells))
    print()


def _cell(key: str, value: Any) -> str:
    if isinstance(value, float) and key in ("median", "p95", "p99", "max"):
        return f"{value * 1e6:.1f} us" if value < 1e-3 else f"{value * 1e3:.2f} ms"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _first_value(path: str, key: str) -> str | None:
    try:
        lines = Path(path).read_text().splitlines()
    except OSError:
        return None
    values = (line.partition(":")[2].strip() for line in lines if line.startswith(key))
    return next(values, None)


def _commit() -> str:
    """The checkout's commit, marked when anything but the results themselves has changed."""
    top = Path(__file__).parent.parent

    def git(*arguments: str) -> str:
        done = subprocess.run(
            ["git", *arguments], cwd=top, capture_output=True, text=True, check=True
        )
        return done.stdout.strip()

    try:
        changed = git("status", "--porcelain", "--", ".", f":!{_OWN_RESULTS}")
        return git("rev-parse", "--short", "HEAD") + ("+changes" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
