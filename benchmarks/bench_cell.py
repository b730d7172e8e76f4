"""Two arms that face each other at 350 mm: planned for together, and led into each other.

Tasks are drawn so that the tools begin and end where both arms reach, and so that arms that moved
in straight joint lines at the same pace would meet halfway. What is measured: how many tasks are
solved, how long planning and proof take, and how much sooner both are there than one after the
other. Then two leaders draw random motions that two guarded followings take up, in one cell.

Contact is judged by other means than planning: polytopes around the official solids (from
``tests/data/official_supports.json``, measured supports in 400 directions), looked at by coal at
single instants, every 5 ms of a plan and every tick of a following.

Last, what 30 components of a machine that stand around cost the plans of one arm: each motion is
planned without and with them, in turn, and of either the quickest of several times counts. They are
not in the way, so what is compared is the looking.

    python -m benchmarks.bench_cell --tasks 500 --ticks 100000
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._common import single_thread, summary, write
from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import SE3, Array, rot_z

SUPPORTS = Path(__file__).parents[1] / "tests" / "data" / "official_supports.json"
T_LEFT_RIGHT = SE3(rot_z(np.pi), np.array([0.35, 0.0, 0.0]))
LINK_OF_BASE = "base_link"
COMPONENTS = 30


class Solids:
    """Polytopes around the official solids of an arm, which coal holds against those of another."""

    def __init__(self) -> None:
        import coal
        import pinocchio as pin
        from scipy.spatial import HalfspaceIntersection

        from so101_motion.planning.collision.coal_shapes import convex_hull
        from so101_motion.planning.kinematics.model import RobotModel

        self._coal, self._pin = coal, pin
        self._model = RobotModel.load().pin_model
        self._data = self._model.createData()
        known = json.loads(SUPPORTS.read_text())
        k = np.arange(known["count"])
        z = 1.0 - 2.0 * (k + 0.5) / known["count"]
        azimuth = np.pi * (1.0 + np.sqrt(5.0)) * (k + 0.5)
        flat = np.sqrt(1.0 - z * z)
        directions = np.column_stack((flat * np.cos(azimuth), flat * np.sin(azimuth), z))
        self._shapes = {}
        for link, reach_mm in known["supports_mm"].items():
            reach = np.array(reach_mm) * 1e-3
            inside = np.linalg.lstsq(directions, reach, rcond=None)[0]
            planes = np.column_stack((directions, -reach))
            corners = HalfspaceIntersection(planes, inside).intersections
            self._shapes[link] = convex_hull(corners)

    def placed(self, q: Array, T: SE3) -> dict[str, tuple[Any, Any]]:
        """The polytopes of an arm at six joint angles whose base is at ``T``."""
        pin, model = self._pin, self._model
        pin.framesForwardKinematics(model, self._data, q)
        base = pin.SE3(np.array(T.R), np.array(T.p))
        found = {}
        for link, shape in self._shapes.items():
            place = base * self._data.oMf[model.getFrameId(link)]
            found[link] = shape, self._coal.Transform3s(place.rotation, place.translation)
        return found

    def touch(self, q_left: Array, q_right: Array) -> bool:
        """Whether the arms touch at configurations of five joints and the jaw."""
        left, right = self.placed(q_left, SE3.identity()), self.placed(q_right, T_LEFT_RIGHT)
        coal = self._coal
        for (a, (shape_a, T_a)), (b, (shape_b, T_b)) in product(left.items(), right.items()):
            if a == b == LINK_OF_BASE:
                continue
            request, result = coal.CollisionRequest(), coal.CollisionResult()
            if coal.collide(shape_a, T_a, shape_b, T_b, request, result):
                return True
        return False


class Tasks:
    """Draws crossing tasks."""

    def __init__(self, seed: int) -> None:
        from so101_motion.planning.collision.arm_bodies import bodies_of
        from so101_motion.planning.collision.collision import CollisionModel
        from so101_motion.planning.kinematics.model import RobotModel

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
        from so101_motion.planning.collision.apart import first_meeting
        from so101_motion.planning.collision.course import Course

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


def plans(count: int, seed: int) -> list[dict[str, object]]:
    """Tasks planned together."""
    from so101_motion.planning.cell.together import TeamMember, plan_together
    from so101_motion.planning.goals import JointGoal
    from so101_motion.planning.planner import Planner
    from so101_motion.planning.request import PlanRequest
    from so101_motion.planning.timing.limits import MotionLimits

    caps = MotionLimits.uniform(velocity=np.pi / 2, acceleration=6.0, jerk=60.0)
    tasks, solids = Tasks(seed), Solids()
    planner = Planner(tasks.model)
    planner.warm_up()

    def team(starts: list[Array], goals: list[Array], budget: float) -> list[TeamMember]:
        return [
            TeamMember(
                name=name,
                T_cell_base=T,
                request=PlanRequest(
                    q_start=a, goal=JointGoal(q=b), limits=caps, time_budget=budget
                ),
            )
            for name, T, a, b in zip(
                ("left", "right"), (SE3.identity(), T_LEFT_RIGHT), starts, goals, strict=True
            )
        ]

    def one_by_one(members: list[TeamMember]) -> float | None:
        """How long it takes if one waits until the other has arrived; None if that cannot be."""
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
    touching = failed = long = instants = 0
    for _ in range(count):
        starts, goals = tasks.draw()
        members = team(starts, goals, 5.0)
        begin, begin_cpu = time.perf_counter(), time.process_time()
        try:
            found = plan_together(planner, members)
        except PlanningError:
            failed += 1
            try:
                plan_together(planner, team(starts, goals, 60.0))
                long += 1
            except PlanningError:
                pass
            continue
        finally:
            wall.append(time.perf_counter() - begin)
            cpu.append(time.process_time() - begin_cpu)
        left, right = (found[name].trajectory for name in ("left", "right"))
        for t in np.arange(0.0, left.duration + 0.005, 0.005):
            q = [np.append(each.at([t])[0][0], 0.0) for each in (left, right)]
            touching += solids.touch(*q)
            instants += 1
        apart = one_by_one(members)
        if apart is not None:
            ratios.append(max(each.duration for each in found.values()) / apart)
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
            "touching": touching,
            "makespan over one by one": float(np.median(ratios)) if ratios else float("nan"),
            "easier in turn impossible": solved - len(ratios),
        },
    ]


def followings(ticks: int, seed: int) -> list[dict[str, object]]:
    """Two leaders drive two guarded followings into each other."""
    from concurrent.futures import ThreadPoolExecutor

    from so101_motion.arm.cell import Cell
    from so101_motion.common.clock import ManualClock
    from so101_motion.control.following import Following
    from so101_motion.planning.timing.limits import MotionLimits
    from so101_motion.rig.hardware_rig import Rig, open_simulated

    caps = MotionLimits.uniform(velocity=np.pi, acceleration=8.0, jerk=150.0)
    tasks, solids, clock = Tasks(seed), Solids(), ManualClock()
    starts, _ = tasks.draw()
    spent: list[float] = []
    touching = held = 0
    with (
        open_simulated(clock=clock, q_start=starts[0]) as one,
        open_simulated(clock=clock, q_start=starts[1]) as other,
    ):
        cell = Cell()
        for name, rig, T in (("left", one, SE3.identity()), ("right", other, T_LEFT_RIGHT)):
            cell.add(name, rig, T)

        def opened(rig: Rig) -> Following:
            with ThreadPoolExecutor(1) as threads:
                done = threads.submit(
                    rig.arm.open_following, limits=caps, stale_after=None, gate=10.0
                )
                while not done.done():
                    clock.advance(0.01)
            return done.result()

        led = [opened(rig) for rig in (one, other)]
        left_for = [0, 0]
        for _ in range(ticks):
            for k, following in enumerate(led):
                if left_for[k] == 0:
                    following.aim(tasks.near())
                    left_for[k] = int(tasks.random.integers(10, 120))
                left_for[k] -= 1
                held += any("'s " in each for each in following.held_by)
            begin = time.process_time()
            clock.advance(0.01)
            spent.append(time.process_time() - begin)
            q = [np.append(rig.arm.state.q_ref, rig.arm.state.q_jaw) for rig in (one, other)]
            touching += solids.touch(*q)
        for following in led:
            following.close()
    return [
        {
            "what": "two guarded followings, both ticks, CPU",
            **summary(spent),
            "touching": touching,
            "held by the other": held / (2 * ticks),
        }
    ]


def components(count: int, seed: int) -> list[dict[str, object]]:
    """What 30 components that stand around cost the plans of one arm."""
    from so101_motion.planning.collision.collision import CollisionModel
    from so101_motion.planning.collision.scene import Box, Obstacle, Scene
    from so101_motion.planning.goals import JointGoal
    from so101_motion.planning.planner import Planner
    from so101_motion.planning.request import PlanRequest
    from so101_motion.planning.timing.limits import MotionLimits

    caps = MotionLimits.uniform(velocity=np.pi / 2, acceleration=6.0, jerk=60.0)
    tasks = Tasks(seed)
    planner, random = Planner(tasks.model), np.random.default_rng(seed)
    planner.warm_up()

    def around(q: Array) -> Scene:
        """30 boxes as a machine has them, none of them on the way of a motion."""
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
        request = PlanRequest(q_start=q_start, goal=JointGoal(q=q_goal), limits=caps, scene=scene)
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
    parser.add_argument("--ticks", type=int, default=100_000)
    parser.add_argument("--motions", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    rows = [*plans(asked.tasks, asked.seed), *followings(asked.ticks, asked.seed)]
    write("bench_cell", [*rows, *components(asked.motions, asked.seed)])


if __name__ == "__main__":
    main()
