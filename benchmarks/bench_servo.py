"""Cartesian jogging: time of a step, straightness, and distance kept from obstacles.

Twists, poses and points are held for 0.4 s each from random free configurations, alone over the
table and between three boxes, at 100 Hz. Every step counts, with the proof of its path to rest; in
the "held" ones something near slowed the tool. The closest approach is measured afterwards at every
step.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

from benchmarks import _common
from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
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
_jogged: Any = _common.from_tests("harness.jogged")


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


def jogging(scene: Scene) -> tuple[list[float], list[bool], float, float]:
    """Times of steps, which were held, closest approach, largest excess."""
    rng, judge = np.random.default_rng(SEED), CollisionModel(MODEL, scene)
    times, held = [], []
    closest, excess = np.inf, 0.0
    for _ in range(JOGS):
        q = free_posture(rng, judge)
        load = Load(MODEL, Strength.of_servos(7.4), q, None)
        jog = _jogged.Jogged(MODEL, scene, LIMITS, DT, q, load)
        wanted, qdd = target(rng), np.zeros(5)
        for k in range(STEPS):
            if k % HELD == 0:
                wanted = target(rng)
            begin = time.thread_time_ns()
            step = jog.step(wanted)
            times.append((time.thread_time_ns() - begin) * 1e-9)
            held.append(jog.is_held)
            closest = min(closest, judge.clearance(step.q).distance)
            excess = max(excess, float(np.max(np.abs(step.qdd) / LIMITS.acceleration)))
            excess = max(excess, float(np.max(np.abs(step.qd) / LIMITS.velocity)))
            excess = max(excess, float(np.max(np.abs(step.qdd - qdd) / (DT * LIMITS.jerk))))
            qdd = step.qdd
    return times, held, closest, excess


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
        moving = _jogged.Jogged(MODEL, None, LIMITS, DT, q)
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        jog = Twist(linear=0.1 * direction, angular=np.zeros(3))
        start, worst = MODEL.frame(q).p, 0.0
        for _ in range(150):
            step = moving.step(jog)
            way = MODEL.frame(step.q).p - start
            if moving.share < 0.2 or moving.is_held:
                break  # held by a limit or by something in the way
            worst = max(worst, float(np.linalg.norm(way - (way @ direction) * direction)))
        else:
            off.append(worst)
    return float(np.percentile(off, 95.0))


def main() -> None:
    """Run everything, print the table, write the results."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    _common.single_thread()
    rows: list[_common.Row] = []
    for name, scene in (("over the table", Scene()), ("between boxes", table_with_boxes())):
        times, held, closest, excess = jogging(scene)
        measured = {"clock": CPU, "closest_mm": closest * 1e3, "of limits": excess}
        rows.append({"what": f"step, {name}", **_common.summary(times), **measured})
        slowed = np.array(times)[np.array(held)]
        rows.append({"what": "  held", **_common.summary(slowed), "clock": CPU})
    print(f"off the line in jogs of 100 mm and more, 95 %: {straightness() * 1e3:.2f} mm")
    _common.write("bench_servo", rows)


if __name__ == "__main__":
    main()
