"""Planning around obstacles: success, time, length of the path, and whether it is truly free.

Eight sets of 100 problems (``plan_problems.py``). Two figures for each:

- *search*: from two configurations to a path that is free, shortened and proven, without any
  timing; the same for OMPL, roboplan and sscbirrt (``plan_peers.py``) where they are installed,
  problem by problem in turn, so that all see the same machine. What sets them up is not counted.
  "first path" is the median until there is one that may be shortened; "seconds of motion" is the
  mean of all paths timed by us.
- *motion*: from the request to a timed trajectory whose every sample has been verified; and how
  long its stages take.

Every path and every trajectory is checked again, every 0.005 rad, with the arm as it is drawn
(``drawn.py``): "touching" counts those that are not free. Peers check configurations 0.05 rad apart
and, but for those with our check, keep no margin.

Further the cost of single checks, and how often they are wrong about what is drawn; and that of
many at once, anywhere and sixteen to an edge, among up to 1,000 boxes and a million points as well,
with the share of them that coal had to decide.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks import _common
from benchmarks.drawn import DrawnArm
from benchmarks.plan_peers import TIME, Attempt, ompl_search, roboplan_search, sscbirrt_search
from benchmarks.plan_problems import CROWDED, SCENES, Problem, problems
from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import Array
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import JointGoal, PathGoal, PoseGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.paths.path import PathFinder
from so101_motion.planning.planner import CORNER, Plan, Planner, PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

POSTURES = 2000
SEED = 11
STEP = 0.005
"""How far apart the postures are that are looked at again [rad]."""

BATCH, EDGE = 16_384, 0.3
"""How many configurations are checked at once, and how far an edge turns each joint at most
[rad]."""

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
CPU = "CPU of the thread"
WALL = "wall"


def check_rows(model: RobotModel, name: str) -> list[_common.Row]:
    """Cost of checks of random postures in a scene, and how often they are wrong."""
    collision, drawn = CollisionModel(model, SCENES[name]), DrawnArm(SCENES[name])
    random = np.random.default_rng(SEED)
    postures = list(random.uniform(model.lower, model.upper, (POSTURES, 5)))
    answers, times = _common.measure(collision.is_free, postures)
    free = np.array(answers)
    touching = np.array([drawn.touches(q) for q in postures])
    _, distance_times = _common.measure(collision.clearance, postures)
    _, near_times = _common.measure(lambda q: collision.nearest(q, within=0.05), postures)
    # What is nearer than the margin is refused on purpose; only what is clear of it is an alarm.
    near = np.array([collision.clearance(q).distance <= collision.margin for q in postures])
    rows: list[_common.Row] = [
        {
            "what": f"{name}: posture check, free",
            **_summary(np.array(times)[free]),
            "clock": CPU,
            "missed": int(np.sum(free & touching)),
        },
        {
            "what": f"{name}: posture check, blocked",
            **_summary(np.array(times)[~free]),
            "clock": CPU,
            "only by hulls": f"{np.mean(near & ~touching):.2%}",
        },
        {"what": f"{name}: closest pair", **_summary(distance_times), "clock": CPU},
        {"what": f"{name}: pairs within 50 mm", **_summary(near_times), "clock": CPU},
    ]
    return rows


def batch_rows(model: RobotModel, name: str, scene: Scene) -> list[_common.Row]:
    """Cost of a check where many are made at once, and how many of them coal decided."""
    collision, random = CollisionModel(model, scene), np.random.default_rng(SEED)
    anywhere = random.uniform(model.lower, model.upper, (BATCH, 5))
    edges = random.uniform(-EDGE, EDGE, (BATCH // 16, 1, 5)) * np.linspace(0.0, 1.0, 16)[:, None]
    rows: list[_common.Row] = []
    for how, q in (
        ("anywhere", anywhere),
        ("on edges", (anywhere[::16, None] + edges).reshape(-1, 5)),
    ):
        before = collision.batch.tally() if collision.batch else (0, 0)
        touching, times = _common.measure(collision.touching, list(q.reshape(-1, 64, 5)))
        after = collision.batch.tally() if collision.batch else (0, 0)
        rows.append(
            {
                "what": f"{name}: one of many checks, {how}",
                **_summary(np.array(times) / 64),
                "clock": CPU,
                "touching": f"{np.mean(touching):.0%}",
                "by coal": f"{(after[1] - before[1]) / max(after[0] - before[0], 1):.3%}",
            }
        )
    return rows


def search_rows(
    planner: Planner, model: RobotModel, name: str, asked: list[Problem]
) -> list[_common.Row]:
    """Search and shortening alone, ours and those of the peers that are installed."""
    scene = SCENES[name]
    collision = CollisionModel(model, scene)
    prepare = {
        "ours": _our_search(model, collision),
        "OMPL RRTConnect, our check": ompl_search(model, scene),
        "OMPL AORRTC, our check": ompl_search(model, scene, "AORRTC"),
        "roboplan RRT-Connect": roboplan_search(model, scene),
        "sscbirrt, our check": sscbirrt_search(model, scene),
    }
    able = {peer: each for peer, each in prepare.items() if each is not None}
    times: dict[str, list[float]] = {peer: [] for peer in able}
    alone: dict[str, list[float]] = {peer: [] for peer in able}
    paths: dict[str, list[Array]] = {peer: [] for peer in able}
    gc.collect()
    gc.freeze()
    for seed, problem in enumerate(asked):
        for peer, each in able.items():
            attempt = each(seed, problem)
            begin = time.thread_time_ns()
            spent, path = list[float](), None
            for path in attempt():  # noqa: B007
                spent.append((time.thread_time_ns() - begin) * 1e-9)
            if path is not None:
                alone[peer].append(spent[0])
                times[peer].append(spent[-1])
                paths[peer].append(path)
    gc.unfreeze()
    drawn = DrawnArm(scene)
    if collision.batch is not None:
        checks = collision.batch.tally()[0]
        print(
            f"{name}: {sum(times['ours']) / checks * 1e6:.2f} us of a search for each of {checks}"
        )
    return [
        {
            "what": f"{name}: search, {peer}",
            **_summary(times[peer]),
            "clock": CPU,
            "solved": f"{len(paths[peer])} of {len(asked)}",
            "touching": sum(drawn.touches_along(path, STEP) for path in paths[peer]),
            "first path": f"{np.median(alone[peer]) * 1e3:.2f} ms",
            "length": float(np.mean([_length(path) for path in paths[peer]])),
            "seconds of motion": _duration(planner, scene, paths[peer]),
        }
        for peer in able
        if paths[peer]
    ]


def _our_search(model: RobotModel, collision: CollisionModel) -> Callable[[int, Problem], Attempt]:
    def prepare(seed: int, problem: Problem) -> Attempt:
        finder = PathFinder(model, collision, seed=seed)

        def attempt() -> Iterator[Array | None]:
            try:
                yield finder.find(problem.start, [problem.goal], TIME).waypoints
            except PlanningError:
                yield None

        return attempt

    return prepare


def _duration(planner: Planner, scene: Scene, paths: list[Array]) -> str:
    """Mean duration of paths that are timed as ours [s]; those that fail the proof are left out."""
    durations = []
    for path in paths:
        goal = PathGoal(waypoints=path[1:], tolerance=CORNER)
        request = PlanRequest(q_start=path[0], goal=goal, limits=LIMITS, scene=scene)
        with suppress(PlanningError):
            durations.append(planner.plan(request).duration)
    return f"{np.mean(durations):.2f}, {len(durations)} paths" if durations else "none proven"


def motion_rows(planner: Planner, name: str, requests: list[PlanRequest]) -> list[_common.Row]:
    """From requests to verified motions: cost, success, stages, and what is drawn."""

    def attempt(request: PlanRequest) -> Plan | None:
        try:
            return planner.plan(request)
        except PlanningError:
            return None

    answers, times = _common.measure(attempt, requests)
    plans = [plan for plan in answers if plan is not None]
    drawn = DrawnArm(requests[0].scene)
    row: dict[str, Any] = {
        "what": name,
        **_summary(times),
        "clock": CPU,
        "solved": f"{len(plans)} of {len(requests)}",
        "touching": sum(drawn.touches_along(plan.trajectory.q, STEP) for plan in plans),
        "length": float(np.mean([_length(plan.trajectory.q) for plan in plans])),
        "seconds of motion": float(np.mean([plan.duration for plan in plans])),
    }
    rows: list[_common.Row] = [row]
    stages = dict.fromkeys(stage for plan in plans for stage in plan.report.stages_ms)
    for stage in stages:
        spent = [plan.report.stages_ms.get(stage, 0.0) * 1e-3 for plan in plans]
        rows.append({"what": f"  {stage}", **_summary(spent), "clock": WALL})
    return rows


def set_rows(planner: Planner, model: RobotModel, name: str) -> list[_common.Row]:
    """All rows of a set of problems."""
    scene, asked = SCENES[name], problems(model, name)
    requests = [
        PlanRequest(q_start=start, goal=JointGoal(q=goal), limits=LIMITS, scene=scene, seed=seed)
        for seed, (start, goal) in enumerate(asked)
    ]
    rows = check_rows(model, name) if name in ("empty", "table", "shelf") else []
    if name != "opposite":  # the scene is that of the table
        rows += batch_rows(model, name, scene)
    rows += search_rows(planner, model, name, asked)
    rows += motion_rows(planner, f"{name}: motion to joint angles", requests)
    if name == "empty":
        points = [
            replace(request, goal=PoseGoal(T_base_tool=model.frame(goal)))
            for request, (_, goal) in zip(requests, asked, strict=True)
        ]
        rows += motion_rows(planner, f"{name}: motion to a point", points)
    return rows


def _length(points: Array) -> float:
    """Of a polyline, in joint angles [rad]."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _summary(times: Any) -> dict[str, float]:
    known = _common.summary(times)
    p95 = float(np.percentile(times, 95.0))
    return {"n": known["n"], "median": known["median"], "p95": p95, "max": known["max"]}


def main() -> None:
    """Run everything and write the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only-search", nargs="+", default=[], help="sets; nothing is written")
    options = parser.parse_args()
    _common.single_thread()
    model = RobotModel.load()
    planner = Planner(model)
    begin = time.perf_counter()
    planner.warm_up()
    rows: list[_common.Row] = [
        {"what": "warm-up", **_summary([time.perf_counter() - begin]), "clock": WALL}
    ]
    for name in options.only_search:
        _common.print_table("bench_plan", search_rows(planner, model, name, problems(model, name)))
    if options.only_search:
        return
    sets = {name: partial(set_rows, planner, model, name) for name in SCENES}
    rows += sum(_common.in_pieces("bench_plan", sets), list[_common.Row]())
    for what, crowded in CROWDED.items():
        rows += batch_rows(model, what, crowded())
    _common.write("bench_plan", rows, peers=("ompl", "roboplan", "sscbirrt"))


if __name__ == "__main__":
    main()
