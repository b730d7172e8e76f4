import numpy as np
import pytest
from harness.random_scenes import obstacle
from scipy.optimize import minimize

from benchmarks.bench_servo import through_qpsolvers
from so101_motion.common.geometry import SE3, rotation_angle, rotation_by
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.differential.guard import AHEAD, FAST, INEXACT, MOST, BoundedStep, Guard
from so101_motion.planning.differential.servo import Servo
from so101_motion.planning.differential.servo_qp import ROWS, ServoQp
from so101_motion.planning.differential.targets import Twist
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Load, Payload, Strength

MODEL = RobotModel.load()
DT = 0.01
READY = np.array([0.0, -0.5, 0.5, 0.6, 0.0])
LIMITS = MotionLimits.uniform(velocity=1.5, acceleration=3.0, jerk=100.0)
AS_SET = MotionLimits.uniform(velocity=1.0, acceleration=1.75, jerk=17.5)
TIP = (MODEL.frame(np.zeros(5)).inverse @ MODEL.frame(np.zeros(5), "jaw_tip")).p
HELD = Payload(mass=0.15, com=tuple(TIP))


def servo(
    q_start=READY,
    scene: Scene | None = None,
    limits: MotionLimits = LIMITS,
    held: Payload | None = None,
) -> Servo:
    load = Load.of(MODEL, Strength.of_servos(7.4), q_start, held) if held else None
    return Servo(MODEL, CollisionModel(MODEL, scene), limits, DT, q_start, load=load)


def shares(steps, held: Payload = HELD) -> np.ndarray:
    """What each joint holds in each step, as a share of what it may."""
    model = MODEL.with_payload(held.mass, held.com)
    torques = model.holding_torques(np.array([step.q for step in steps]))
    return np.abs(torques) / Strength.of_servos(7.4).holding


def twist(x=0.0, y=0.0, z=0.0, turn=(0.0, 0.0, 0.0), in_tool=False) -> Twist:
    return Twist(linear=np.array([x, y, z]), angular=np.array(turn), in_tool=in_tool)


def run(moving: Servo, target, steps: int):
    return [moving.step(target) for _ in range(steps)]


def tool(q: np.ndarray) -> SE3:
    return MODEL.frame(q)


@pytest.mark.parametrize("along", [(0.06, 0, 0), (0, 0.06, 0), (0, 0, 0.06), (0.04, -0.03, 0.03)])
def test_a_twist_moves_the_tool_straight_at_its_speed(along) -> None:
    moving, start = servo(), tool(READY).p
    steps = run(moving, twist(*along), 100)
    speed = np.linalg.norm(along)
    offset = np.array([tool(step.q).p for step in steps]) - start
    direction = np.array(along) / speed
    across = offset - np.outer(offset @ direction, direction)
    assert np.linalg.norm(across, axis=1).max() < 5e-4
    assert steps[-1].share == 1.0
    gained = (offset[-1] - offset[-11]) @ direction / 0.1
    assert gained == pytest.approx(speed, rel=0.02)


def test_a_twist_in_the_axes_of_the_tool_goes_where_the_tool_points() -> None:
    moving, start = servo(), tool(READY)
    run(moving, twist(z=0.05, in_tool=True), 80)
    offset = tool(moving.q).p - start.p
    assert offset @ start.R[:, 2] > 0.99 * np.linalg.norm(offset) > 0.02


def test_a_turn_about_the_approach_axis_leaves_the_tool_where_it_is() -> None:
    moving, start = servo(), tool(READY)
    run(moving, twist(turn=(0.0, 0.0, 0.5), in_tool=True), 100)
    now = tool(moving.q)
    assert np.linalg.norm(now.p - start.p) < 5e-4
    assert rotation_angle(now.R @ start.R.T) == pytest.approx(0.5, abs=0.06)


def test_an_orientation_that_five_joints_cannot_have_costs_no_position() -> None:
    start = tool(READY)
    goal = SE3(rotation_by([0.0, 0.0, 0.8]) @ start.R, start.p + np.array([0.0, 0.05, 0.0]))
    moving = servo()
    run(moving, goal, 200)
    assert np.linalg.norm(tool(moving.q).p - goal.p) < 3e-4


def test_a_tool_that_is_let_go_of_stops_on_its_line() -> None:
    moving, start = servo(limits=AS_SET), tool(READY).p
    run(moving, twist(0.0, 0.08, 0.0), 100)
    offsets = np.array([tool(q).p for q in moving.path_to_rest()]) - start
    assert np.abs(offsets[:, [0, 2]]).max() < 1e-3
    assert 0.07 < offsets[-1, 1] < 0.08 * (1.0 + 0.15)


def test_what_is_not_granted_slows_the_tool_down_and_keeps_it_on_its_line() -> None:
    moving, start = (
        servo(limits=MotionLimits.uniform(velocity=0.3, acceleration=3.0, jerk=50.0)),
        (tool(READY).p),
    )
    steps = run(moving, twist(0.0, 0.15, 0.15), 60)
    offset = tool(steps[-1].q).p - start
    assert steps[-1].share < 0.9
    assert np.linalg.norm(np.cross(offset, [0.0, 0.7071, 0.7071])) < 2e-3
    assert any("at its top speed" in word for word in moving.held_by())


def test_it_stops_in_front_of_an_obstacle_and_says_which() -> None:
    ahead = tool(READY).p + np.array([0.2, 0.0, 0.0])
    wall = obstacle("wall", (0.02, 0.6, 0.8), ahead)
    scene = Scene(obstacles=(wall,))
    moving, judge = servo(scene=scene), CollisionModel(MODEL, scene)
    steps = run(moving, twist(x=0.15), 300)
    closest = min(judge.clearance(step.q).distance for step in steps)
    assert 0.003 <= closest < 0.008
    assert np.abs(steps[-1].qd).max() < 0.02
    assert any("'wall'" in word for word in moving.held_by())


def test_it_slides_along_the_floor_when_it_is_pushed_into_it_at_a_slant() -> None:
    moving, judge = servo(), CollisionModel(MODEL)
    down = run(moving, twist(z=-0.1), 300)
    assert 0.003 <= judge.clearance(down[-1].q).distance < 0.007
    begin = tool(moving.q).p
    run(moving, twist(0.0, 0.08, -0.008), 110)
    assert tool(moving.q).p[1] - begin[1] > 0.02
    assert judge.clearance(moving.q).distance >= 0.003


def test_a_joint_limit_is_approached_gently_and_named() -> None:
    moving = servo()
    steps = run(moving, twist(turn=(0.0, 0.0, -1.5), in_tool=True), 600)
    end = steps[-1].q[4]
    limit = MODEL.upper[4] if end > 0.0 else MODEL.lower[4]
    assert abs(end - limit) < 1e-3
    assert np.all((steps[-1].q >= MODEL.lower) & (steps[-1].q <= MODEL.upper))
    assert any("wrist_roll at its" in word for word in moving.held_by())


def test_full_stretch_is_approached_without_haste_and_named() -> None:
    moving = servo()
    steps = run(moving, twist(x=0.1), 500)
    assert max(np.abs(step.qd).max() for step in steps) <= 1.5 + 1e-9
    assert np.linalg.norm(tool(steps[-1].q).p - tool(steps[-40].q).p) < 0.01
    assert "the arm stretched out" in moving.held_by()


def test_a_point_beyond_reach_is_named_where_the_tool_comes_no_nearer() -> None:
    moving, reached = servo(), tool(READY).p + np.array([0.05, 0.0, 0.0])
    beyond = reached + np.array([0.15, 0.0, 0.0])
    run(moving, reached, 150)
    assert moving.held_by() == ()
    assert not any(moving.step(beyond) and moving.is_short for _ in range(70))
    run(moving, beyond, 230)
    assert tool(moving.q).p[0] > reached[0] + 0.05
    assert moving.held_by() == ("the end of its reach",)


def test_a_start_outside_the_limits_may_come_in_and_not_go_further_out() -> None:
    out = READY.copy()
    out[4] = MODEL.upper[4] + 0.05
    for turn in (-0.5, 0.5):
        steps = run(servo(out), twist(turn=(0.0, 0.0, turn), in_tool=True), 100)
        assert max(step.q[4] for step in steps) <= out[4] + 1e-12
    ends = [run(servo(out), twist(turn=(0, 0, s), in_tool=True), 100)[-1].q[4] for s in (-0.5, 0.5)]
    assert min(ends) < MODEL.upper[4]


def test_it_stops_where_what_it_carries_becomes_too_heavy_and_says_so() -> None:
    moving = servo(limits=AS_SET, held=HELD)
    steps = run(moving, twist(x=0.08), 600)
    assert 0.99 < shares(steps).max() <= 1.001
    assert np.abs(steps[-1].qd).max() < 5e-3
    assert "shoulder_lift at its torque limit" in moving.held_by()
    bare = run(servo(limits=AS_SET), twist(x=0.08), 600)
    assert tool(bare[-1].q).p[0] > tool(moving.q).p[0] + 0.02
    before = tool(moving.q).p
    run(moving, twist(x=-0.05), 60)
    assert tool(moving.q).p[0] < before[0] - 0.01
    assert moving.held_by() == ()


# Its programs


def a_program(rng: np.random.Generator):
    """Jacobian, wish, bounds that hold zero, rows that zero keeps."""
    J = np.vstack([0.2 * rng.normal(size=(3, 5)), rng.normal(size=(3, 5))])
    wish = rng.normal(size=5) * rng.choice([0.01, 0.3, 2.0])
    lower, upper = -rng.uniform(0.0, 1.0, 5), rng.uniform(0.0, 1.0, 5)
    rows = rng.integers(0, ROWS + 1)
    return J, wish, lower, upper, 0.2 * rng.normal(size=(rows, 5)), -rng.uniform(0.0, 0.1, rows)


@pytest.mark.filterwarnings("ignore:The default value of raise_error")  # qpsolvers' call of OSQP
def test_it_solves_the_program_as_qpsolvers_does_with_osqp() -> None:
    rng, qp, programs = np.random.default_rng(0), ServoQp(), []
    for _ in range(60):
        _, wish, lower, upper, rows, least = program = a_program(rng)
        qd, share = qp.solve(*program)
        assert np.all((qd >= lower) & (qd <= upper))
        assert 0.0 <= share <= 1.0
        assert np.all(rows @ qd >= least - 5e-3 * np.abs(wish).max())
        programs.append((*program, qd))
    _, apart = through_qpsolvers(programs)
    assert apart < 1e-3


# How far a jogged arm may move near the table


ACCELERATION = np.full(5, 10.5)
OVER_TABLE = np.radians([0.0, -45.0, 45.0, 60.0, 0.0])
LOW = np.radians([0.0, 34.0, -14.0, 36.5, 0.0])  # the jaw some millimetres above the table
DOWN = np.radians([0.0, 1.0, 0.0, 0.0, 0.0])


@pytest.fixture
def guard(collision):
    return Guard(collision, lambda: 0.3, acceleration=ACCELERATION)


def path(q, step, n=10):
    return q + np.linspace(0.0, 1.0, n)[:, None] * step


def test_far_from_everything_a_target_is_within_reach_and_so_is_the_path(guard):
    target = OVER_TABLE + np.radians(5.0)
    assert guard.within_reach(OVER_TABLE, target) is target
    assert guard.against == ()
    assert guard.admits(path(OVER_TABLE, target - OVER_TABLE))


def test_a_target_in_the_table_is_drawn_back_to_above_it_and_the_rest_is_kept(guard, collision):
    q = LOW - 3.0 * DOWN
    wanted = q + np.radians([20.0, 30.0, 0.0, 0.0, 10.0])
    drawn = guard.within_reach(q, wanted)
    assert guard.against == ("the gripper close to the floor",)
    assert drawn[0] == pytest.approx(wanted[0], abs=0.02), "it slides"
    assert drawn[4] == pytest.approx(wanted[4], abs=0.02)
    step = 0.02 * (drawn - q) / np.abs(drawn - q).max()
    assert collision.distances(q + step, 0.3).min() > collision.margin
    assert not guard.admits(path(q, wanted - q))


def test_a_hand_is_held_back_where_it_leads_the_jaw_into_the_table_and_only_there(guard, collision):
    lowest, q_guided = LOW, LOW + np.radians([2.0, 3.0, 0.0, -2.0, 1.0])
    lifts_jaw = collision.distances(LOW + np.radians([0, 0, 0, -2.0, 0]), 0.3).min()
    assert lifts_jaw > collision.distances(LOW, 0.3).min()
    for _ in range(50):  # as in as many control cycles
        lowest = guard.guided_to(lowest, q_guided)
        assert collision.distances(lowest, 0.3).min() > collision.margin
    free = [0, 3, 4]
    np.testing.assert_allclose(lowest[free], q_guided[free], atol=1e-12)
    assert LOW[1] < lowest[1] < q_guided[1]


def test_a_hand_leads_no_joint_farther_than_it_goes_nor_back(guard):
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = LOW + rng.normal(0.0, 0.05, 5)
        q_guided = q + rng.normal(0.0, 0.03, 5)
        share = (guard.guided_to(q, q_guided) - q) / (q_guided - q)
        assert np.all((share >= 0.0) & (share <= 1.0))


def test_a_short_step_may_go_nearer_than_a_long_one(guard, collision):
    q = LOW.copy()
    while collision.distances(q, 0.3).min() > collision.margin + 0.005:
        q += 0.1 * DOWN
    slow, fast = np.array([0.002, 0.0, 0.0, 0.0, 0.0]), np.array([0.3, 0.0, 0.0, 0.0, 0.0])
    guard.see(q)
    assert guard.admits(path(q, slow))
    assert fast @ collision.reach > FAST
    guard.see(q)
    assert not guard.admits(path(q, fast + 0.05 * DOWN))


def test_a_long_step_keeps_clearer_for_servos_that_are_driven_ahead_of_it(guard, collision):
    q, pan = LOW - 2.0 * DOWN, np.array([0.3, 0.0, 0.0, 0.0, 0.0])
    while collision.distances(q, 0.3).min() < collision.margin + INEXACT + 0.5 * AHEAD:
        q -= 0.1 * DOWN
    guard.see(q)
    assert guard.admits(path(q, pan + 0.05 * DOWN))
    assert not guard.admits(path(q, pan + 0.05 * DOWN), ahead=True)
    assert guard.admits(path(q, 0.01 * pan), ahead=True)


# The step nearest to a wanted one that keeps its bounds


nearest = BoundedStep().nearest


def drawn(random, n=6):
    """A step and bounds that it may break; a step that keeps them is drawn first."""
    G, kept = random.normal(size=(n, 5)), 0.3 * random.normal(size=5)
    least = G @ kept - random.uniform(0.0, 0.2, n)
    return random.normal(size=5), np.column_stack([G, least, random.random(n)])


def test_it_is_the_nearest_of_all_that_keep_the_bounds():
    random, held = np.random.default_rng(1), []
    for _ in range(60):
        step, bounds = drawn(random)
        x, active = nearest(step, [bounds])
        G, least = bounds[:, :5], bounds[:, 5]
        if x is None:  # the search may end without one
            continue
        assert (G @ x >= least - 1e-8).all()
        best = minimize(
            lambda y, step=step: np.sum((y - step) ** 2),
            np.zeros(5),
            jac=lambda y, step=step: 2.0 * (y - step),
            constraints={"type": "ineq", "fun": lambda y, G=G, b=least: G @ y - b},
            method="SLSQP",
            options={"ftol": 1e-12},
        )
        assert np.linalg.norm(x - step) <= np.linalg.norm(best.x - step) + 1e-5
        assert G[list(active)] @ x == pytest.approx(least[list(active)], abs=1e-8)
        held.append(len(active))
    assert len(held) > 50
    assert max(held) > 1


def test_a_step_that_nothing_stands_against_is_itself():
    step = np.full(5, 0.1)
    none = np.zeros((0, 7))
    assert nearest(step, [none])[0] == pytest.approx(step)
    x, active = nearest(step, [none, np.eye(5, 7)])
    assert x is step or x == pytest.approx(step)
    assert list(active) == []


def test_bounds_that_no_step_keeps_have_none():
    against = np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]])
    assert nearest(np.zeros(5), [against])[0] is None


@pytest.mark.parametrize("many", [MOST, 100])
def test_the_bounds_with_the_least_room_count_and_are_reported_by_number(many):
    wide = np.tile([-1.0, 0.0, 0.0, 0.0, 0.0, -5.0, 1.0], (many, 1))
    tight = np.array([[0.0, -1.0, 0.0, 0.0, 0.0, -0.5, 0.0]])
    x, active = nearest(np.ones(5), [wide, tight])
    assert x == pytest.approx([1.0, 0.5, 1.0, 1.0, 1.0])
    assert list(active) == [many]
