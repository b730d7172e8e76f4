from dataclasses import replace

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError, Overloaded
from so101_motion.common.geometry import SE3
from so101_motion.common.state import ARM_JOINTS
from so101_motion.planning.collision.scene import Attached, Scene, Sphere
from so101_motion.planning.goals import JointGoal, LineGoal, PathGoal, PoseGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner, PlanRequest
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point
from so101_motion.planning.timing.path_geometry import blended_path
from so101_motion.planning.timing.retime import retime
from so101_motion.planning.timing.torque import NEARLY, Load, Payload, Strength, carried, slowed

MODEL = RobotModel.load()
PLANNER = Planner(MODEL)
AT_THE_TIP = tuple((MODEL.frame(np.zeros(5)).inverse @ MODEL.frame(np.zeros(5), "jaw_tip")).p)
STRETCHED = np.radians([0.0, 79.0, -80.0, 0.0, 0.0])
FOLDED = np.radians([0.0, -60.0, 60.0, 40.0, 0.0])
WEAK, STRONG = Strength.of_servos(7.4), Strength.of_servos(12.0)
TIGHT = Strength(holding=1.17, moving=1.18)
LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=8.7, jerk=500.0)


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
        limits=LIMITS,
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


def test_torque_is_gravity_and_inertia() -> None:
    q, qd, qdd = (np.array([values]) for values in (FOLDED, np.ones(5), 4.0 * np.ones(5)))
    still, model = np.zeros((1, 5)), loaded(0.1)
    assert np.allclose(model.torques(q, still, still), model.holding_torques(q))
    inertial = model.torques(q, qd, qdd) - model.holding_torques(q)
    assert np.allclose(
        model.torques(q, 0.5 * qd, 0.25 * qdd), model.holding_torques(q) + 0.25 * inertial
    )


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
    quick = point_to_point(FOLDED, goal, LIMITS, 0.01)
    assert shares(quick, mass, TIGHT).max() > 1.02
    plan = PLANNER.plan(request(JointGoal(q=goal), mass, TIGHT))
    motion = plan.trajectory
    assert shares(motion, mass, TIGHT).max() <= 1.001
    stretched = load(mass, TIGHT).stretch(quick) * quick.duration
    assert quick.duration < motion.duration < 0.98 * stretched
    assert plan.report.effort == pytest.approx(shares(motion, mass, TIGHT).max(), abs=1e-6)
    assert verify.limit_report(motion, LIMITS).worst <= 1.001
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


def test_an_arm_that_hangs_in_a_posture_too_heavy_for_it_may_leave_it() -> None:
    plan = PLANNER.plan(request(JointGoal(q=FOLDED), 0.15, q_start=STRETCHED))
    assert np.array_equal(plan.trajectory.q[-1], FOLDED)


@pytest.mark.parametrize("corners", [2, 5])
def test_rows_bound_the_torque_along_a_path(corners: int) -> None:
    rng = np.random.default_rng(corners)
    points = FOLDED + rng.uniform(-0.6, 0.6, (corners, 5))
    path, mass = blended_path(points, 0.05), 0.1
    bears = load(mass, Strength(holding=1.6, moving=1.7))
    motion = retime(path, LIMITS, 1e-3, further=bears.rows)
    assert bears.stretch(motion) <= 1.01


@pytest.mark.parametrize("k", [1.0, 1.3, 4.0])
def test_slowed_is_the_same_path_more_slowly(k: float) -> None:
    quick = point_to_point(FOLDED, STRETCHED, LIMITS, 0.01)
    slow = slowed(quick, k)
    assert slow.duration >= k * quick.duration
    assert np.array_equal(slow.q[-1], quick.q[-1])
    assert not slow.qd[-1].any()
    t = np.arange(len(slow) - 1) * 0.01
    assert np.allclose(slow.q[:-1], quick.at(t / k)[0])
    assert verify.limit_report(slow, LIMITS).worst <= 1.001


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
    quick = point_to_point(FOLDED, np.radians([40.0, 60.0, -75.0, 10.0, 0.0]), LIMITS, 0.01)
    weaker = replace(TIGHT, shares=(1.0, 0.95, 1.0, 1.0, 1.0))
    assert load(0.08, weaker).stretch(quick) > 1.01 * load(0.08, TIGHT).stretch(quick)
