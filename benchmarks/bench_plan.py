"""Planning in the empty scene with a table: cost of a check, of a plan, and success.

100 requests of each kind between random free postures: to joint angles, to the point that a free
posture reaches, and "hard" ones, whose straight joint line is blocked by the table or the arm
itself; and straight lines of 100 mm. Whether a motion is free is decided afterwards by distances
at every sample. False alarms and misses of the posture check are against what is drawn of the
links, triangle by triangle.

The path search is compared with OMPL's RRT-Connect and simplifier under the same posture check, if
OMPL is installed (``pip install ompl``; it is no dependency). OMPL looks at postures 0.05 rad
apart; ours proves that there is nothing in between, which costs more.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import coal
import numpy as np
import so101_description

from benchmarks import _common
from so101_motion.errors import PlanningError
from so101_motion.geometry import SE3, Array
from so101_motion.planning.collision import CollisionModel
from so101_motion.planning.goals import Goal, JointGoal, LineGoal, PoseGoal
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.model import RobotModel
from so101_motion.planning.path import PathFinder
from so101_motion.planning.planner import Plan, Planner, PlanRequest

N = 100
POSTURES = 2000
SEED = 11
LINE = 0.1
LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
CPU = "CPU of the thread"
WALL = "wall"


class Pair(NamedTuple):
    """Two free postures, shape (5,), [rad]."""

    start: Array
    goal: Array


class Bench:
    """The arm, its surroundings, and random free postures."""

    def __init__(self) -> None:
        self.model = RobotModel.load()
        self.collision = CollisionModel(self.model)
        self.planner = Planner(self.model)
        self.rng = np.random.default_rng(SEED)

    def posture(self) -> Array:
        """A random posture inside the limits."""
        return self.rng.uniform(self.model.lower, self.model.upper)

    def free_posture(self) -> Array:
        """A random posture that is free of contact."""
        while True:
            q = self.posture()
            if self.collision.is_free(q):
                return q

    def pairs(self, *, hard: bool) -> list[Pair]:
        """Random pairs; hard ones have their straight line blocked."""
        found: list[Pair] = []
        while len(found) < N:
            pair = Pair(self.free_posture(), self.free_posture())
            if not hard or self.collision.blocked_posture(np.array(pair)) is not None:
                found.append(pair)
        return found

    def straight_share(self) -> float:
        """The share of random pairs with a free straight line."""
        pairs = [Pair(self.free_posture(), self.free_posture()) for _ in range(1000)]
        free = [self.collision.blocked_posture(np.array(pair)) is None for pair in pairs]
        return float(np.mean(free))


def check_rows(bench: Bench) -> list[_common.Row]:
    """Cost of checks on random postures, and how often they are wrong."""
    collision = bench.collision
    postures = [bench.posture() for _ in range(POSTURES)]
    answers, times = _common.measure(collision.is_free, postures)
    free = np.array(answers)
    touching = np.array([_touches_as_drawn(bench, q) for q in postures])
    floor = [k for k, pair in enumerate(collision.pairs) if pair[1] == "floor"]
    near_floor = np.array([collision.distances(q)[floor].min() for q in postures])
    # The floor is exact for both, so only postures clear of it say something about the hulls.
    above = near_floor > collision.margin
    alarms = float(np.mean(~free[above & ~touching]))
    _, distance_times = _common.measure(collision.clearance, postures)
    return [
        {
            "what": "posture check, free",
            **_common.summary(np.array(times)[free]),
            "clock": CPU,
            "false alarms": alarms,
            "missed": int(np.sum(free & touching)),
        },
        {"what": "posture check, blocked", **_common.summary(np.array(times)[~free]), "clock": CPU},
        {"what": "closest pair", **_common.summary(distance_times), "clock": CPU},
    ]


def _touches_as_drawn(bench: Bench, q: Array) -> bool:
    placed = bench.model.link_placements(q, 0.0)
    shapes = _drawn_shapes()
    human = {link: part.replace("_", " ") for link, part in so101_description.PARTS.items()}
    T = {human[link]: coal.Transform3s(pose.R, pose.p) for link, pose in placed.items()}
    for first, second in bench.collision.pairs:
        if second == "floor":
            continue
        result = coal.CollisionResult()
        request = coal.CollisionRequest()
        coal.collide(shapes[first], T[first], shapes[second], T[second], request, result)
        if result.isCollision():
            return True
    return False


_SHAPES: dict[str, Any] = {}


def _drawn_shapes() -> dict[str, Any]:
    """The triangles drawn of each link, made once."""
    for part in so101_description.PARTS.values() if not _SHAPES else ():
        shape = coal.BVHModelOBBRSS()
        meshes = [surface.mesh for surface in so101_description.load_visual(part)]
        shape.beginModel(sum(len(m.faces) for m in meshes), sum(len(m.vertices) for m in meshes))
        for mesh in meshes:
            for a, b, c in mesh.vertices[mesh.faces]:
                shape.addTriangle(a, b, c)
        shape.endModel()
        _SHAPES[part.replace("_", " ")] = shape
    return _SHAPES


def plan_rows(bench: Bench, name: str, requests: Sequence[PlanRequest]) -> list[_common.Row]:
    """Total cost of plans, success, and what each stage takes."""

    def attempt(request: PlanRequest) -> Plan | None:
        try:
            return bench.planner.plan(request)
        except PlanningError:
            return None

    answers, times = _common.measure(attempt, requests)
    plans = [plan for plan in answers if plan is not None]
    closest = [
        min(bench.collision.clearance(q).distance for q in plan.trajectory.q) for plan in plans
    ]
    rows: list[_common.Row] = [
        {
            "what": name,
            **_common.summary(times),
            "clock": CPU,
            "solved": f"{len(plans)} of {len(requests)}",
            "in contact": int(np.sum(np.array(closest) <= 0.0)),
            "straight": int(np.sum([plan.report.straight for plan in plans])),
        }
    ]
    stages = list(dict.fromkeys(stage for plan in plans for stage in plan.report.stages_ms))
    for stage in stages:
        spent = [plan.report.stages_ms.get(stage, 0.0) * 1e-3 for plan in plans]
        rows.append({"what": f"  {stage}", **_common.summary(spent), "clock": WALL})
    return rows


def request(start: Array, goal: Goal, seed: int) -> PlanRequest:
    """A request as the benchmark makes them."""
    return PlanRequest(q_start=start, goal=goal, limits=LIMITS, seed=seed)


def line_requests(bench: Bench) -> list[PlanRequest]:
    """Straight lines in random directions; whether they exist is not known beforehand."""
    requests = []
    for seed in range(N):
        start = bench.free_posture()
        T = bench.model.frame(start)
        way = bench.rng.standard_normal(3)
        end = SE3(T.R, T.p + LINE * way / np.linalg.norm(way))
        requests.append(request(start, LineGoal(T_base_tool=end), seed))
    return requests


def search_rows(bench: Bench, pairs: Sequence[Pair]) -> list[_common.Row]:
    """Search and shortening alone, ours and OMPL's, on the same hard pairs."""

    def ours(numbered: tuple[int, Pair]) -> Array | None:
        seed, pair = numbered
        finder = PathFinder(bench.model, bench.collision, seed=seed)
        try:
            return finder.find(pair.start, [pair.goal], 5.0).waypoints
        except PlanningError:
            return None

    rows = [_search_row("search: ours", bench, ours, pairs)]
    theirs = _ompl(bench)
    if theirs is None:
        print("ompl is not installed: not compared")
    else:
        rows.append(_search_row("search: OMPL RRTConnect", bench, theirs, pairs))
    print("roboplan is not compared here: it brings a collision model of its own")
    return rows


def _search_row(
    name: str,
    bench: Bench,
    search: Callable[[tuple[int, Pair]], Array | None],
    pairs: Sequence[Pair],
) -> _common.Row:
    answers, times = _common.measure(search, list(enumerate(pairs)))
    paths = [path for path in answers if path is not None]
    lengths = [float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) for path in paths]
    blocked = [bench.collision.blocked_posture(path) is not None for path in paths]
    return {
        "what": name,
        **_common.summary(times),
        "clock": CPU,
        "solved": f"{len(paths)} of {len(pairs)}",
        "in contact": int(np.sum(blocked)),
        "length": float(np.mean(lengths)),
    }


def _ompl(bench: Bench) -> Callable[[tuple[int, Pair]], Array | None] | None:
    """OMPL's RRT-Connect and simplifier under our posture check, or None if not installed."""
    try:
        base: Any = importlib.import_module("ompl.base")
        geometric: Any = importlib.import_module("ompl.geometric")
        util: Any = importlib.import_module("ompl.util")
    except ImportError:
        return None
    util.setLogLevel(util.LogLevel.LOG_NONE)
    space = base.RealVectorStateSpace(5)
    bounds = base.RealVectorBounds(5)
    for i in range(5):
        bounds.setLow(i, float(bench.model.lower[i]))
        bounds.setHigh(i, float(bench.model.upper[i]))
    space.setBounds(bounds)

    def search(numbered: tuple[int, Pair]) -> Array | None:
        setup = geometric.SimpleSetup(space)
        setup.setStateValidityChecker(
            lambda state: bench.collision.is_free([state[i] for i in range(5)])
        )
        information = setup.getSpaceInformation()
        information.setStateValidityCheckingResolution(0.05 / space.getMaximumExtent())
        setup.setPlanner(geometric.RRTConnect(information))
        ends = [space.allocState(), space.allocState()]
        for state, q in zip(ends, numbered[1], strict=True):
            for i in range(5):
                state[i] = float(q[i])
        setup.setStartAndGoalStates(*ends)
        if not setup.solve(5.0):
            return None
        setup.simplifySolution()
        states = setup.getSolutionPath().getStates()
        return np.array([[state[i] for i in range(5)] for state in states])

    return search


def main() -> None:
    """Run everything and write the result."""
    _common.single_thread()
    bench = Bench()
    begin = time.perf_counter()
    bench.planner.warm_up()
    rows: list[_common.Row] = [
        {
            "what": "warm-up",
            **_common.summary([time.perf_counter() - begin]),
            "clock": WALL,
        },
        *check_rows(bench),
    ]
    easy, hard = bench.pairs(hard=False), bench.pairs(hard=True)
    poses = [
        request(start, PoseGoal(T_base_tool=bench.model.frame(goal)), seed)
        for seed, (start, goal) in enumerate(easy)
    ]
    joints = [request(start, JointGoal(q=goal), seed) for seed, (start, goal) in enumerate(easy)]
    detours = [request(start, JointGoal(q=goal), seed) for seed, (start, goal) in enumerate(hard)]
    rows += plan_rows(bench, "to a point", poses)
    rows += plan_rows(bench, "to joint angles", joints)
    rows += plan_rows(bench, "to joint angles, line blocked", detours)
    rows += plan_rows(bench, "straight line, 100 mm", line_requests(bench))
    rows += search_rows(bench, hard)
    print(f"straight joint line free: {100.0 * bench.straight_share():.1f} % of 1000 random pairs")
    _common.write("bench_plan", rows, peers=("ompl",))


if __name__ == "__main__":
    main()
