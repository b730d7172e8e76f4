"""Pick random things from a cluttered table and place them: planned, and carried out.

Planned: for each problem (``pick_problems.py``, by its seed) all stages are planned, in this
process; only its processor time counts. What is not solved in ``SHORT`` is searched again with
three times as many directions and all grasps, for ``LONG`` at most; what that finds nothing for
counts as impossible.

Carried out: by arms with emulated servos of both kinds which differ from each other (spread 0.2),
among emulated things that are gripped, carried and let go. A thing is placed if the truth, which
the arm does not know, is within 5 mm of the place. ``CoalJudge``, an independent check, looks at
the true joints twenty times a second: with a margin of half a millimetre nothing but the fingers
may touch the thing, and nothing at all anything else.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common
from benchmarks.pick_problems import KINDS, START, problem
from so101_motion.common.errors import PlanningError, So101Error
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg
from so101_motion.drivers.servo_types import STS3215_7V4, STS3215_12V
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.picking.pick_plan import PickPlan, PickRequest, plan_pick
from so101_motion.planning.planner import Planner
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Strength
from so101_motion.rig.things import things_in

LIMITS = MotionLimits.uniform(velocity=np.radians(90.0), acceleration=np.radians(100.0), jerk=20.0)
SHORT, LONG = 5.0, 60.0
"""How much processor time both searches may take [s]."""

NEAR = 0.005
"""A thing no farther from its place is placed [m]."""

JUDGED = 0.0005
"""The judge's margin [m]."""

SERVOS = {"7.4 V": STS3215_7V4, "12 V": STS3215_12V}

_harness: Any = _common.from_tests("harness.emulated_rig")
_referee: Any = _common.from_tests("referee.official")
_judge: Any = _common.from_tests("harness.coal_check")


def _request(seed: int, **how: Any) -> PickRequest:
    task = problem(seed)
    request = PlanRequest(
        q_start=START,
        goal=JointGoal(q=START),
        limits=LIMITS,
        scene=task.scene,
        strength=Strength.of_servos(12.0),
        time_budget=4.0 * LONG,  # of the clock on the wall, while other programs run
    )
    return PickRequest(request=request, item="item", place=task.place, **how)


def _timed(planner: Planner, request: PickRequest) -> tuple[PickPlan | None, str, float]:
    """The plan or why there is none, and the processor time of that [s]."""
    begin, plan, error = time.process_time(), None, ""
    try:
        plan = plan_pick(planner, request)
    except PlanningError as problem_:
        error = str(problem_)
    return plan, error, time.process_time() - begin


def planned(first: int, count: int) -> list[dict[str, Any]]:
    """Plan some problems, the failed ones again for long."""
    model = RobotModel.load()
    planner, found = Planner(model), []
    planner.warm_up()
    with suppress(PlanningError):  # imports what is imported late
        plan_pick(planner, _request(10_000))
    for seed in range(first, first + count):
        task = problem(seed)
        row: dict[str, Any] = {"seed": seed, "kind": task.kind, "size_mm": task.size_mm}
        plan, error, row["cpu"] = _timed(planner, _request(seed))
        if plan is None or row["cpu"] > SHORT:
            again, _, cpu = _timed(planner, _request(seed, most=10_000, finer=3))
            row |= {"error": error or "too slow", "long": again is not None and cpu <= LONG}
        else:
            row |= {
                "duration": plan.duration,
                "tilt_deg": float(to_deg(plan.grasp.tilt if plan.grasp else 0.0)),
            }
        found.append(row)
    return found


def carried_out(seed: int, kind: str) -> dict[str, Any]:
    """Carry one problem out on an emulated arm; what was true of it."""
    task, model, judges = problem(seed), RobotModel.load(), {}
    touched = Counter[str]()
    start = (*START.tolist(), 0.0)
    zeros = dict(zip(ARM_JOINTS, np.radians(_harness.MIDDLES_DEG), strict=True))
    with (
        _referee.refereed(("motion",)),
        tempfile.TemporaryDirectory() as folder,
        _harness.hardware_bench(
            Path(folder), reply_timeout=5.0, q_start=start, kind=SERVOS[kind], spread=0.2, seed=seed
        ) as bench,
    ):
        things = bench.world.things = things_in(task.scene)
        rig = bench.open(zero_offsets=zeros)
        bench.advance(0.5)
        rig.arm.scene = task.scene
        run = rig.picker.start("item", task.place)
        for _ in range(4000):
            if run.future.done():
                break
            bench.advance(0.05)
            time.sleep(bench.turn)
            stage, plan = run.stage, run.plan
            scenes = {} if plan is None else plan.scenes
            name = {"open": "approach", "close": "reach", "back": "reach", "let go": "leave"}.get(
                stage, stage
            )
            if name not in scenes:
                continue
            key = (id(plan), name)
            if key not in judges:
                scene = replace(scenes[name], margin=JUDGED)
                judges[key] = _judge.CoalJudge(model, scene)
            q = np.radians(bench.arm_deg(rig))
            q_jaw = float(np.radians(bench.q_deg[5]))
            if not judges[key].is_free(q, q_jaw):
                pair = judges[key].first_contact(q, q_jaw)
                touched[f"{stage}: {pair}"] += 1
        error = ""
        try:
            run.future.result(timeout=60.0)
        except So101Error as raised:
            error = str(raised)
        at = things.where("item").p
        off = float(np.linalg.norm(at[:2] - task.place.p[:2]))
        return {
            "seed": seed,
            "kind": task.kind,
            "servos": kind,
            "off": off,
            "error": error,
            "gripped": any("is gripped" in each for each in things.told),
            "told": list(things.told),
            "touched": dict(touched),
        }


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--problems", type=int, default=500)
    parser.add_argument("--carried", type=int, default=60, help="problems that are carried out")
    asked = parser.parse_args()
    pieces = {
        f"planned {first}": partial(planned, first, min(25, asked.problems - first))
        for first in range(0, asked.problems, 25)
    }
    found = [row for piece in _common.in_pieces("bench_pick", pieces) for row in piece]
    rows = [_planned_row(kind, [r for r in found if kind in (r["kind"], "all")])
            for kind in (*KINDS, "all")]  # fmt: skip
    solved = [row["seed"] for row in found if "error" not in row]
    kinds = tuple(SERVOS)
    runs = {
        f"carried {seed}": partial(carried_out, seed, kinds[k % 2])
        for k, seed in enumerate(solved[: asked.carried])
    }
    done = _common.in_pieces("bench_pick", runs)
    rows += [_carried_row(kind, [r for r in done if kind in (r["servos"], "both")])
             for kind in (*kinds, "both")]  # fmt: skip
    for row in found:
        if "error" in row:
            print(row["seed"], row["kind"], row["size_mm"], row["long"], row["error"])
    for row in done:
        if row["error"] or row["off"] > NEAR or row["touched"]:
            print(row)
    _common.write("bench_pick", rows)


def _planned_row(kind: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    solved = [row for row in rows if "error" not in row]
    long = sum(row.get("long", False) for row in rows)
    cpu = [row["cpu"] for row in rows]
    return {
        "what": f"planned: {kind}",
        "n": len(rows),
        "solved": len(solved),
        "more by a long search": long,
        "share of the possible": len(solved) / max(len(solved) + long, 1),
        "median": float(np.median(cpu)),
        "p95": float(np.percentile(cpu, 95.0)),
        "max": float(np.max(cpu)),
        "motion, median [s]": float(np.median([row["duration"] for row in solved])),
        "refused without a reason": sum(not row.get("error", "x") for row in rows),
    }


def _carried_row(kind: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    placed = [row for row in rows if row["off"] <= NEAR and not row["error"]]
    silent = [row for row in rows if row["off"] > NEAR and not row["error"]]
    return {
        "what": f"carried out, {kind}",
        "n": len(rows),
        "gripped": sum(row["gripped"] for row in rows),
        "placed within 5 mm": len(placed),
        "share": len(placed) / max(len(rows), 1),
        "told failures": sum(bool(row["error"]) for row in rows),
        "silent failures": len(silent),
        "off, median [mm]": 1e3 * float(np.median([row["off"] for row in placed] or [np.nan])),
        "off, largest placed [mm]": 1e3 * max((row["off"] for row in placed), default=np.nan),
        "runs with a contact": sum(bool(row["touched"]) for row in rows),
    }


if __name__ == "__main__":
    main()
