import numpy as np
import pytest

from so101_motion.errors import ConfigError, InCollision, Unreachable
from so101_motion.geometry import SE3
from so101_motion.planning.cartesian import LinePlanner
from so101_motion.planning.collision import CollisionModel
from so101_motion.planning.goals import GoalMetric, LineGoal
from so101_motion.planning.ik import IkSolver
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.model import RobotModel
from so101_motion.planning.tool_line import curve_through
from so101_motion.planning.verify import check

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
TOOL_DOWN = np.radians([0, -20, 20, 90, 0])
READY = np.radians([0, -45, 45, 60, 0])


@pytest.fixture(scope="module")
def model():
    return RobotModel.load()


@pytest.fixture(scope="module")
def collision(model):
    return CollisionModel(model)


@pytest.fixture(scope="module")
def lines(model):
    return LinePlanner(IkSolver(model))


@pytest.fixture(scope="module")
def find(model, lines, collision):
    def find(q_start, offset, **options):
        frame = options.get("frame", "tool")
        T = model.frame(q_start, frame)
        goal = LineGoal(T_base_tool=SE3(T.R, T.p + np.array(offset)), **options)
        return lines.find(goal, q_start, collision, 0.0)

    return find


def distance_from_line(points, begin, way):
    along = way / np.linalg.norm(way)
    offset = points - begin
    return np.linalg.norm(offset - np.outer(offset @ along, along), axis=1)


@pytest.mark.parametrize("frame", ["tool", "jaw_tip"])
@pytest.mark.parametrize(
    "offset", [(0.04, 0.0, 0.02), (0.0, 0.1, 0.0), (-0.05, -0.05, 0.05), (0.0, 0.0, -0.03)]
)
def test_the_tool_stays_on_the_line_at_every_instant(model, find, frame, offset):
    line = find(READY, offset, frame=frame)
    motion = line.timed(LIMITS, 0.001)
    check(motion, LIMITS, model.lower, model.upper)
    begin = model.frame(READY, frame).p
    points = np.array([model.frame(q, frame).p for q in motion.q])
    assert distance_from_line(points, begin, np.array(offset)).max() < 1e-4
    assert points[-1] == pytest.approx(begin + offset, abs=1e-5)
    assert np.array_equal(motion.q[0], READY)


def test_the_pitch_is_kept_where_it_can_be(model, find):
    line = find(TOOL_DOWN, (0.0, 0.0, -0.03))
    pitch = line.waypoints[:, 1:4].sum(axis=1)
    assert np.ptp(pitch) < 1e-6


def test_the_pitch_gives_way_where_it_must(model, find):
    # With the hand level the arm cannot come so close; with another pitch it can.
    line = find(np.zeros(5), (-0.2, 0.0, 0.0))
    assert np.ptp(line.waypoints[:, 1:4].sum(axis=1)) > 0.05


def test_the_approach_is_kept_where_it_counts(model, find):
    line = find(TOOL_DOWN, (0.02, 0.03, 0.0), metric=GoalMetric.POSITION_AND_APPROACH)
    for q in line.path.evaluate(np.linspace(0.0, 1.0, 50)).q:
        assert model.frame(q).R[:, 2] == pytest.approx([0.0, 0.0, -1.0], abs=1e-3)


def test_the_whole_pose_is_reached_where_it_counts(model, find):
    line = find(TOOL_DOWN, (0.0, 0.03, 0.0), metric=GoalMetric.FULL_POSE)
    reached = model.frame(line.waypoints[-1])
    assert np.allclose(reached.R, model.frame(TOOL_DOWN).R, atol=1e-3)


def test_the_tool_moves_at_one_speed_and_keeps_its_cap(model, find):
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=0.05)
    motion = find(READY, (0.0, 0.1, 0.0)).timed(limits, 0.01)
    points = np.array([model.frame(q).p for q in motion.q])
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1) / 0.01
    assert speed.max() < 0.05 * 1.001
    assert np.ptp(speed[20:-20]) < 1e-4


def test_a_line_without_length_is_no_motion(find):
    motion = find(READY, (0.0, 0.0, 0.0)).timed(LIMITS, 0.01)
    assert len(motion) == 1
    assert motion.duration == 0.0
    assert np.array_equal(motion.q[0], READY)


def test_a_line_out_of_reach_says_how_far_it_can_be_followed_and_why(model, find):
    with pytest.raises(Unreachable) as caught:
        find(np.zeros(5), (0.1, 0.0, 0.0))
    message = str(caught.value)
    assert message.startswith("the tool can follow 6")
    assert "of the 100 mm of the line: there it is stopped by full stretch" in message
    assert caught.value.limit == "full stretch"
    assert 0.03 < caught.value.error_position < 0.04
    reached = model.frame(caught.value.q_nearest).p
    assert reached == pytest.approx(caught.value.p_base_nearest, abs=1e-4)


def test_a_line_into_the_floor_says_where_it_would_touch(find):
    with pytest.raises(InCollision, match=r"can follow \d+ of the 200 mm .* the floor") as caught:
        find(TOOL_DOWN, (0.0, 0.0, -0.2))
    assert caught.value.second == "floor"
    assert caught.value.where == "way"


def test_an_approach_that_does_not_exist_at_the_end_is_refused(model, lines, collision):
    p_base = model.frame(READY).p + np.array([0.02, 0.0, 0.0])
    sideways = SE3.from_rpy((np.pi / 2, 0.0, 0.0), p_base)
    goal = LineGoal(T_base_tool=sideways, metric=GoalMetric.POSITION_AND_APPROACH)
    with pytest.raises(Unreachable, match="five joints cannot turn it"):
        lines.find(goal, READY, collision, 0.0)


def test_a_goal_that_is_no_number_is_refused(find):
    with pytest.raises(ConfigError, match="finite"):
        find(READY, (float("nan"), 0.0, 0.0))


@pytest.mark.parametrize("tolerance", [0.0, float("nan")])
def test_a_tolerance_that_is_none_is_refused(find, tolerance):
    with pytest.raises(ConfigError, match="tolerance"):
        find(READY, (0.01, 0.0, 0.0), tolerance=tolerance)


def test_a_line_past_the_pan_axis_says_what_it_is_stopped_by(find):
    above = np.radians([0, -80, -40, 60, 0])
    with pytest.raises(Unreachable, match=r"of the 300 mm of the line: there it is "):
        find(above, (-0.3, 0.001, 0.0))


def test_the_curve_through_points_of_a_cubic_is_that_cubic():
    u = np.linspace(0.0, 1.0, 9)[:, None]
    factors = np.arange(1.0, 6.0)
    path = curve_through(factors * (u**3 - u**2) + u)
    at = np.linspace(0.0, 1.0, 41)
    expected = factors * (at**3 - at**2)[:, None] + at[:, None]
    assert path.evaluate(at).q == pytest.approx(expected, abs=1e-12)
    slope = factors * (3.0 * at**2 - 2.0 * at)[:, None] + 1.0
    assert path.evaluate(at).q_s == pytest.approx(slope, abs=1e-10)
