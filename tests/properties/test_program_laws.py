"""Laws of passed waypoints: passed in order and near enough, within every cap, in less time.

Smooth paths, sharp turns and paths to and fro, with obstacles and without.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from harness.random_scenes import obstacle
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from so101_motion.arm.cell_member import Stand
from so101_motion.common.errors import PlanningError
from so101_motion.common.units import to_rad
from so101_motion.planning.collision.scene import Scene, Sphere
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner
from so101_motion.planning.request import Plan, PlanRequest
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.tasks.guided.path import JAW_TOLERANCE, GuidedPath, along
from so101_motion.tasks.program import ARM, Program, Waypoint
from so101_motion.tasks.program.rehearsal import PASSING, Leg, plan_leg

MODEL = RobotModel.load()
CAPS = [
    MotionLimits.uniform(
        velocity=to_rad(velocity), acceleration=to_rad(acceleration), jerk=to_rad(10 * acceleration)
    )
    for velocity, acceleration in ((90.0, 100.0), (180.0, 500.0), (30.0, 300.0))
]
SCENES = [Scene(), Scene(obstacles=(obstacle("ball", Sphere(radius=0.05), (0.3, 0.0, 0.25)),))]


class Arm:
    """What plans for one, in this process."""

    PLANNER = Planner(MODEL)

    def __init__(self, limits: MotionLimits, scene: Scene) -> None:
        self.limits, self.scene = limits, scene

    def plan_together(self, goals, *, limits, stands) -> dict[str, Plan]:
        request = PlanRequest(
            q_start=stands[ARM].q,
            goal=goals[ARM],
            limits=limits[ARM],
            q_jaw=stands[ARM].q_jaw,
            scene=self.scene,
        )
        return {ARM: self.PLANNER.plan(request)}


@st.composite
def ways(draw) -> np.ndarray:
    """Where a program leads, its start first, shape (m, 5), [rad]."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    m = draw(st.integers(3, 7))
    kind = draw(st.sampled_from(["smooth", "sharp", "to and fro"]))
    if kind == "smooth":
        return np.cumsum(rng.normal(0.0, 0.2, (m, 5)), axis=0).clip(-1.4, 1.4)
    if kind == "sharp":
        return 0.5 * rng.uniform(MODEL.lower, MODEL.upper, (m, 5))
    return np.array([*0.4 * rng.uniform(MODEL.lower, MODEL.upper, (2, 5))] * m)[:m]


def leg(arm: Arm, way: np.ndarray) -> Leg:
    places = [Waypoint(name=f"{k}", q=q, passes=True) for k, q in enumerate(way[1:])]
    stands, caps = {ARM: Stand(way[0], 0.0)}, {ARM: arm.limits}
    program = Program.of_waypoints(places)
    return plan_leg(arm.plan_together, program, range(len(places)), stands, caps)


TO_AND_FRO = [  # as far apart as a passed place may be missed, and a little more
    [0.589483, -0.515532, -0.337429, -0.112506, 0.559624],
    [0.572178, -0.504324, -0.356110, -0.158143, 0.614626],
]


@settings(max_examples=8)
@example(np.array(TO_AND_FRO * 2), CAPS[0], SCENES[0])
@given(ways(), st.sampled_from(CAPS), st.sampled_from(SCENES))
def test_passed_waypoints_are_passed_near_enough_in_order_and_within_the_caps(
    way: np.ndarray, caps: MotionLimits, scene: Scene
) -> None:
    arm = Arm(caps, scene)
    try:
        passing = leg(arm, way)
    except PlanningError:
        assume(False)
    plan = passing.plan
    assert plan is not None
    np.testing.assert_array_equal(plan.q_start, way[0])
    np.testing.assert_array_equal(plan.q_goal, way[-1])
    verify.check(plan.trajectory, caps, MODEL.lower, MODEL.upper)

    times = np.arange(0.0, plan.duration, 0.001)
    q, qd, _ = plan.trajectory.at(times)
    assert np.all(np.abs(qd).max(axis=0) <= caps.velocity * 1.001)
    assert list(passing.at) == sorted(passing.at)
    for place, at in zip(way[1:], passing.at, strict=True):
        then = np.abs(times - at) <= plan.trajectory.dt
        assert np.abs(q[then] - place).max(axis=1).min() <= PASSING + 1e-3


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1))
def test_passing_on_a_path_that_bends_gently_saves_a_fifth_of_the_time(seed: int) -> None:
    rng = np.random.default_rng(seed)
    steps = rng.uniform(0.1, 0.2, 5) + rng.uniform(-0.05, 0.05, (5, 5))
    way = np.cumsum(rng.choice([-1.0, 1.0], 5) * steps, axis=0)
    arm = Arm(CAPS[0], Scene())
    try:
        passing, stopping = leg(arm, way).plan, by_stops(arm, way)
    except PlanningError:
        assume(False)
    assert passing is not None
    assert passing.duration <= 0.8 * stopping


def by_stops(arm: Arm, way: np.ndarray) -> float:
    """How long it takes with a stop at each waypoint [s]."""
    plans = [leg(arm, way[k : k + 2]).plan for k in range(len(way) - 1)]
    return sum(plan.duration for plan in plans if plan is not None)


@st.composite
def paths(draw):
    """Ways of a hand: steps of any size, with pauses, turns and loops, and a jaw or none."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 120))
    rate = draw(st.sampled_from([0.001, 0.02, 0.3]))
    steps = rate * rng.standard_normal((n, 5)) * (rng.random((n, 1)) < 0.8)
    q = np.clip(np.cumsum(steps, axis=0), -1.5, 1.5)
    jaw = np.clip(0.5 + np.cumsum(0.05 * rng.standard_normal(n)), 0.0, 1.0)
    return GuidedPath(t=0.01 * np.arange(n), q=q, aperture=jaw if draw(st.booleans()) else None)


def between(corners, where):
    return np.column_stack([np.interp(where, range(len(corners)), each) for each in corners.T])


@given(paths(), st.floats(0.005, 0.2))
def test_every_point_is_near_what_is_left_of_its_path_in_order(path, tolerance):
    kept = path.corners(tolerance)
    assert kept[0] == 0
    assert kept[-1] == len(path) - 1
    assert np.all(np.diff(kept) > 0) or len(path) == 1
    columns = [path.q]
    if path.aperture is not None:
        columns.append(path.aperture[:, None] * tolerance / JAW_TOLERANCE)
    x = np.hstack(columns)
    for begin, end in pairwise(kept):
        way, reached = x[end] - x[begin], 0.0
        for point in x[begin : end + 1]:
            share = (point - x[begin]) @ way / max(way @ way, 1e-300)
            reached = max(reached, min(max(share, 0.0), 1.0))
            assert np.abs(point - x[begin] - reached * way).max() <= tolerance + 1e-9


@settings(max_examples=40)
@given(paths(), st.integers(0, 2**32 - 1))
def test_points_that_go_along_a_polyline_are_found_on_it_in_order(path, seed):
    if len(path) < 2:
        return
    where = np.linspace(0.0, len(path) - 1.0, 60 + seed % 200)
    on_it = between(path.q, where)
    found = along(path.q, on_it)
    assert np.all(np.diff(found) >= 0.0)
    assert np.abs(between(path.q, found) - on_it).max() < np.radians(0.5)
