"""Timing of a real module's control loop for a minute, while it plans and answers a client.

Four processes, as on a robot: the module with its arm on a serial port; the emulated servos behind
that port, with the time of the wire at 1 Mbaud and an adapter that holds replies back for 1 ms; the
planning process, which never pauses; and a client that asks for the joints and the status 50
times a second over gRPC while the arm follows one path through many waypoints.

A wrapper in the module's process notes the moment of each ``write``. Lateness is counted against a
grid of ten milliseconds that starts with the earliest setpoint. Lost cycles are those the executor
itself reports.

A fifth process, the witness, only keeps time, at the highest priority. When it is late, the machine
as a whole has stood still (a virtual one does, now and then), and no program could have been on
time. Cycles lost then are counted apart.

``--module`` starts the module's process; it is not for people.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import sys
import tempfile
import threading
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from viam.components.arm import JointPositions

from benchmarks import _common
from benchmarks._machine import cpu_time, witnessed
from benchmarks.emulated_port import SUPPORT, emulated_port
from so101_motion.common.geometry import Array
from so101_motion.planning.goals import JointGoal

SECONDS = 60.0
PERIOD = 0.01
POLL_PERIOD = 0.02
LATENCY = 0.001
WAYPOINTS = 90
SEED = 4

_RECORD = "SO101_BENCH_RECORD"

_parent: Any = _common.from_tests("harness.fake_parent")


# The module's process


def module() -> None:
    """Be the module, note when each setpoint is written, and keep the planner busy."""
    from so101_motion.__main__ import main as serve
    from so101_motion.common.realtime import reduce_jitter
    from so101_motion.drivers.feetech.feetech_arm import FeetechArm

    reduce_jitter()  # as the module is about to do, so that the thread below is one of its own
    times: list[float] = []
    write = FeetechArm.write

    def noted(self: FeetechArm, *goal: Any) -> None:
        times.append(time.monotonic())
        write(self, *goal)

    FeetechArm.write = noted  # type: ignore[method-assign, assignment]
    done = threading.Event()
    planned: list[float] = []
    busy = threading.Thread(target=_plan_on, args=(done, planned), name="bench-planner")
    busy.start()
    try:
        serve()
    finally:
        done.set()
        busy.join()
        record = {"writes": times, "plans": planned}
        Path(os.environ[_RECORD]).write_text(json.dumps(record))


def _plan_on(done: threading.Event, planned: list[float]) -> None:
    """One plan after the other, by the planning process that all arms of the module share."""
    from so101_motion.rig.simulated_rig import open_simulated

    rng = np.random.default_rng(SEED)
    with open_simulated() as rig:
        while not done.is_set():
            begin = time.monotonic()
            with contextlib.suppress(Exception):
                rig.arm.plan(JointGoal(q=_posture(rng)))
            planned.append(time.monotonic() - begin)


def _posture(rng: np.random.Generator) -> Array:
    """Somewhere well above the table, shape (5,), [rad]."""
    middle, reach = np.radians([0, -45, 30, 30, 0]), np.radians([50, 15, 20, 20, 60])
    return np.asarray(middle + rng.uniform(-1.0, 1.0, 5) * reach)


# The figures


def excused(writes: Array, stops: list[tuple[float, float]]) -> int:
    """How many cycles are missing between setpoints while the machine stood still."""
    gaps = [(a, b) for a, b in pairwise(writes) if b - a < 20 * PERIOD]
    return sum(
        max(round((b - a) / PERIOD) - 1, 0)
        for a, b in gaps
        if any(begin < b and end > a for begin, end in stops)
    )


# The parent


async def session(record: Path) -> dict[str, Any]:
    """Move and poll for a minute; what the client saw."""
    command = (sys.executable, "-m", "benchmarks.bench_stream", "--module")
    os.environ[_RECORD] = str(record)
    with emulated_port("--latency", str(LATENCY), hand=SUPPORT) as port:
        async with _parent.running_module(command=command) as (running, _, _):
            arm = await running.add(_parent.ARM, _parent.HARDWARE_ARM, {"port": port}, "arm")
            await asyncio.sleep(5.0)  # the weight is taken up
            rng = np.random.default_rng(SEED)
            way = [JointPositions(values=list(np.degrees(_posture(rng)))) for _ in range(WAYPOINTS)]
            move = asyncio.ensure_future(arm.move_through_joint_positions(way))
            answers = await polled(arm, move)
            status = await arm.get_status()
            usage = cpu_time(running.process.pid)
    return {"answers": answers, "late_ticks": int(status["late_ticks"]), "cpu": usage}


async def polled(arm: Any, move: asyncio.Future[None]) -> list[float]:
    """How long each of the client's questions took [s], until the time is up."""
    answers: list[float] = []

    async def is_moving() -> bool:
        return move.done() or (await arm.get_status())["state"] == "moving"

    await _parent.until(is_moving)
    start = time.monotonic()
    for k in range(round(SECONDS / POLL_PERIOD)):
        await asyncio.sleep(max(0.0, start + k * POLL_PERIOD - time.monotonic()))
        begin = time.perf_counter()
        await (arm.get_status() if k % 10 == 0 else arm.get_joint_positions())
        answers.append(time.perf_counter() - begin)
        if move.done():
            await move
            raise RuntimeError(f"the move was over after {time.monotonic() - start:.1f} s")
    await arm.stop()
    await asyncio.wait([move])
    move.exception()
    return answers


def lateness(writes: Array) -> Array:
    """How far behind the grid each setpoint of the longest unbroken run was written [s]."""
    breaks = np.flatnonzero(np.diff(writes) > 20 * PERIOD)
    run = max(np.split(writes, breaks + 1), key=len)
    k = np.cumsum([0, *np.maximum(np.round(np.diff(run) / PERIOD), 1)])
    behind = run - k * PERIOD
    return np.asarray(behind - behind.min())


def main() -> None:
    """Measure, print and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dry", action="store_true", help="print the table, write no results")
    wanted = parser.parse_args()
    _common.single_thread()
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "record.json"
        with witnessed() as stops:
            seen = asyncio.run(session(record))
        noted = json.loads(record.read_text())
    writes = np.array(noted["writes"])
    late = lateness(writes)
    rows: list[dict[str, Any]] = [
        {"what": "setpoints behind their time", **_common.summary(late), "bar": "p99 2 ms"},
        {"what": "cycles lost", "value": seen["late_ticks"], "bar": "0"},
        {"what": "of those while the machine stood still", "value": excused(writes, stops)},
        {"what": "a client's question, answered after", **_common.summary(seen["answers"])},
        {"what": "plans made meanwhile, each", **_common.summary(noted["plans"])},
        {"what": "seconds on the way", "value": len(late) * PERIOD},
        {"what": "processor time of the module [s]", "value": seen["cpu"]},
    ]
    if wanted.dry:
        _common.print_table("bench_stream", rows)
    else:
        _common.write("bench_stream", rows, peers=("feetech-servo-sdk", "pyserial"))


if __name__ == "__main__":
    if "--module" in sys.argv:
        sys.argv.remove("--module")
        module()
    else:
        main()
