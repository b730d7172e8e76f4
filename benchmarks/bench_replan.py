"""Motions that are planned again while they move, among obstacles that move.

Three parts. *Runs*: from one random configuration to another, with one to five balls and boxes that
move through the arm's space at up to 0.3 m/s; the arm gets a new scene every 40 ms. The clock is
simulated, and each plan is there as long after it was asked for as it took, times ``--slow`` (at
least 10 ms). Every 10 ms the arm, where it is commanded to be, is checked with the obstacles where
they truly are. A contact of an arm that moves counts, unless a stop begun 50 ms after the first
scene in which its way was blocked would have met the obstacle as well: then stopping was not
possible. A goal where something is too often for a move to it counts apart. *Switches*: a new goal
every 300 ms. *Latency*: in real time, with the planning process and the executor at 100 Hz, from a
new scene that blocks the way, and from a new goal, to the first setpoint that is another one; and
how long the check takes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import _common
from so101_motion.arm import replanned_motion
from so101_motion.common.clock import ManualClock, MonotonicClock
from so101_motion.common.errors import Interrupted, So101Error
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.realtime import reduce_jitter
from so101_motion.common.state import JointState
from so101_motion.common.units import to_rad
from so101_motion.drivers.simulated import SimArm
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Box, Obstacle, Scene, Sphere
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner
from so101_motion.planning.request import Plan, PlanRequest
from so101_motion.planning.timing import online
from so101_motion.rig.rig import HARD_STOP, TICK, Rig
from so101_motion.rig.simulated_rig import open_simulated

SEED = 49
TOGETHER = 10  # runs of one arm, between which a benchmark that was interrupted is resumed
SCENES_EVERY = 4  # ticks
AT_ONCE = 10  # ticks that are first examined together for contact
FASTEST = 0.3  # of an obstacle [m/s]
MARGIN = 0.02  # that the arm keeps from obstacles [m]
LONGEST = 30.0  # a run that takes longer has not reached its goal [s]
OPEN = 2.0  # a goal is open if nothing is there for so long, a move's time, within a run [s]
RESPONSE = 0.05  # from a scene to new setpoints [s]
SWITCH_EVERY = 0.3  # of the goal [s]


@dataclass(frozen=True)
class Moving:
    """An obstacle that goes to and fro between two points."""

    shape: Box | Sphere
    p_from: Array
    p_to: Array
    speed: float

    def at(self, t: float) -> Array:
        """Where it is at a time [s]."""
        length = max(float(np.linalg.norm(self.p_to - self.p_from)), 1e-9)
        along = (t * self.speed / length) % 2.0
        return self.p_from + (self.p_to - self.p_from) * min(along, 2.0 - along)


def scene_at(moving: list[Moving], t: float, margin: float) -> Scene:
    """The scene at a time [s]."""
    things = tuple(
        Obstacle(name=f"thing {i}", shape=each.shape, T_base_obstacle=SE3.from_translation(p))
        for i, each in enumerate(moving)
        for p in [each.at(t)]
    )
    return Scene(obstacles=things, margin=margin)


class SimulatedPlanner:
    """Plans in this thread; the answer is there after a time on the simulated clock."""

    def __init__(self, model: RobotModel, clock: ManualClock, slow: float) -> None:
        self._planner, self._clock, self._slow = Planner(model), clock, slow
        self._planner.warm_up()
        self._due: list[tuple[float, Callable[[], None]]] = []
        self.took: list[float] = []

    def plan(self, request: PlanRequest) -> Future[Plan]:
        """Like that of a ``PlanningWorker``."""
        answer: Future[Plan] = Future()
        begin = time.thread_time()
        try:
            plan = self._planner.plan(request)
        except So101Error as error:
            found: Any = error
        else:
            found = plan
        took = time.thread_time() - begin
        self.took.append(took)

        def give() -> None:
            if answer.set_running_or_notify_cancel():
                if isinstance(found, So101Error):
                    answer.set_exception(found)
                else:
                    answer.set_result(found)

        if request.lead is None:
            give()
        else:
            self._due.append((self._clock.now() + max(self._slow * took, 0.01), give))
        return answer

    def note(self, state: JointState) -> None:
        """Give what is due; called in every tick."""
        due = [give for t, give in self._due if t <= state.t]
        self._due = [each for each in self._due if each[0] > state.t]
        for give in due:
            give()


@contextmanager
def planning_here(model: RobotModel, clock: ManualClock, slow: float) -> Iterator[Rig]:
    """A simulated arm without a planning process."""
    _common.on_processor_time()
    planner = SimulatedPlanner(model, clock, slow)
    speed, acceleration = to_rad(90.0), to_rad(100.0)
    with Rig(
        SimArm(clock), clock=clock, speed=speed, acceleration=acceleration, scene=Scene()
    ) as rig:
        rig.arm._planner = planner.plan
        rig.executor.listen(planner.note)
        yield rig


VERDICTS: list[Callable[[bool], None]] = []
"""Told whether what is played was found free, or is from now on."""


def watch() -> None:
    """Let ``VERDICTS`` know what replanned motions find."""
    motion: Any = replanned_motion.ReplannedMotion
    check, join = motion._check, motion._join

    def checked(self: Any, *args: Any) -> Any:
        before = self._joining
        found = check(self, *args)
        for tell in VERDICTS if self._joining is before else ():
            tell(True)
        return found

    def joined(self: Any, *args: Any, reaches: bool) -> Any:
        for tell in VERDICTS:
            tell(reaches)
        return join(self, *args, reaches=reaches)

    motion._check, motion._join = checked, joined


class Tape:
    """What was commanded, tick by tick."""

    def __init__(self) -> None:
        self.t: list[float] = []
        self.q: list[Array] = []

    def note(self, state: JointState) -> None:
        """Called in every tick."""
        self.t.append(state.t)
        self.q.append(np.array(state.q_ref))


class Course:
    """Draws goals and obstacles."""

    def __init__(self, model: RobotModel, seed: int) -> None:
        self.rng, self._model = np.random.default_rng(seed), model
        self._alone = CollisionModel(model, Scene(margin=0.05))

    def goal(self) -> Array:
        """A configuration that is free without obstacles, and well above the floor."""
        lower, upper = 0.7 * self._model.lower, 0.7 * self._model.upper
        while True:
            q = self.rng.uniform(lower, upper)
            if self._alone.is_free(q):
                return q

    def obstacles(self, count: int, off: tuple[Array, ...]) -> list[Moving]:
        """Obstacles that are not in the way of the arm at ``off`` at the beginning."""
        while True:
            moving = []
            for _ in range(count):
                size = float(self.rng.uniform(0.02, 0.04))
                cube = Box(size=np.full(3, 2.0 * size))
                shape = Sphere(radius=size) if self.rng.random() < 0.5 else cube
                p_from, p_to = self.rng.uniform((-0.3, -0.3, 0.08), (0.35, 0.3, 0.4), (2, 3))
                speed = float(self.rng.uniform(0.05, FASTEST))
                moving.append(Moving(shape, p_from, p_to, speed))
            check = CollisionModel(self._model, scene_at(moving, 0.0, 0.05))
            if all(check.is_free(q) for q in off):
                return moving


def one_run(rig: Rig, clock: ManualClock, course: Course, model: RobotModel) -> dict[str, Any]:
    """One run among moving obstacles; where the arm is at its beginning is where it starts."""
    arm = rig.arm
    goal, begin, tape = course.goal(), clock.now(), Tape()
    moving = course.obstacles(int(course.rng.integers(1, 6)), (arm.state.q_ref, goal))
    end_of_tape = rig.executor.listen(tape.note)
    verdicts: list[tuple[float, bool]] = []  # whether the way is free, and since when
    VERDICTS.append(lambda is_free: verdicts.append((clock.now(), is_free)))
    scenes, outcome = 0, "reached"
    arm.scene = scene_at(moving, 0.0, MARGIN)
    motion = arm.move(goal, replan=True, wait=False)
    while not motion.future.done() and clock.now() - begin < LONGEST:
        clock.advance(TICK)
        scenes += 1
        if scenes % SCENES_EVERY == 0:
            arm.scene = scene_at(moving, clock.now() - begin, MARGIN)
    if not motion.future.done():
        motion.interrupt("time")
        outcome = "time"
    while not motion.future.done():
        clock.advance(TICK)
    error = motion.future.exception()
    if error is not None and outcome == "reached":
        outcome = type(error).__name__
    VERDICTS.clear()
    end_of_tape()
    q, t = np.array(tape.q), np.array(tape.t)
    touches = _touching(model, moving, t - begin, q)
    moves = np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-6
    contacts = 1 + np.flatnonzero(touches[1:] & ~touches[:-1] & moves)
    avoidable = sum(_was_avoidable(model, moving, begin, t, q, int(k), verdicts) for k in contacts)
    speed = np.abs(np.diff(q, axis=0)).max(axis=0) / TICK / arm.effective_limits(None).velocity
    arm.scene = Scene()
    return {
        "outcome": outcome,
        "contacts": len(contacts),
        "avoidable": avoidable,
        "seconds": float(t[-1] - begin),
        "speed": float(speed.max()),
        "blocked": sum(not is_free for _, is_free in verdicts),
        "open": outcome == "reached" or _is_open(model, moving, goal),
    }


def _is_open(model: RobotModel, moving: list[Moving], goal: Array) -> bool:
    """Whether nothing is at the goal for as long as a move takes, within the time of a run."""
    free = 0.0
    for at in np.arange(0.0, LONGEST, 0.1):
        is_free = CollisionModel(model, scene_at(moving, at, MARGIN)).is_free(goal)
        free = free + 0.1 if is_free else 0.0
        if free > OPEN:
            return True
    return False


def _touching(model: RobotModel, moving: list[Moving], t: Array, q: Array) -> NDArray[np.bool_]:
    """At which ticks the arm touches something."""
    touches = np.zeros(len(t), dtype=bool)
    for begin in range(0, len(t), AT_ONCE):
        some = slice(begin, begin + AT_ONCE)
        middle = 0.5 * (t[some][0] + t[some][-1])
        room = FASTEST * (t[some][-1] - middle) + 1e-6  # nothing goes further until then
        if CollisionModel(model, scene_at(moving, middle, room)).touching(q[some]).any():
            touches[some] = [
                not CollisionModel(model, scene_at(moving, at, 1e-6)).is_free(each)
                for at, each in zip(t[some], q[some], strict=True)
            ]
    return touches


def _was_avoidable(
    model: RobotModel,
    moving: list[Moving],
    begin: float,
    t: Array,
    q: Array,
    k: int,
    verdicts: list[tuple[float, bool]],
) -> bool:
    """Whether a stop soon after it was known that the way is not free avoids the contact."""
    known = t[k]
    for at, is_free in reversed([each for each in verdicts if each[0] <= t[k]]):
        if is_free:
            break
        known = at
    at = int(np.searchsorted(t, known + RESPONSE))
    if at >= k:
        return False
    qd, qdd = (q[at] - q[at - 1]) / TICK, (q[at] - 2 * q[at - 1] + q[at - 2]) / TICK**2
    stop = online.stop(q[at], qd, qdd, HARD_STOP, TICK)
    return all(
        CollisionModel(model, scene_at(moving, t[at] + i * TICK - begin, 1e-6)).is_free(each)
        for i, each in enumerate(stop.q[:-1])
    )


def piece(first: int, slow: float) -> list[dict[str, Any]]:
    """``TOGETHER`` runs, one after the other, on the simulated clock."""
    clock, model, found = ManualClock(), RobotModel.load(), []
    course = Course(model, SEED + first)
    with planning_here(model, clock, slow) as rig:
        for number in range(first, first + TOGETHER):
            found.append(one_run(rig, clock, course, model))
            print(number, found[-1], flush=True)
    return found


def runs(count: int, slow: float, since: str | None) -> _common.Row:
    """Runs among moving obstacles."""
    watch()
    pieces = {
        f"runs from {first}, slow {slow}": partial(piece, first, slow)
        for first in range(0, count, TOGETHER)
    }
    found = sum(_common.in_pieces("bench_replan", pieces, since), list[dict[str, Any]]())
    outcomes = [each["outcome"] for each in found]
    return {
        "what": "runs among moving obstacles",
        "n": len(found),
        "reached": outcomes.count("reached") / len(found),
        "reached of open goals": outcomes.count("reached") / sum(each["open"] for each in found),
        "other": {each: outcomes.count(each) for each in set(outcomes) - {"reached"}},
        "contacts": sum(each["contacts"] for each in found),
        "avoidable": sum(each["avoidable"] for each in found),
        "speed": max(each["speed"] for each in found),
        "blocked": sum(each["blocked"] for each in found),
    }


class FirstOther:
    """Notes when the first setpoint is not one of a motion's."""

    def __init__(self) -> None:
        self.old: Array | None = None
        self.at: float | None = None

    def note(self, state: JointState) -> None:
        """Called in every tick."""
        old = self.old
        if old is not None and self.at is None and np.abs(old - state.q_ref).max(1).min() > 1e-7:
            self.at = time.monotonic()


def latency(count: int) -> list[_common.Row]:
    """In real time: from a new scene that blocks the way, and from a new goal, to new setpoints."""
    reduce_jitter()
    course, checks = Course(RobotModel.load(), SEED), list[float]()
    times: dict[str, list[float]] = {"scene": [], "goal": []}
    motions: Any = replanned_motion.ReplannedMotion
    check = motions._check

    def timed(self: Any, *args: Any) -> Any:
        begin, before = time.thread_time(), self._joining
        found = check(self, *args)
        if self._joining is before:  # else it has made a stop as well
            checks.append(time.thread_time() - begin)
        return found

    motions._check = timed
    with open_simulated(clock=MonotonicClock()) as rig:
        arm, first = rig.arm, FirstOther()
        rig.executor.listen(first.note)
        arm.plan(course.goal())  # by then the planning process has begun
        goals = (np.array([0.9, -0.3, 0.3, 0.3, 0.0]), np.array([-0.9, 0.0, 0.3, 0.0, 0.5]))
        for number in range(count):
            arm.scene = Scene()
            arm.move(goals[number % 2])
            motion = arm.move(goals[1 - number % 2], replan=True, wait=False)
            while not arm.state.arm_moving:
                time.sleep(0.01)
            time.sleep(float(course.rng.uniform(0.25, 0.45)))
            playing = motion.playing
            assert playing is not None
            old, k = playing.played
            first.at, first.old = None, old.q[k:]
            what = ("scene", "goal")[number // 2 % 2]
            begin = time.monotonic()
            if what == "scene":
                end = RobotModel.load().frame(old.q[(k + len(old)) // 2]).p
                T = SE3.from_translation(end)
                ball = Obstacle(name="ball", shape=Sphere(radius=0.02), T_base_obstacle=T)
                arm.scene = Scene(obstacles=(ball,))
            else:
                motion = arm.move(np.array([0.0, -0.6, 0.6, 0.6, 0.0]), replan=True, wait=False)
            while first.at is None:
                time.sleep(0.005)
            times[what].append(first.at - begin)
            first.old = None
            arm.stop()
    rows: list[_common.Row] = [
        {"what": f"new {what} to new setpoints", **_common.summary(each)}
        for what, each in times.items()
    ]
    return [*rows, {"what": "check of what is left", **_common.summary(checks)}]


def switches(seconds: float, slow: float) -> _common.Row:
    """A new goal every 300 ms, on the simulated clock."""
    clock, model = ManualClock(), RobotModel.load()
    course, tape = Course(model, SEED), Tape()
    with planning_here(model, clock, slow) as rig:
        rig.executor.listen(tape.note)
        failed = 0
        while clock.now() < seconds:
            before = rig.arm.newest_motion
            motion = rig.arm.move(course.goal(), replan=True, wait=False)
            failed += before.future.done() and not isinstance(
                before.future.exception(), Interrupted | None
            )
            clock.advance(SWITCH_EVERY)
        while not motion.future.done():
            clock.advance(TICK)
        limits = rig.arm.effective_limits(None)
    q = np.array(tape.q)
    speed, acceleration, jerk = (
        float((np.abs(np.diff(q, n, axis=0)) / TICK**n / cap).max())
        for n, cap in ((1, limits.velocity), (2, limits.acceleration), (3, limits.jerk))
    )
    return {
        "what": "a new goal every 300 ms",
        "n": round(seconds / SWITCH_EVERY),
        "failed": failed,
        "speed": speed,
        "acceleration": acceleration,
        "jerk": jerk,
    }


def main() -> None:
    """Run all parts and write the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--changes", type=int, default=400, help="in real time")
    parser.add_argument("--seconds", type=float, default=3600.0, help="of switching goals")
    parser.add_argument("--slow", type=float, default=1.0)
    parser.add_argument(
        "--since", metavar="COMMIT", help="use the pieces of an earlier commit, too"
    )
    options = parser.parse_args()
    _common.single_thread()
    rows = list[_common.Row]()
    if options.runs:
        rows.append(runs(options.runs, options.slow, options.since))
    if options.changes:
        rows += latency(options.changes)
    if options.seconds:
        rows.append(switches(options.seconds, options.slow))
    print(rows)
    _common.update("bench_replan", rows)


if __name__ == "__main__":
    main()
