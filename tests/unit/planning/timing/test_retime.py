import itertools
from dataclasses import replace

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError, Overloaded, PlanningError
from so101_motion.common.geometry import SE3
from so101_motion.common.state import ARM_JOINTS
from so101_motion.drivers.feetech.gravity_compensation import Trim
from so101_motion.drivers.feetech.servo_model import ServoModel
from so101_motion.drivers.servo_types import STS3215_7V4
from so101_motion.planning.collision.scene import Attached, Scene, Sphere
from so101_motion.planning.goals import JointGoal, LineGoal, PathGoal, PoseGoal
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.motion_builder import roomy_corners
from so101_motion.planning.planner import Planner, PlanRequest
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.exact_retiming import time_exactly
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point
from so101_motion.planning.timing.path_geometry import JointPath, blended_path, spline_path
from so101_motion.planning.timing.retime import retime
from so101_motion.planning.timing.torque import (
    NEARLY,
    Drive,
    Load,
    Payload,
    Strength,
    carried,
    slowed,
)
from so101_motion.planning.timing.verify import check, limit_report

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
POINTS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [0.4, -0.3, 0.2, 0.5, 0.0],
        [0.9, -0.2, -0.4, 0.2, 0.8],
        [0.2, 0.3, -0.6, -0.5, 0.3],
        [-0.5, 0.1, 0.3, 0.0, -0.4],
    ]
)


@pytest.mark.parametrize("path", [spline_path(POINTS), blended_path(POINTS, 0.03)])
@pytest.mark.parametrize("jerk", [60.0, 500.0])
def test_limits_are_kept_and_used_at_1_khz(path: JointPath, jerk: float) -> None:
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=jerk)
    assert 0.95 < limit_report(retime(path, limits, 1e-3), limits).worst <= 1.001


@pytest.mark.parametrize("scale", [1e-7, 1e-5, 1e-3])
def test_a_tiny_path_is_timed_like_any_other(scale: float) -> None:
    trajectory = retime(blended_path(scale * POINTS, 0.01 * scale), LIMITS, 0.01)
    assert np.allclose(trajectory.q[-1], scale * POINTS[-1], atol=1e-15)
    assert trajectory.duration < 0.5
    assert verify.limit_report(trajectory, LIMITS).worst <= 1.001


def test_turning_back_on_the_spot_does_not_stall() -> None:
    path = blended_path([np.zeros(5), POINTS[1], np.zeros(5)], 1e-4)
    assert retime(path, LIMITS, 0.01).duration < 1.2


def test_where_no_speed_is_allowed_there_is_no_motion() -> None:
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=0.1)
    with pytest.raises(PlanningError, match="no speed along this path"):
        retime(
            spline_path(POINTS), limits, 0.01, tool_speed_fn=lambda q, qd: np.full(len(q), np.inf)
        )


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"dt": 0.0}, "dt = 0.0"),
        ({"dt": float("nan")}, "positive and finite"),
        ({"deviation": -1.0}, "deviation = -1.0"),
        ({"limits": MotionLimits.uniform(velocity=1, acceleration=1, jerk=1, n=4)}, "4 joints"),
        (
            {"limits": MotionLimits.uniform(velocity=1, acceleration=1, jerk=1, tool_speed=0.1)},
            "needs tool_speed_fn",
        ),
    ],
)
def test_mistakes_are_named(change: dict[str, object], complaint: str) -> None:
    arguments = {"path": spline_path(POINTS), "limits": LIMITS, "dt": 0.01, **change}
    with pytest.raises(ValueError, match=complaint):
        retime(**arguments)
    if "needs" in complaint:
        with pytest.raises(ValueError, match=complaint):
            time_exactly(**arguments)


@pytest.mark.parametrize(
    "path", [spline_path(POINTS), spline_path(0.1 * POINTS), blended_path(POINTS, 0.03)]
)
def test_velocity_and_acceleration_are_the_derivatives_of_the_positions(path: JointPath) -> None:
    h = 1e-5
    motion = retime(path, LIMITS, h)
    q, qd, qdd = (each[1:-2] for each in (motion.q, motion.qd, motion.qdd))
    assert np.allclose((q[2:] - q[:-2]) / (2.0 * h), qd[1:-1], atol=1e-5)
    assert np.allclose((qd[2:] - qd[:-2]) / (2.0 * h), qdd[1:-1], atol=2e-2)


@pytest.mark.parametrize("tiny", [2.6e-308, 1e-173, 1e-20])
def test_next_to_nothing_may_be_anywhere_along_a_path(tiny):
    path = spline_path(np.array([[tiny, 0.0], [0.0, 1.0], [0.0, 0.0]]))
    limits = MotionLimits.uniform(velocity=1.0, acceleration=1.0, jerk=20.0, n=2)
    assert verify.limit_report(retime(path, limits, 0.01), limits).worst <= 1.0 + verify.TOLERANCE


# Without smoothing


LAZY = MotionLimits.uniform(velocity=0.7, acceleration=1.0, jerk=15.0)


def winding(seed, count=6, reach=0.5):
    return spline_path(reach * np.random.default_rng(seed).standard_normal((count, 5)))


def distance_from(path, q):
    s = np.linspace(0.0, path.length, 20001)
    points = path.evaluate(s).q
    return max(np.linalg.norm(points - each, axis=1).min() for each in q)


@pytest.mark.parametrize("limits", [LIMITS, LAZY], ids=["swift", "lazy"])
@pytest.mark.parametrize("seed", range(2))
def test_the_motion_keeps_every_limit_and_the_path(limits, seed):
    path = winding(seed)
    motion = time_exactly(path, limits, 0.01)
    check(motion, limits)
    assert limit_report(motion, limits).worst > 0.9  # and uses them somewhere
    assert motion.q[0] == pytest.approx(path.evaluate([0.0]).q[0], abs=1e-12)
    assert motion.q[-1] == pytest.approx(path.evaluate([path.length]).q[0], abs=1e-12)
    assert not np.any(motion.qd[[0, -1]])
    assert distance_from(path, motion.q[::7]) < 1e-3  # as fine as the points compared with


def test_a_straight_path_is_nearly_as_fast_as_can_be():
    ends = np.array([[0.0] * 5, [0.8, -0.3, 0.5, 0.1, 0.0]])
    motion = time_exactly(spline_path(ends), LIMITS, 0.01)
    shortest = point_to_point(*ends, LIMITS, 0.01)
    assert motion.duration < 1.05 * shortest.duration


@pytest.mark.parametrize("timed", [retime, time_exactly])
def test_the_tool_keeps_its_cap_and_moves_at_it(timed):
    tool, path = ArmChain(MODEL), winding(2, reach=0.3)
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=0.05)
    motion = timed(path, limits, 0.01, tool_speed_fn=tool.speeds)
    speed = tool.speeds(motion.q, motion.qd)
    assert 0.05 * 0.97 < np.median(speed) <= speed.max() <= 0.05 * 1.001


@pytest.mark.parametrize("length", [1e-5, 1e-3, 0.02])
def test_short_motions_keep_their_limits_too(length):
    path = spline_path(np.array([[0.0] * 5, [length, 0.0, 0.0, -length, 0.0]]))
    motion = time_exactly(path, LIMITS, 0.01)
    check(motion, LIMITS)
    assert motion.q[-1] == pytest.approx([length, 0.0, 0.0, -length, 0.0], abs=1e-12)


def test_jumps_of_curvature_are_passed_within_the_jerk_limit_of_the_samples():
    corners = np.array([[0.0] * 5, [0.5, 0.2, 0.0, 0.0, 0.0], [0.6, 0.8, -0.3, 0.0, 0.1]])
    motion = time_exactly(blended_path(corners, 0.1), LIMITS, 0.01)
    check(motion, LIMITS)


CORNERS = np.array([[0.0, 0.0, 0.0], [0.8, -0.3, 0.2], [0.9, 0.5, -0.4], [0.2, 0.3, -0.6]])
THREE = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=1e5, n=3)


def test_with_much_jerk_a_straight_path_takes_as_long_as_speeding_up_and_braking_in_full() -> None:
    # The shorter way ends before top speed; the average that bounds jerk is 10 ms wide at least.
    for way, shortest in ((2.0, 2.0 / 3.0 + 3.0 / 10.0), (0.1, 0.2)):
        motion = retime(blended_path([np.zeros(3), [way, 0.5 * way, 0.0]], 0.01), THREE, 1e-3)
        assert shortest <= motion.duration < shortest + 0.013


def test_further_limits_slow_the_motion_down_where_they_bind() -> None:
    path = blended_path(CORNERS, 0.05)

    def half_of_the_first_joint(points):
        return np.stack((points.q_s, points.q_ss, np.zeros_like(points.q)))[:, :, :1] / 5.0

    slower = retime(path, THREE, 1e-3, further=half_of_the_first_joint)
    # Of 10 that the joint may have; the averaging that bounds jerk takes a little more.
    assert 4.5 < np.abs(slower.qdd[:, 0]).max() <= 5.0 * 1.03
    assert slower.duration > retime(path, THREE, 1e-3).duration


@pytest.mark.parametrize("broken", [False, True])
def test_rows_that_contradict_each_other_or_raise_leave_no_motion(broken: bool) -> None:
    def contradictory(points):
        if broken:
            raise KeyError("mine")
        a = np.tile(points.q_s[:, :1] / 10.0, 2)
        c = np.zeros_like(a)
        c[30] = 1.5, -1.5
        return np.stack((a, 0.0 * a, c))

    error, says = (KeyError, "mine") if broken else (PlanningError, "no speed along this path")
    with pytest.raises(error, match=says):
        retime(blended_path(CORNERS, 0.05), THREE, 0.01, further=contradictory)


# Within the torques


MODEL = RobotModel.load()
PLANNER = Planner(MODEL)
AT_THE_TIP = tuple((MODEL.frame(np.zeros(5)).inverse @ MODEL.frame(np.zeros(5), "jaw_tip")).p)
STRETCHED = np.radians([0.0, 79.0, -80.0, 0.0, 0.0])
FOLDED = np.radians([0.0, -60.0, 60.0, 40.0, 0.0])
WEAK, STRONG = Strength.of_servos(7.4), Strength.of_servos(12.0)
TIGHT = Strength(holding=1.17, moving=1.18)
TORQUE_LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=8.7, jerk=500.0)


def payload(mass: float) -> Payload:
    return Payload(mass=mass, com=AT_THE_TIP)


def ball(p, mass: float) -> Attached:
    at, shape = SE3.from_translation(p), Sphere(radius=0.01)
    return Attached(name="ball", shape=shape, T_tool_object=at, mass=mass)


def loaded(mass: float) -> RobotModel:
    return MODEL.with_payload(mass, AT_THE_TIP)


def load(mass: float, strength: Strength = WEAK, q_start=FOLDED) -> Load:
    return Load(loaded(mass), strength, q_start, payload(mass))


def request(goal, mass: float, strength: Strength | None = WEAK, q_start=FOLDED) -> PlanRequest:
    return PlanRequest(
        q_start=q_start,
        goal=goal,
        limits=TORQUE_LIMITS,
        scene=Scene(floor_z=None),
        payload=payload(mass),
        strength=strength,
    )


def shares(trajectory, mass: float, strength: Strength = WEAK) -> np.ndarray:
    torques = loaded(mass).torques(trajectory.q, trajectory.qd, trajectory.qdd)
    return np.abs(torques) / strength.moving


@pytest.mark.parametrize(
    ("mass", "lift", "elbow", "wrist"),
    [(0.0, 0.863, 0.452, 0.117), (0.1, 1.265, 0.741, 0.273), (0.25, 1.868, 1.174, 0.508)],
)
def test_the_torques_of_the_stretched_arm_are_those_computed_elsewhere(mass, lift, elbow, wrist):
    torques = np.abs(loaded(mass).holding_torques(STRETCHED[None])[0])
    assert torques == pytest.approx([0.0, lift, elbow, wrist, 0.0], abs=2e-3)


def test_holding_torques_change_no_faster_than_is_said() -> None:
    rng, model = np.random.default_rng(1), loaded(0.25)
    here = rng.uniform(MODEL.lower, MODEL.upper, (300, 5))
    there = here + rng.uniform(-0.3, 0.3, (300, 5)) * rng.integers(0, 2, (300, 5))
    change = np.abs(model.holding_torques(here) - model.holding_torques(there))
    most = np.abs(here - there) @ model.holding_torque_rates
    assert np.all(change <= most + 1e-9)
    assert (change[:, 1] / most[:, 1].clip(1e-9)).max() > 0.8, "a bound that says something"


def test_what_is_known_nearby_never_hides_a_load() -> None:
    rng, carried = np.random.default_rng(2), load(0.15)
    model, heavy, refused = loaded(0.15), 0, 0
    for k in range(400):
        out = 0.5 - 0.5 * np.cos(0.05 * k)  # stretched out and folded, again and again
        q = FOLDED + out * (STRETCHED - FOLDED) + rng.uniform(-0.02, 0.02, 5)
        torques = np.abs(model.holding_torques(q[None])[0])
        near = {i for i in range(5) if torques[i] > NEARLY * WEAK.holding}
        assert {ARM_JOINTS.index(each.joint) for each in carried.heavy(q)} == near
        path = q + np.linspace(0.0, 1.0, 6)[:, None] * rng.uniform(-0.3, 0.3, 5)
        borne = np.abs(model.holding_torques(path))
        fits = np.all(borne <= np.maximum(1.001 * WEAK.holding, borne[0]))
        assert carried.admits(path) == fits
        heavy, refused = heavy + bool(near), refused + (not fits)
    assert 20 < heavy < 380
    assert 20 < refused < 380


@pytest.mark.parametrize("strength", [WEAK, STRONG])
def test_the_bare_arm_may_be_stretched_out_with_either_servo(strength: Strength) -> None:
    bare = Load(MODEL, strength, FOLDED, None)
    assert bare.check_holding(STRETCHED[None], "there") < 0.8
    plan = PLANNER.plan(request(JointGoal(q=STRETCHED), 0.0, strength))
    assert 0.3 < plan.report.effort <= 1.0


def test_a_reach_that_is_too_heavy_to_hold_is_refused_with_joint_torque_and_posture() -> None:
    with pytest.raises(Overloaded, match=r"shoulder_lift would have to exert 1.27 N m") as caught:
        PLANNER.plan(request(JointGoal(q=STRETCHED), 0.1))
    assert "to hold the arm and 100 g at the goal" in str(caught.value)
    assert "its servo may exert 1.15 N m; reach less far, or carry less" in str(caught.value)
    assert caught.value.joint == "shoulder_lift"
    assert abs(caught.value.torque) == pytest.approx(1.266, abs=2e-3)
    assert caught.value.limit == pytest.approx(0.6 * 1.91)
    assert np.array_equal(caught.value.q, STRETCHED)
    assert PLANNER.plan(request(JointGoal(q=STRETCHED), 0.1, STRONG)).report.effort < 1.0


def test_what_a_servo_may_exert_is_not_said_to_be_what_it_has_to_where_it_stands() -> None:
    further = PathGoal(waypoints=np.array([STRETCHED, FOLDED]))
    says = r"may exert 1\.15 N m, and no more than \d\.\d\d to leave"
    with pytest.raises(Overloaded, match=says):
        PLANNER.plan(request(further, 0.3, q_start=0.9 * STRETCHED))


@pytest.mark.parametrize(
    "goal",
    [
        JointGoal(q=0.95 * STRETCHED),
        JointGoal(q=STRETCHED),
        PathGoal(waypoints=np.array([0.5 * FOLDED, 0.95 * STRETCHED])),
        PoseGoal(T_base_tool=MODEL.frame(0.95 * STRETCHED)),
        LineGoal(T_base_tool=MODEL.frame(0.97 * STRETCHED)),
    ],
)
def test_an_arm_that_hangs_in_a_posture_too_heavy_for_it_is_not_sent_to_another(goal) -> None:
    with pytest.raises(Overloaded, match=r"at the goal.*may exert 1\.15 N m; reach less far"):
        PLANNER.plan(request(goal, 0.25, q_start=STRETCHED))


def test_an_arm_that_hangs_in_a_posture_too_heavy_for_it_may_leave_it() -> None:
    plan = PLANNER.plan(request(JointGoal(q=FOLDED), 0.15, q_start=STRETCHED))
    assert np.array_equal(plan.trajectory.q[-1], FOLDED)


def test_a_path_through_a_reach_that_is_too_heavy_is_refused() -> None:
    over = np.radians([0.0, 95.0, -60.0, 60.0, 0.0])
    beyond = [np.radians([0.0, 40.0, -85.0, 0.0, 0.0]), STRETCHED, over]
    with pytest.raises(Overloaded, match="on the way"):
        PLANNER.plan(request(PathGoal(waypoints=np.array(beyond), tolerance=0.1), 0.15))


def test_what_the_scene_attaches_weighs_as_well() -> None:
    holding = Scene(floor_z=None, attached=(ball(AT_THE_TIP, 0.1),))
    heavy = replace(request(JointGoal(q=STRETCHED), 0.0), scene=holding)
    with pytest.raises(Overloaded, match="the arm and 100 g"):
        PLANNER.plan(replace(heavy, payload=None))


def test_a_heavy_but_possible_motion_is_slowed_where_it_is_heavy() -> None:
    goal, mass = np.radians([40.0, 60.0, -75.0, 10.0, 0.0]), 0.08
    quick = point_to_point(FOLDED, goal, TORQUE_LIMITS, 0.01)
    assert shares(quick, mass, TIGHT).max() > 1.02
    plan = PLANNER.plan(request(JointGoal(q=goal), mass, TIGHT))
    motion = plan.trajectory
    assert shares(motion, mass, TIGHT).max() <= 1.001
    stretched = load(mass, TIGHT).stretch(quick) * quick.duration
    assert quick.duration < motion.duration < 0.98 * stretched
    assert plan.report.effort == pytest.approx(shares(motion, mass, TIGHT).max(), abs=1e-6)
    assert verify.limit_report(motion, TORQUE_LIMITS).worst <= 1.001
    assert np.array_equal(motion.q[-1], goal)


def test_a_straight_line_of_the_tool_is_slowed_as_a_whole() -> None:
    start = np.radians([0.0, 40.0, -20.0, 20.0, 0.0])
    T = MODEL.frame(start)
    goal = LineGoal(T_base_tool=SE3(T.R, T.p + np.array([0.0, 0.0, 0.05])))
    quick = PLANNER.plan(request(goal, 0.1, None, start)).trajectory
    gravity = np.abs(loaded(0.1).holding_torques(quick.q)).max()
    just = Strength(holding=1.02 * gravity, moving=1.04 * gravity)
    slow = PLANNER.plan(request(goal, 0.1, just, start)).trajectory
    assert shares(quick, 0.1, just).max() > 1.1
    assert shares(slow, 0.1, just).max() <= 1.001
    assert slow.duration > 1.1 * quick.duration
    assert np.allclose(slow.q[-1], quick.q[-1])


def test_a_motion_is_as_slow_as_the_drive_of_its_servos_asks_and_says_so() -> None:
    servo, durations = ServoModel(STS3215_7V4), {}
    for felt, volts in ((0.0, 12.0), (0.0, 7.4), (0.2, 7.4), (0.2, 6.0), (0.6, 5.0)):
        servo.volts = volts
        own = Trim(lambda q: np.zeros(6))
        own.put(1, servo)
        drive = Drive(*zip(*[own.drive(1)] * 5, strict=True), volts=volts, felt=felt)
        known = replace(STRONG, drive=drive)
        plan = PLANNER.plan(request(JointGoal(q=FOLDED), 0.0, known, STRETCHED))
        durations[felt, volts] = plan.duration
        assert bool(plan.report.short_of_drive) == (volts < 12.0 and (felt > 0.0 or volts < 7.0))
    assert durations[0.0, 12.0] == durations[0.0, 7.4] < durations[0.2, 7.4] < durations[0.2, 6.0]
    assert "of its drive at 5.0 V, with 600 g felt" in plan.report.short_of_drive


@pytest.mark.parametrize("k", [1.0, 1.3, 4.0])
def test_slowed_is_the_same_path_more_slowly(k: float) -> None:
    quick = point_to_point(FOLDED, STRETCHED, TORQUE_LIMITS, 0.01)
    slow = slowed(quick, k)
    assert slow.duration >= k * quick.duration
    assert np.array_equal(slow.q[-1], quick.q[-1])
    assert not slow.qd[-1].any()
    t = np.arange(len(slow) - 1) * 0.01
    assert np.allclose(slow.q[:-1], quick.at(t / k)[0])
    assert verify.limit_report(slow, TORQUE_LIMITS).worst <= 1.001


def test_loads_add_up_at_their_common_centre() -> None:
    both = carried(Payload(mass=0.1, com=(0.0, 0.0, 0.1)), [ball([0.04, 0.0, 0.1], 0.3)])
    assert both.mass == pytest.approx(0.4)
    assert both.com == pytest.approx((0.03, 0.0, 0.1))
    assert carried(None, ()) is None
    assert carried(Payload(mass=0.0, com=(0.0, 0.0, 0.0)), ()) is None


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Payload(mass=-0.1, com=(0.0, 0.0, 0.1)), "payload"),
        (lambda: Payload(mass=100.0, com=(0.0, 0.0, 0.1)), "payload"),
        (lambda: Payload(mass=float("nan"), com=(0.0, 0.0, 0.1)), "payload"),
        (lambda: Payload(mass=0.1, com=(0.0, 0.0, 98.0)), "within 1 m"),
        (lambda: Strength.of_servos(9.0), "must be 7.4 or 12"),
    ],
)
def test_what_nobody_can_mean_is_refused(make, says) -> None:
    with pytest.raises(ConfigError, match=says):
        make()


def test_a_servo_that_was_found_weak_bears_less_and_is_named() -> None:
    load(0.1, STRONG).check_holding(STRETCHED[None], "on the way")
    weak = replace(STRONG, shares=(1.0, 1.0, 0.4, 1.0, 1.0))
    with pytest.raises(Overloaded, match=r"elbow_flex .* 40% of its type's") as refused:
        load(0.1, weak).check_holding(STRETCHED[None], "on the way")
    assert refused.value.limit == pytest.approx(0.4 * STRONG.holding)
    quick = point_to_point(FOLDED, np.radians([40.0, 60.0, -75.0, 10.0, 0.0]), TORQUE_LIMITS, 0.01)
    weaker = replace(TIGHT, shares=(1.0, 0.95, 1.0, 1.0, 1.0))
    assert load(0.08, weaker).stretch(quick) > 1.01 * load(0.08, TIGHT).stretch(quick)


# Paths to be timed


RNG = np.random.default_rng(7)
WAYPOINTS = np.cumsum(RNG.normal(scale=0.3, size=(12, 5)), axis=0)


def distance_to_polyline(q: np.ndarray, points: np.ndarray) -> np.ndarray:
    """For each q, how far its worst joint is from the best of densely sampled polyline points."""
    u = np.linspace(0.0, 1.0, 400)[:, None]
    dense = np.concatenate([a + u * (b - a) for a, b in itertools.pairwise(points)])
    return np.array([np.abs(dense - one).max(axis=1).min() for one in q])


def test_a_spline_is_the_natural_one() -> None:
    interpolate = pytest.importorskip("scipy.interpolate")
    path = spline_path(WAYPOINTS)
    theirs = interpolate.CubicSpline(path.knots, WAYPOINTS, bc_type="natural")
    s = np.linspace(0.0, path.length, 500)
    for order, ours in enumerate(path.evaluate(s)):
        assert np.allclose(ours, theirs(s, order), atol=1e-10)


@pytest.mark.parametrize("tolerance", [1e-4, 0.01, 0.3, 10.0])
def test_rounded_corners_stay_within_the_tolerance_of_the_lines(tolerance: float) -> None:
    path = blended_path(WAYPOINTS, tolerance)
    q = path.evaluate(np.linspace(0.0, path.length, 250)).q
    assert distance_to_polyline(q, WAYPOINTS).max() <= min(tolerance, 1.0) + 2e-3
    assert np.allclose(q[[0, -1]], WAYPOINTS[[0, -1]], atol=1e-14)


def test_a_corner_uses_the_tolerance_it_is_given() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    path = blended_path(points, 0.02)
    nearest = np.abs(path.evaluate(np.linspace(0.0, path.length, 5001)).q - points[1]).max(axis=1)
    assert nearest.min() == pytest.approx(0.02, rel=1e-3)


def test_points_in_line_need_no_corner() -> None:
    points = np.linspace([0.0, 0.0, 0.0], [0.9, -0.3, 0.6], 4)
    path = blended_path(points, 0.05)
    assert len(path.knots) == 4
    assert np.allclose(path.evaluate(np.linspace(0.0, path.length, 50)).q_ss, 0.0, atol=1e-12)


@pytest.mark.parametrize("make", [spline_path, lambda points: blended_path(points, 0.01)])
def test_repeated_points_count_once(make) -> None:
    once, twice = make(WAYPOINTS), make(np.repeat(WAYPOINTS, 2, axis=0))
    assert np.allclose(once.knots, twice.knots)
    assert np.allclose(once.coefficients, twice.coefficients)


@pytest.mark.parametrize("make", [spline_path, lambda points: blended_path(points, 0.01)])
def test_nearly_repeated_ends_keep_the_exact_start_and_goal(make) -> None:
    path = make([[0.0], [1e-10], [1.0], [1.0 + 1e-10]])
    assert path.evaluate([0.0]).q[0, 0] == 0.0
    assert path.evaluate([path.length]).q[0, 0] == pytest.approx(1.0 + 1e-10, abs=1e-15)


@pytest.mark.parametrize("make", [spline_path, lambda points: blended_path(points, 0.01)])
@pytest.mark.parametrize(
    ("points", "complaint"),
    [
        ([[0.1, 0.2]], "two different points"),
        ([[0.1, 0.2], [0.1, 0.2], [0.1, 0.2 + 1e-12]], "two different points"),
        (np.zeros((0, 5)), "two different points"),
        ([[0.1, 0.2], [np.nan, 0.2]], "finite"),
        ([0.1, 0.2], "shape"),
    ],
)
def test_a_path_that_is_none_is_refused(make, points, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        make(points)


@pytest.mark.parametrize("tolerance", [0.0, -0.1, np.inf, np.nan])
def test_a_tolerance_that_is_none_is_refused(tolerance: float) -> None:
    with pytest.raises(ValueError, match="tolerance"):
        blended_path([[0.0], [1.0], [0.5]], tolerance)


def test_knots_must_rise_from_zero() -> None:
    for knots in ([0.0, 1.0, 1.0], [0.5, 1.0, 2.0]):
        with pytest.raises(ValueError, match="rise from 0"):
            JointPath(knots=np.array(knots), coefficients=np.zeros((2, 4, 1)))


def test_beyond_its_ends_a_path_stays_at_its_end_points() -> None:
    path = spline_path(WAYPOINTS)
    assert np.allclose(path.evaluate([-1.0, path.length + 1.0]).q, WAYPOINTS[[0, -1]])


# Corners of a path around something


AROUND = np.array(
    [[0, 0, 0, 0, 0], [1, 0, 0, 0, 0], [1, 1, 0, 0, 0], [2, 1, 0, 0, 0], [3, 1, 0, 0, 0]], float
)
MOST, LEAST = 0.1, 0.002


def corners(is_free, points=AROUND):
    return roomy_corners(points, MOST, LEAST, lambda q: np.array([not is_free(each) for each in q]))


def test_where_all_is_free_every_corner_is_cut_as_widely_as_may_be():
    assert corners(lambda q: True) == pytest.approx([MOST] * 3)


def test_a_corner_beside_something_is_cut_less_and_the_others_are_not():
    post = np.array([0.9, 0.1, 0.0, 0.0, 0.0])
    found = corners(lambda q: np.linalg.norm(q - post) > 0.05)
    assert LEAST < found[0] < MOST
    assert found[1:] == pytest.approx([MOST] * 2)
    path = blended_path(AROUND, found)
    away = [np.linalg.norm(q - post) for q in path.evaluate(np.linspace(0.0, path.length, 999)).q]
    assert min(away) > 0.049


def test_a_corner_without_any_room_is_a_stop():
    def is_free(q):
        return min(abs(q[1]), abs(q[0] - 1.0)) < 1e-6 or q[1] > 0.5

    found = corners(is_free)
    assert found[0] == 0.0
    assert found[1] == pytest.approx(MOST)


def test_a_corner_that_is_straight_needs_no_room():
    straight = np.array([[0.0] * 5, [1.0] * 5, [2.0] * 5])
    assert corners(lambda q: False, straight) == pytest.approx([MOST])
