"""Start, latency and memory of the real module process, and 200 moves, over gRPC.

Measured: process start to Ready, and to the first setpoint of a first move; MoveToPosition request
to first setpoint on a warm module in real time; 200 MoveToPosition to random reachable points with
the simulated clock driven; memory of the service, and with its planning process.

The first setpoint is seen by asking for the status about every millisecond, so its times include
one such question: they are a little too long, never too short.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import time
from collections.abc import Awaitable
from pathlib import Path
from typing import Any

import numpy as np
from viam.components.arm import Pose

from benchmarks import _common
from benchmarks._machine import memory, proportional
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_mm
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.kinematics.model import RobotModel

STARTS = 10
LATENCIES = 50
MOVES = 200
SEED = 2

_parent: Any = _common.from_tests("harness.fake_parent")

COMMAND = (sys.executable, "-m", "so101_motion")  # as viam-server starts it; tests pace its clock


def reachable_points(n: int) -> Array:
    """Tool positions of random configurations free of collision, shape (n, 3), [mm]."""
    model = RobotModel.load()
    collision = CollisionModel(model)
    rng = np.random.default_rng(SEED)
    points: list[Array] = []
    while len(points) < n:
        q = rng.uniform(model.lower, model.upper)
        if collision.is_free(q):
            points.append(to_mm(model.frame(q).p))
    return np.array(points)


def pose_at(point: Array) -> Pose:
    """A goal whose position alone will count."""
    x, y, z = (float(value) for value in point)
    return Pose(x=x, y=y, z=z, o_z=1.0)


async def first_setpoint(arm: Any, call: Awaitable[None]) -> float:
    """Seconds from sending ``call`` until the arm is seen moving; then it is stopped."""
    begin = time.perf_counter()
    task = asyncio.ensure_future(call)
    while (await arm.get_status())["state"] != "moving":
        if task.done():
            await task
            raise RuntimeError("the move was over before it was seen to begin")
        await asyncio.sleep(0.0005)
    took = time.perf_counter() - begin
    await arm.stop()
    await asyncio.wait([task])
    task.exception()
    return took


async def starts(point: Array) -> list[dict[str, Any]]:
    """Fresh processes: how soon they answer, and how soon they move."""
    ready: list[float] = []
    first: list[float] = []
    for _ in range(STARTS + 1):
        begin = time.perf_counter()
        async with _parent.running_module(command=COMMAND) as (module, _, to_ready):
            arm = await module.add(_parent.ARM, _parent.SIMULATED, {}, "arm")
            await first_setpoint(arm, arm.move_to_position(pose_at(point)))
            ready.append(to_ready)
            first.append(time.perf_counter() - begin)
    return [
        {"what": "start to Ready", **_common.summary(ready[1:]), "bar": "2.0 s"},
        {"what": "start to first setpoint", **_common.summary(first[1:]), "bar": "3.0 s"},
    ]


async def latencies(points: Array) -> list[dict[str, Any]]:
    """A warm module in real time: from the request to the first setpoint, and its memory."""
    async with _parent.running_module(command=COMMAND) as (module, _, _):
        arm = await module.add(_parent.ARM, _parent.SIMULATED, {}, "arm")
        await module.add(_parent.GRIPPER, _parent.SIMULATED_GRIPPER, {}, "gripper")
        times = [
            await first_setpoint(arm, arm.move_to_position(pose_at(point)))
            for point in points[: LATENCIES + 1]
        ]
        used = memory_of(module.process.pid)
    row = {"what": "request to first setpoint", **_common.summary(times[1:]), "bar": "25 ms"}
    return [row, *used]


def memory_of(pid: int) -> list[dict[str, Any]]:
    """Memory of the service alone, and with its planning process; what is loaded."""
    threads = Path(f"/proc/{pid}/task").iterdir()
    children = [child for thread in threads for child in (thread / "children").read_text().split()]
    service = memory(pid)
    together = sum(map(proportional, (pid, *map(int, children))))
    maps = Path(f"/proc/{pid}/maps").read_text()
    heavy = [name for name in ("toppra", "matplotlib", "scipy") if f"/{name}/" in maps]
    return [
        {"what": "memory, service [MB]", "value": service / 1e6, "bar": "130 MB"},
        {"what": "memory, with planner [MB]", "value": together / 1e6, "bar": "300 MB"},
        {"what": "heavy libraries in the service", "value": ", ".join(heavy) or "none"},
    ]


async def moves(points: Array) -> list[dict[str, Any]]:
    """Simulated time driven by us: who arrives, how exactly, and how long it takes to compute."""
    errors_mm: list[float] = []
    times: list[float] = []
    failures: list[str] = []
    async with _parent.running_module(command=COMMAND) as (module, _, _):
        arm = await module.add(_parent.ARM, _parent.SIMULATED, {"simulate_time": False}, "arm")
        for point in points:
            begin = time.perf_counter()
            try:
                await driven(arm, arm.move_to_position(pose_at(point)))
            except Exception as error:
                failures.append(f"{np.round(point, 1)}: {error}")
                continue
            times.append(time.perf_counter() - begin)
            pose = await arm.get_end_position()
            errors_mm.append(float(np.linalg.norm(np.array([pose.x, pose.y, pose.z]) - point)))
    for failure in failures:
        print("did not arrive:", failure)
    return [
        {"what": "200 moves, wall time each", **_common.summary(times)},
        {
            "what": "200 moves, arrived",
            "value": f"{len(errors_mm)} of {len(points)}",
            "bar": f"{len(points)}",
        },
        {"what": "200 moves, worst error [mm]", "value": max(errors_mm), "bar": "0.2 mm"},
    ]


async def driven(arm: Any, call: Awaitable[None], step: float = 0.5) -> None:
    """``call`` to its end, while simulated time passes."""
    task = asyncio.ensure_future(call)
    while not task.done():
        await arm.do_command({"command": "advance_time", "seconds": step})
    await task


async def measure() -> list[dict[str, Any]]:
    """All rows, in the order of the table."""
    points = reachable_points(MOVES)
    return [*await starts(points[0]), *await latencies(points), *await moves(points)]


def main() -> None:
    """Measure, print and write the results."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    _common.write("bench_module", asyncio.run(measure()))


if __name__ == "__main__":
    main()
