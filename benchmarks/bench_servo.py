"""Cartesian jogging: time of a step, straightness, and distance kept from obstacles.

Twists, poses and points are held for 0.4 s each from random free configurations, alone over the
table and between three boxes, at 100 Hz. Every step counts; in the "constrained" ones a limit or an
obstacle was active, so that the quadratic program was solved. Distances of all bodies near each
other are part of every step. The closest approach is measured afterwards at every step.

The quadratic program alone is compared with the same program through qpsolvers, which sets OSQP up
anew at each call.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks import _common
from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.planning.differential.servo import Servo
from so101_motion.planning.differential.servo_qp import WORTH, ServoQp
from so101_motion.planning.differential.targets import Target, Twist
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Load, Strength

DT = 0.01
JOGS, STEPS, HELD = 40, 300, 40
SEED = 5
LIMITS = MotionLimits.uniform(velocity=np.radians(90.0), acceleration=5.0, jerk=100.0)
CPU = "CPU of the thread"

MODEL = RobotModel.load()


class Watched(ServoQp):
    """Notes the programs it is given, and how long each took."""

    def __init__(self) -> None:
        super().__init__()
        self.programs: list[tuple[Array, ...]] = []
        self.times: list[float] = []

    def solve(
        self, J: Array, w: Array, lower: Array, upper: Array, G: Array, b: Array
    ) -> tuple[Array, float]:
        """As ``ServoQp``."""
        begin = time.thread_time_ns()
        solution = super().solve(J, w, lower, upper, G, b)
        self.times.append((time.thread_time_ns() - begin) * 1e-9)
        given = (J, w, lower, upper, G, b)  # they are overwritten in the next step
        self.programs.append((*map(np.array, given), solution[0]))
        return solution


def table_with_boxes() -> Scene:
    """Three boxes around the arm."""
    places = {
        "left": ([0.10, 0.10, 0.20], [0.25, 0.15, 0.10]),
        "right": ([0.10, 0.10, 0.20], [0.25, -0.15, 0.10]),
        "beside": ([0.10, 0.10, 0.10], [0.05, 0.25, 0.05]),
    }
    return Scene(
        obstacles=tuple(
            Obstacle(
                name=name,
                shape=Box(size=np.array(size)),
                T_base_obstacle=SE3.from_translation(place),
            )
            for name, (size, place) in places.items()
        )
    )


def target(rng: np.random.Generator) -> Target:
    """A random next target, as from a pendant."""
    kind = rng.random()
    if kind < 0.7:
        angular = rng.normal(size=3) * rng.choice([0.0, 0.5])
        return Twist(linear=0.1 * rng.normal(size=3), angular=angular)
    if kind < 0.85:
        return MODEL.frame(rng.uniform(MODEL.lower, MODEL.upper))
    return rng.uniform([-0.1, -0.35, 0.02], [0.4, 0.35, 0.35])


def jogging(scene: Scene) -> tuple[list[float], list[bool], Watched, float, float]:
    """Times of steps, which were constrained, the programs, closest approach, largest excess."""
    rng, collision, judge = (
        np.random.default_rng(SEED),
        CollisionModel(MODEL, scene),
        CollisionModel(MODEL, scene),
    )
    times, constrained, watched = [], [], Watched()
    closest, excess = np.inf, 0.0
    for _ in range(JOGS):
        q = free_posture(rng, judge)
        load = Load(MODEL, Strength.of_servos(7.4), q, None)
        servo = Servo(MODEL, collision, LIMITS, DT, q, load=load)
        servo._qp = watched
        wanted, qdd = target(rng), np.zeros(5)
        for k in range(STEPS):
            if k % HELD == 0:
                wanted = target(rng)
            before = len(watched.times)
            begin = time.thread_time_ns()
            step = servo.step(wanted)
            times.append((time.thread_time_ns() - begin) * 1e-9)
            constrained.append(len(watched.times) > before)
            closest = min(closest, judge.clearance(step.q).distance)
            excess = max(excess, float(np.max(np.abs(step.qdd) / LIMITS.acceleration)))
            excess = max(excess, float(np.max(np.abs(step.qd) / LIMITS.velocity)))
            excess = max(excess, float(np.max(np.abs(step.qdd - qdd) / (DT * LIMITS.jerk))))
            qdd = step.qdd
    return times, constrained, watched, closest, excess


def free_posture(rng: np.random.Generator, judge: CollisionModel) -> Array:
    """A random posture that is free."""
    while True:
        q = rng.uniform(MODEL.lower, MODEL.upper)
        if judge.is_free(q):
            return q


def straightness() -> float:
    """How far the tool gets from its line in jogs of 100 mm and more, in 95 of 100 [m]."""
    rng, collision = np.random.default_rng(SEED), CollisionModel(MODEL)
    off: list[float] = []
    while len(off) < 100:
        q = free_posture(rng, collision)
        servo = Servo(MODEL, collision, LIMITS, DT, q)
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        jog = Twist(linear=0.1 * direction, angular=np.zeros(3))
        start, worst = MODEL.frame(q).p, 0.0
        for _ in range(150):
            step = servo.step(jog)
            way = MODEL.frame(step.q).p - start
            if step.share < 0.2 and len(servo.held_by()):
                break  # held by a limit or by something in the way
            worst = max(worst, float(np.linalg.norm(way - (way @ direction) * direction)))
        else:
            off.append(worst)
    return float(np.percentile(off, 95.0))


def as_problem(
    J: Array, w: Array, lower: Array, upper: Array, G: Array, b: Array
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """The program of ``ServoQp.solve`` in the form of qpsolvers: ``P, q, G, h, lb, ub``.

    The unknowns are the velocities in units of the largest of the task velocity, and the share.
    """
    size = float(np.abs(w).max())
    w = w / size
    M = (J.T * [25.0, 25.0, 25.0, 0.05, 0.05, 0.05]) @ J + 0.05 * np.eye(5)
    worth = float(w @ M @ w)
    Mw = (M @ w)[:, None]
    P = np.block([[M, -Mw], [-Mw.T, np.array([[worth * (1.0 + WORTH)]])]]) / worth
    q = np.append(np.zeros(5), -WORTH)
    rows = np.hstack((-G, np.zeros((len(G), 1))))
    return P, q, rows, -b / size, np.append(lower / size, 0.0), np.append(upper / size, 1.0)


def through_qpsolvers(programs: Sequence[tuple[Array, ...]]) -> tuple[list[float], float] | None:
    """The same programs through qpsolvers with OSQP: times, and the median difference [rad/s]."""
    try:
        import qpsolvers
        from scipy import sparse
    except ImportError:
        return None

    times: list[float] = []
    apart: list[float] = []
    for J, w, lower, upper, G, b, solution in programs:
        P, q, A, h, lb, ub = as_problem(J, w, lower, upper, G, b)
        P_sparse, A_sparse = sparse.csc_matrix(P), sparse.csc_matrix(A)
        begin = time.thread_time_ns()
        x: Any = qpsolvers.solve_qp(
            P_sparse, q, A_sparse, h, lb=lb, ub=ub, solver="osqp", eps_abs=1e-6, eps_rel=1e-6
        )
        times.append((time.thread_time_ns() - begin) * 1e-9)
        if x is not None:
            apart.append(float(np.abs(np.abs(w).max() * x[:5] - solution).max()))
    return times, float(np.median(apart))


def main() -> None:
    """Run everything, print the table, write the results."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    _common.single_thread()
    rows: list[_common.Row] = []
    programs: list[tuple[Array, ...]] = []
    qp_times: list[float] = []
    for name, scene in (("over the table", Scene()), ("between boxes", table_with_boxes())):
        times, constrained, watched, closest, excess = jogging(scene)
        measured = {"clock": CPU, "closest_mm": closest * 1e3, "of limits": excess}
        rows.append({"what": f"step, {name}", **_common.summary(times), **measured})
        solved = np.array(times)[np.array(constrained)]
        rows.append({"what": "  constrained", **_common.summary(solved), "clock": CPU})
        programs += watched.programs
        qp_times += watched.times
    rows.append({"what": "program, OSQP kept alive", **_common.summary(qp_times), "clock": CPU})
    other = through_qpsolvers(programs[:: max(1, len(programs) // 500)])
    if other is not None:
        row = {"what": "program, qpsolvers + osqp", **_common.summary(other[0]), "clock": CPU}
        rows.append(row | {"apart_rad_s": other[1]})
    print(f"off the line in jogs of 100 mm and more, 95 %: {straightness() * 1e3:.2f} mm")
    _common.write("bench_servo", rows, peers=("osqp", "qpsolvers"))


if __name__ == "__main__":
    main()
