"""Plan two arms that face each other at 350 mm together, and one arm among 30 components.

Tasks are drawn so that the tools begin and end where both arms reach, and so that arms that moved
in straight joint lines at the same pace would meet halfway. The benchmark measures how many tasks
are solved, how long planning and proof take, and how much sooner both arrive than one after the
other. ``bench_arms_apart.py`` measures arms whose targets lead into each other.

The makespan, when both have arrived, is also compared with the shortest that a long search
(``long_search.py``) finds for the first tasks of the same draw: ``--searched`` says for how many,
``--search-seconds`` for how much processor time each. ``--only-search`` and ``--only-rings``
measure nothing else and keep the other rows of the file.

Contact is judged by other means than planning (``solids.py``): polytopes around the official
solids, looked at by coal at single instants, every 5 ms of a plan.

*Rings*: one to eight arms in a circle, as ``so101 view`` places them, each from a random place to
another one; six also with all tools near the middle. The time budget and what is measured are
processor time; with half a second it is measured how much longer than allowed planning takes.

Last, how much longer plans of one arm take with 30 components of a machine around it: each motion
is planned without and with them, in turn, and the fastest of several runs of each counts. They are
never in the way, so only the cost of checking is compared.

    python -m benchmarks.bench_cell --tasks 500
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import replace

import numpy as np

from benchmarks._common import on_processor_time, single_thread, summary, update, write
from benchmarks.bench_crowd import Crowd, around
from benchmarks.long_search import LongSearch, Plans, makespan
from benchmarks.solids import Solids
from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import SE3, Array, rot_z
from so101_motion.files.cell_file import APART
from so101_motion.planning.cell.team_requests import TeamMember
from so101_motion.planning.cell.together import plan_together
from so101_motion.planning.collision.apart import first_meeting
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.course import Course
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

T_LEFT_RIGHT = SE3(rot_z(np.pi), np.array([0.35, 0.0, 0.0]))
COMPONENTS = 30
FAST = MotionLimits.uniform(velocity=np.pi, acceleration=8.0, jerk=150.0)  # of arms in a circle
HURRY = 0.5  # a short time budget [s]
EVERY = 4  # of so many setpoints of arms in a circle, one is examined for contact


class Tasks:
    """Draws crossing tasks."""

    def __init__(self, seed: int) -> None:

        self.random, self.model = np.random.default_rng(seed), RobotModel.load()
        self.collision, self.bodies = CollisionModel(self.model), bodies_of()

    def near(self) -> Array:
        """Joint angles, free by themselves, with the tool where both arms reach."""
        while True:
            q = self.random.uniform(self.model.lower, self.model.upper)
            x, y, z = self.model.frame(q).p
            if 0.1 < x < 0.28 and abs(y) < 0.12 and z < 0.25 and self.collision.is_free(q):
                return q

    def are_apart(self, q_left: Array, q_right: Array, room: float) -> bool:
        """Whether the arms at rest keep ``room`` [m] apart."""
        left, right = (Course.resting(q, 0.0) for q in (q_left, q_right))
        pair = (self.bodies, left), (self.bodies, right)
        return first_meeting(*pair, T_LEFT_RIGHT, since=0.0, room=room) is None

    def draw(self) -> tuple[list[Array], list[Array]]:
        """Two starts and two goals."""
        while True:
            starts, goals = [self.near(), self.near()], [self.near(), self.near()]
            middles = [0.5 * (a + b) for a, b in zip(starts, goals, strict=True)]
            if (
                self.are_apart(starts[0], starts[1], 0.03)
                and self.are_apart(goals[0], goals[1], 0.03)
                and not self.are_apart(middles[0], middles[1], 0.005)
            ):
                return starts, goals


CAPS = MotionLimits.uniform(velocity=np.pi / 2, acceleration=6.0, jerk=60.0)


def team_of(starts: list[Array], goals: list[Array], budget: float) -> list[TeamMember]:
    """Both arms with their starts and goals, and so much time for a search [s]."""
    return [
        TeamMember(
            name=name,
            T_cell_base=T,
            request=PlanRequest(q_start=a, goal=JointGoal(q=b), limits=CAPS, time_budget=budget),
        )
        for name, T, a, b in zip(
            ("left", "right"), (SE3.identity(), T_LEFT_RIGHT), starts, goals, strict=True
        )
    ]


def touching(solids: Solids, plans: Plans) -> tuple[int, int]:
    """At how many instants of a plan, every 5 ms, the arms touch; and how many there are."""
    left, right = (plans[name].trajectory for name in ("left", "right"))
    instants = np.arange(0.0, left.duration + 0.005, 0.005)
    found = 0
    for t in instants:
        found += solids.touch(*(np.append(each.at([t])[0][0], 0.0) for each in (left, right)))
    return found, len(instants)


def searched(count: int, seconds: float, seed: int) -> list[dict[str, object]]:
    """How much longer motions take than the shortest that a long search finds."""
    tasks, solids = Tasks(seed), Solids(SE3.identity(), T_LEFT_RIGHT)
    planner = Planner(tasks.model)
    planner.warm_up()
    ratios: list[float] = []
    tries: list[int] = []
    by: Counter[str] = Counter()
    at_bound = refused = 0
    while len(ratios) < count:
        starts, goals = tasks.draw()
        members = team_of(starts, goals, 5.0)
        try:
            ours = plan_together(planner, members)
        except PlanningError:
            continue
        search = LongSearch(
            planner, members, lambda plans: touching(solids, plans)[0] == 0, len(ratios)
        )
        found = search.run(ours, seconds)
        ratios.append(makespan(ours) / makespan(found.best))
        tries.append(sum(found.tries.values()))
        by[found.by] += 1
        at_bound, refused = at_bound + found.at_bound, refused + found.refused
        print(
            f"task {len(ratios)}: {makespan(ours):.2f} s, {ratios[-1]:.3f} of the shortest,"
            f" {found.by}, {tries[-1]} tries",
            flush=True,
        )
    return [
        {
            "what": "makespan over the shortest of a long search",
            "n": count,
            "median ratio": float(np.median(ratios)),
            "p90 ratio": float(np.percentile(ratios, 90.0)),
            "max ratio": max(ratios),
            "processor time of a search [s]": seconds,
            "tries, median": float(np.median(tries)),
            "nothing can be shorter": at_bound,
            "refused by the independent check": refused,
            **{f"shortest by {name}": number for name, number in sorted(by.items())},
        }
    ]


def plans(count: int, seed: int) -> list[dict[str, object]]:
    """Tasks planned together."""
    tasks, solids = Tasks(seed), Solids(SE3.identity(), T_LEFT_RIGHT)
    planner = Planner(tasks.model)
    planner.warm_up()

    def one_by_one(members: list[TeamMember]) -> float | None:
        """How long it takes one after the other [s]; None if that is impossible."""
        best = None
        for first, second in (members, members[::-1]):
            try:
                a = planner.plan(
                    replace(
                        first.request,
                        others=(second.seen_from(first, second.resting(second.request.q_start)),),
                    )
                )
                b = planner.plan(
                    replace(
                        second.request,
                        others=(first.seen_from(second, first.resting(a.q_goal)),),
                    )
                )
            except PlanningError:
                continue
            both = a.duration + b.duration
            best = both if best is None else min(best, both)
        return best

    wall: list[float] = []
    cpu: list[float] = []
    ratios: list[float] = []
    touched = failed = long = instants = 0
    for _ in range(count):
        starts, goals = tasks.draw()
        members = team_of(starts, goals, 5.0)
        begin, begin_cpu = time.perf_counter(), time.process_time()
        try:
            found = plan_together(planner, members)
        except PlanningError:
            failed += 1
            try:
                plan_together(planner, team_of(starts, goals, 60.0))
                long += 1
            except PlanningError:
                pass
            continue
        finally:
            wall.append(time.perf_counter() - begin)
            cpu.append(time.process_time() - begin_cpu)
        touches, looks = touching(solids, found)
        touched, instants = touched + touches, instants + looks
        apart = one_by_one(members)
        if apart is not None:
            ratios.append(makespan(found) / apart)
    solved = count - failed
    return [
        {
            "what": "plan and proof, wall",
            **summary(wall),
            "p95": float(np.percentile(wall, 95.0)),
        },
        {"what": "plan and proof, CPU", **summary(cpu), "p95": float(np.percentile(cpu, 95.0))},
        {
            "what": "solved",
            "n": count,
            "solved": solved,
            "only in 60 s": long,
            "instants": instants,
            "touching": touched,
            "makespan over one by one": float(np.median(ratios)) if ratios else float("nan"),
            "easier in turn impossible": solved - len(ratios),
        },
    ]


def rings(count: int, seed: int) -> list[dict[str, object]]:
    """One to eight arms that are planned together."""
    on_processor_time()
    planner, found = Planner(RobotModel.load()), list[dict[str, object]]()
    planner.warm_up()

    def plan(team: list[TeamMember]) -> tuple[Plans | None, float]:
        begin = time.thread_time()
        try:
            plans = plan_together(planner, team)
        except PlanningError:
            plans = None
        return plans, time.thread_time() - begin

    for arms, within in (
        (1, np.inf),
        (2, np.inf),
        (4, np.inf),
        (6, np.inf),
        (8, np.inf),
        (6, 0.15),
    ):
        radius = 0.5 * APART / np.sin(np.pi / max(arms, 2))
        crowd = Crowd(around(radius, arms=arms), seed, within)
        spent, spans, over = list[float](), list[float](), list[float]()
        instants = touched = 0
        for _ in range(count):
            ends = crowd.goals([]), crowd.goals([])
            for budget in (5.0, HURRY):
                team = [
                    TeamMember(
                        name=f"arm {k}",
                        T_cell_base=T,
                        request=PlanRequest(
                            q_start=a, goal=JointGoal(q=b), limits=FAST, time_budget=budget
                        ),
                    )
                    for k, (T, a, b) in enumerate(zip(crowd.bases, *ends, strict=True))
                ]
                plans, took = plan(team)
                if budget == HURRY:
                    over.append(took / budget)
                    continue
                spent.append(took)
                if plans is not None:
                    spans.append(makespan(plans))
                    along = (each.trajectory.q[::EVERY] for each in plans.values())
                    for q in zip(*along, strict=True):
                        instants += 1
                        touched += crowd.solids.touch(*(np.append(each, 0.0) for each in q))
        found.append(
            {
                "what": f"{arms} arms in a circle, {'crowded, ' if within < 1.0 else ''}CPU",
                **summary(spent),
                "p95": float(np.percentile(spent, 95.0)),
                "solved": len(spans),
                "makespan": float(np.median(spans)),
                "makespan, p95": float(np.percentile(spans, 95.0)),
                "instants": instants,
                "touching": touched,
                f"share of a budget of {HURRY} s, at most": max(over),
            }
        )
        print(found[-1], flush=True)
    return found


def components(count: int, seed: int) -> list[dict[str, object]]:
    """How much longer plans of one arm take with 30 components around it."""
    tasks = Tasks(seed)
    planner, random = Planner(tasks.model), np.random.default_rng(seed)
    planner.warm_up()

    def around(q: Array) -> Scene:
        """30 boxes around the arm, none in the way of a motion."""
        boxes: list[Obstacle] = []
        while len(boxes) < COMPONENTS:
            azimuth, away = random.uniform(-np.pi, np.pi), random.uniform(0.15, 1.0)
            p = [away * np.cos(azimuth), away * np.sin(azimuth), random.uniform(0.03, 0.4)]
            size = random.uniform(0.03, 0.15, 3)
            box = Obstacle(
                name=f"component {len(boxes)}",
                shape=Box(size=size),
                T_base_obstacle=SE3(rot_z(azimuth), np.array(p)),
            )
            wider = replace(box, shape=Box(size=size + 0.02))
            alone = CollisionModel(tasks.model, Scene(obstacles=(wider,)))
            if not alone.touching(q[::5]).any():
                boxes.append(box)
        return Scene(obstacles=tuple(boxes))

    def plan(q_start: Array, q_goal: Array, scene: Scene) -> tuple[float, Array]:
        request = PlanRequest(q_start=q_start, goal=JointGoal(q=q_goal), limits=CAPS, scene=scene)
        begin = time.process_time()
        made = planner.plan(request)
        return time.process_time() - begin, made.trajectory.q

    ratios: list[float] = []
    spent: list[float] = []
    first: list[float] = []
    while len(ratios) < count:
        q_start, q_goal, bare = tasks.near(), tasks.near(), Scene()
        try:
            _, q = plan(q_start, q_goal, bare)
            full = around(q)
            first.append(plan(q_start, q_goal, full)[0])
            pairs = [[plan(q_start, q_goal, scene)[0] for scene in (bare, full)] for _ in range(15)]
        except PlanningError:
            continue
        without, among = np.min(pairs, axis=0)
        ratios.append(float(among / without))
        spent.append(float(among))
    return [
        {"what": "a plan among 30 components, CPU", **summary(spent)},
        {"what": "the first plan among 30 components, CPU", **summary(first)},
        {
            "what": "a plan among 30 components over one without",
            "n": len(ratios),
            "median": float(np.median(ratios)),
            "p95": float(np.percentile(ratios, 95.0)),
            "max": max(ratios),
        },
    ]


def main() -> None:
    """Run all parts."""
    single_thread()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", type=int, default=500)
    parser.add_argument("--motions", type=int, default=200)
    parser.add_argument("--searched", type=int, default=40)
    parser.add_argument("--search-seconds", type=float, default=15.0)
    parser.add_argument("--rings", type=int, default=40, help="tasks of each number of arms")
    parser.add_argument("--only-search", action="store_true")
    parser.add_argument("--only-rings", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    if asked.only_rings:
        update("bench_cell", rings(asked.rings, asked.seed))
        return
    rows = searched(asked.searched, asked.search_seconds, asked.seed)
    if asked.only_search:
        update("bench_cell", rows)
        return
    rows = [*plans(asked.tasks, asked.seed), *rows, *components(asked.motions, asked.seed)]
    rows += rings(asked.rings, asked.seed)
    write("bench_cell", rows)


if __name__ == "__main__":
    main()
