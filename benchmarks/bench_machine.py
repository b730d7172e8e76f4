"""Compare plans of an arm alone with plans among 30 components of its machine.

The real module process, with a stand-in for viam-server as its parent; every plan is asked for with
``preview`` of the motion service, from the same place, so each is compared with itself. Of the
components 20 have a geometry in their frame, 5 answer with their geometries, and 5 have none; they
stand around the arm, within its reach or a little beyond. Wall clock; of each plan the quickest of
some rounds, because the machine is shared.

What takes longer with 30 components is reading them, five calls of ``GetGeometries`` above all.
They take two thirds as much processor time of the stand-in, which is written in Python and shares
this process with whoever asks, as of the module. A genuine viam-server answers from its own.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import time
from typing import Any

import numpy as np
from grpclib import GRPCError
from viam.components.generic.service import GenericRPCService
from viam.resource.manager import ResourceManager

from benchmarks import _common
from benchmarks.bench_module import COMMAND, reachable_points

PLANS = 60
ROUNDS = 5
SEED = 5

_parent: Any = _common.from_tests("harness.fake_parent")
_machine: Any = _common.from_tests("harness.fake_machine")


def components() -> tuple[list[Any], list[Any]]:
    """Thirty components around the arm: their frames, and the components themselves."""
    rng = np.random.default_rng(SEED)
    frames, things = [], []
    for i in range(30):
        angle, away = rng.uniform(-np.pi, np.pi), rng.uniform(380.0, 600.0)
        where = {"x": away * np.cos(angle), "y": away * np.sin(angle), "z": rng.uniform(0.0, 300.0)}
        box = _machine.a_box(*rng.uniform(30.0, 90.0, 3))
        frames.append(_machine.hanging(f"part {i}", geometry=box if i < 20 else None, **where))
        things.append(_machine.Thing(f"part {i}", [box] if 20 <= i < 25 else None))
    return frames, things


async def planned(motion: Any, point: Any) -> tuple[float, float] | None:
    """How long a plan takes from the request to the answer, and the planner alone [s]."""
    pose = dict(zip("xyz", (float(value) for value in point), strict=True)) | {"oZ": 1}
    request = {
        "componentName": "arm",
        "destination": {"referenceFrame": "arm_origin", "pose": pose},
    }
    begin = time.perf_counter()
    try:
        told = (await motion.do_command({"preview": json.dumps(request)}))["preview"]
    except GRPCError:
        return None
    return time.perf_counter() - begin, told["planning_ms"] * 1e-3


async def compared() -> list[dict[str, Any]]:
    """The rows of the table."""
    manager = ResourceManager()
    arm = _machine.hanging("arm", joints=5)
    frames, things = components()
    points = reachable_points(PLANS)
    times: dict[int, list[list[tuple[float, float] | None]]] = {0: [], 30: []}
    async with _parent.running_module(command=COMMAND, services=[GenericRPCService(manager)]) as (
        module,
        _,
        _,
    ):
        machine = module.parent.machine = _machine.FakeMachine(arm, things=things)
        for thing in things:
            manager.register(thing)
            module.parent.resources.append(_machine.Thing.get_resource_name(thing.name))
        await module.add(_parent.ARM, _parent.SIMULATED, {}, "arm")
        motion = await module.add(_parent.MOTION, "devrel:so101:motion", {}, "planner")
        for _ in range(ROUNDS):
            for count in times:
                machine.configs = [arm, *frames[:count]]
                await planned(motion, points[0])  # reads what has changed
                times[count].append([await planned(motion, point) for point in points])
    rows: list[dict[str, Any]] = []
    best: dict[int, list[Any]] = {}
    for count, rounds in times.items():
        best[count] = [
            None if None in tries else np.min(np.array(tries), axis=0)
            for tries in zip(*rounds, strict=True)
        ]
    both = [
        (a, b) for a, b in zip(best[0], best[30], strict=True) if a is not None and b is not None
    ]
    for i, what in enumerate(("request to answer", "the planner alone")):
        alone, among = (np.array([pair[k][i] for pair in both]) for k in (0, 1))
        ratio = among / alone
        rows += [
            {"what": f"{what}, alone", **_common.summary(alone)},
            {"what": f"{what}, 30 components", **_common.summary(among), "bar": "20 % more"},
            {"what": f"{what}, ratio", "value": f"median {np.median(ratio):.2f}, p95 "
             f"{np.quantile(ratio, 0.95):.2f}, sum {among.sum() / alone.sum():.2f}"},
        ]  # fmt: skip
    rows.append({"what": "plans compared", "value": f"{len(both)} of {len(points)}"})
    return rows


def main() -> None:
    """Measure, print and write the results."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    _common.single_thread()
    rows = asyncio.run(compared())
    _common.write("bench_machine", rows)


if __name__ == "__main__":
    main()
