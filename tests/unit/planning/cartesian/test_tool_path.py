import numpy as np
import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, rot_z, rotation_angle
from so101_motion.planning.cartesian.curve_fit import (
    EXACT,
    SMOOTHED,
    CurveFitter,
    FitFailure,
    curve_through,
)
from so101_motion.planning.cartesian.tool_path import (
    LEVER,
    Arc,
    Line,
    curve_of,
    path_through,
    rounded,
    straight_path,
)
from so101_motion.planning.goals import ArcTo, LineTo
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.timing.path_geometry import JointPath

T0 = SE3.from_rpy((0.1, 0.2, 0.3), (0.2, 0.0, 0.1))
T1 = SE3.from_rpy((0.5, 0.2, 0.3), (0.3, 0.0, 0.1))
T2 = SE3.from_rpy((0.5, 0.9, 0.3), (0.3, 0.1, 0.1))
T3 = SE3.from_rpy((0.5, 0.9, -0.3), (0.2, 0.1, 0.2))
SEGMENTS = (
    LineTo(T_base_tool=T1),
    ArcTo(T_base_tool=T2, p_via=np.array([0.35, 0.05, 0.1])),
    LineTo(T_base_tool=T3),
)


def test_on_a_line_the_frame_turns_steadily():
    tool_path = straight_path(T0, T1)
    s = np.linspace(0.0, tool_path.length, 5)
    turned = [rotation_angle(T0.R.T @ R) for R in tool_path.rotations(s)]
    assert turned == pytest.approx(np.linspace(0.0, tool_path.turn, 5), abs=1e-12)
    assert tool_path.rotations(s)[-1] == pytest.approx(T1.R, abs=1e-12)
    assert tool_path.places(s)[2] == pytest.approx(0.5 * (T0.p + T1.p))


@pytest.mark.parametrize("angle", [1e-9, 0.3, 3.0, np.pi])
def test_a_turn_on_the_spot_counts_as_long_as_its_lever(angle):
    tool_path = straight_path(T0, SE3(T0.R @ rot_z(angle), T0.p))
    assert tool_path.spin
    assert tool_path.turn == pytest.approx(angle, abs=1e-12)
    assert tool_path.length == pytest.approx(max(LEVER * angle, 1e-6))
    end = tool_path.rotations(np.array([tool_path.length]))[0]
    assert end == pytest.approx(T0.R @ rot_z(angle), abs=1e-9)


def test_without_blending_the_path_rests_at_every_corner():
    tool_path = path_through(T0, SEGMENTS, 0.0)
    assert len(tool_path.rests) == 2
    assert tool_path.places(np.array(tool_path.rests)) == pytest.approx(np.array([T1.p, T2.p]))
    assert tool_path.rotations(np.array(tool_path.rests))[0] == pytest.approx(T1.R)
    assert tool_path.segments == 3
    assert [tool_path.segment_at(s) for s in np.linspace(0.0, tool_path.length, 7)] == [
        0,
        0,
        1,
        1,
        2,
        2,
        2,
    ]


@pytest.mark.parametrize("blend", [0.005, 0.02, 0.05])
def test_with_blending_place_and_orientation_have_no_corners(blend):
    tool_path = path_through(T0, SEGMENTS, blend)
    assert tool_path.rests == []
    s = np.linspace(0.0, tool_path.length, 40001)
    h = s[1]
    for values, most in ((tool_path.places(s), 1.0), (tool_path.rotations(s).reshape(-1, 9), 40.0)):
        rate = np.diff(values, axis=0) / h
        bend = np.diff(rate, axis=0) / h
        # Where direction or curvature jumped, a difference would be as large as what it is of.
        assert np.abs(rate).max() < 1.05 * most
        assert np.abs(np.diff(rate, axis=0)).max() < 0.01 * most
        assert np.abs(np.diff(bend, axis=0)).max() < 0.02 * np.abs(bend).max() + 1e-3
    assert tool_path.places(s[[0, -1]]) == pytest.approx(np.array([T0.p, T3.p]))
    assert tool_path.rotations(s[[0, -1]]) == pytest.approx(np.array([T0.R, T3.R]), abs=1e-12)


def test_a_short_segment_gives_half_of_itself_to_each_corner():
    middle = LineTo(T_base_tool=SE3(T1.R, T1.p + np.array([0.0, 0.004, 0.0])))
    last = LineTo(T_base_tool=SE3(T1.R, T1.p + np.array([0.05, 0.004, 0.0])))
    tool_path = path_through(T0, (SEGMENTS[0], middle, last), 0.02)
    p = tool_path.places(np.linspace(0.0, tool_path.length, 5001))
    assert (
        np.linalg.norm(p - (T1.p + np.array([0.0, 0.002, 0.0])), axis=1).min()
        < tool_path.length / 5000
    )


@pytest.mark.parametrize("blend", [-0.01, float("nan"), float("inf")])
def test_a_blend_that_is_no_length_is_refused(blend):
    with pytest.raises(ConfigError, match=r"blend.*must be 0 or more and finite"):
        path_through(T0, SEGMENTS, blend)


def test_a_path_of_nothing_is_refused():
    with pytest.raises(ConfigError, match="needs at least one line or arc"):
        path_through(T0, (), 0.0)


# Segments and rounded corners

START = np.array([0.2, 0.05, 0.1])


def to(p):
    return SE3.from_translation(np.array(p))


def arc(end, via):
    return curve_of(START, ArcTo(T_base_tool=to(START + end), p_via=START + via), 1)


def test_a_line_runs_straight_to_its_end():
    line = curve_of(START, LineTo(T_base_tool=to(START + np.array([0.03, 0.0, -0.04]))), 1)
    assert line.length == pytest.approx(0.05)
    places = line.at(np.array([0.0, 0.025, 0.05]))
    assert places.p[1] == pytest.approx(START + np.array([0.015, 0.0, -0.02]))
    assert places.direction[0] == pytest.approx([0.6, 0.0, -0.8])
    assert not np.any(places.curvature)


@pytest.mark.parametrize(
    ("end", "via"),
    [
        ([0.04, 0.0, 0.0], [0.02, 0.02, 0.0]),
        ([0.04, 0.0, 0.0], [0.02, 0.0, -0.005]),
        ([0.01, 0.0, 0.0], [-0.03, 0.02, 0.01]),  # nearly all of a circle
        ([0.0, 0.03, 0.02], [0.01, 0.01, 0.03]),
    ],
)
def test_an_arc_passes_its_three_points_at_one_speed(end, via):
    made = arc(np.array(end), np.array(via))
    s = np.linspace(0.0, made.length, 2001)
    p, direction, curvature = made.at(s)
    assert p[0] == pytest.approx(START, abs=1e-12)
    assert p[-1] == pytest.approx(START + end, abs=1e-12)
    step = made.length / 2000
    assert np.linalg.norm(p - (START + via), axis=1).min() < step
    assert np.linalg.norm(np.diff(p, axis=0), axis=1) == pytest.approx(step, rel=1e-5)
    assert np.gradient(p, step, axis=0)[1:-1] == pytest.approx(direction[1:-1], abs=1e-4)
    assert np.gradient(direction, step, axis=0)[1:-1] == pytest.approx(curvature[1:-1], abs=0.05)


@pytest.mark.parametrize("via", [[0.02, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
def test_three_points_on_a_line_are_no_arc(via):
    with pytest.raises(ConfigError, match="too straight for an arc; move its via point aside"):
        arc(np.array([0.04, 0.0, 0.0]), np.array(via))


def test_a_segment_without_length_is_refused_by_its_number():
    with pytest.raises(ConfigError, match=r"segment 3 ends where it starts; leave it out$"):
        curve_of(START, LineTo(T_base_tool=to(START)), 3)
    with pytest.raises(ConfigError, match="make a full circle of two arcs"):
        curve_of(START, ArcTo(T_base_tool=to(START), p_via=START + np.array([0.01, 0.0, 0.0])), 1)


def line(p_start, direction, length=0.1):
    p_end = p_start + length * np.array(direction)
    return Line(p_start=p_start, p_end=p_end, length=length)


def quarter(p_start, radius=0.05):
    return Arc(
        centre=p_start + np.array([0.0, radius, 0.0]),
        first=np.array([0.0, -1.0, 0.0]),
        second=np.array([1.0, 0.0, 0.0]),
        radius=radius,
        length=0.5 * np.pi * radius,
    )


CORNERS = {
    "no corner": lambda p: line(p, [1.0, 0.0, 0.0]),
    "slight": lambda p: line(p, [np.cos(0.2), np.sin(0.2), 0.0]),
    "right angle": lambda p: line(p, [0.0, 0.0, 1.0]),
    "sharp": lambda p: line(p, [np.cos(2.6), np.sin(2.6), 0.0]),
    "straight back": lambda p: line(p, [-1.0, 0.0, 0.0]),
    "into an arc": quarter,
}


@pytest.mark.parametrize("after", CORNERS.values(), ids=CORNERS)
def test_a_rounding_agrees_with_both_sides_in_place_direction_and_curvature(after):
    reach = 0.02
    first = line(START, [1.0, 0.0, 0.0])
    second = after(START + np.array([0.1, 0.0, 0.0]))
    rounding = rounded(first, second, reach)
    h = 1e-5 * rounding.length
    for curve, along, here, tool_path in (
        (first, first.length - reach, 0.0, 1.0),
        (second, reach, rounding.length, -1.0),
    ):
        p = rounding.at(here + tool_path * h * np.arange(4))[:, :3]
        place = curve.at(np.array([along]))
        assert p[0] == pytest.approx(place.p[0], abs=1e-12)
        assert tool_path * (p[1] - p[0]) / h == pytest.approx(place.direction[0], abs=1e-3)
        bend = (2.0 * p[0] - 5.0 * p[1] + 4.0 * p[2] - p[3]) / h**2
        assert bend == pytest.approx(place.curvature[0], abs=0.05)


@pytest.mark.parametrize("after", CORNERS.values(), ids=CORNERS)
def test_a_rounding_is_run_through_evenly_and_stays_near_the_corner(after):
    reach = 0.02
    corner = START + np.array([0.1, 0.0, 0.0])
    rounding = rounded(line(START, [1.0, 0.0, 0.0]), after(corner), reach)
    s = np.linspace(0.0, rounding.length, 1001)
    p = rounding.at(s)
    speed = np.linalg.norm(np.diff(p[:, :3], axis=0), axis=1) / s[1]
    assert speed.max() < 1.01  # slower where the path turns back, never faster
    assert np.linalg.norm(p[:, :3] - corner, axis=1).max() <= reach * 1.001
    assert np.all(np.diff(p[:, 3]) > 0.0)


# Curves of the joints


READY = np.radians([0, -45, 45, 60, 20])
TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def chain(model):
    return ArmChain(model)


@pytest.fixture(scope="module")
def fitter(model, chain):
    return CurveFitter(chain, model.lower, model.upper, TOLERANCE)


@pytest.fixture(scope="module")
def tool_path(model):
    T = model.frame(READY)
    return straight_path(T, SE3(T.R, T.p + np.array([0.02, 0.06, 0.03])))


def configurations_on(model, tool_path, s, pitches):
    """Configurations on a path whose pitch is prescribed, by Newton's method on the model."""
    q, found = READY.copy(), []
    for p, pitch in zip(tool_path.places(s), pitches, strict=True):
        for _ in range(20):
            J = np.zeros((5, 5))
            J[:3] = model.frame_jacobian(q)[:3]
            J[3, 1:4], J[4, 4] = 1.0, 1.0
            off = np.append(p - model.frame(q).p, [pitch - q[1:4].sum(), READY[4] - q[4]])
            q = q + np.linalg.solve(J, off)
        found.append(q)
    return np.array(found)


def accepts_all(curve):
    return None


def distance(chain, tool_path, curve):
    s = np.linspace(0.0, curve.length, 501)
    return np.linalg.norm(chain.positions(curve.evaluate(s).q) - tool_path.places(s), axis=1).max()


@pytest.mark.parametrize("stiffnesses", [SMOOTHED, EXACT], ids=["smooth", "true"])
def test_the_tool_keeps_to_its_path_all_along_the_curve(
    model, chain, fitter, tool_path, stiffnesses
):
    s = np.linspace(0.0, tool_path.length, 9)
    stairs = READY[1:4].sum() + 0.08 * np.floor(np.arange(9) / 3)
    q = configurations_on(model, tool_path, s, stairs)
    curve = fitter.fit(tool_path, s, q, stiffnesses, accepts_all)
    assert isinstance(curve, JointPath)
    assert distance(chain, tool_path, curve) < TOLERANCE
    assert np.array_equal(curve.evaluate([0.0]).q[0], q[0])
    assert curve.evaluate([tool_path.length]).q[0] == pytest.approx(q[-1], abs=1e-6)


def test_steps_of_pitch_are_evened_out_where_nobody_asked_for_them(model, fitter, tool_path):
    s = np.linspace(0.0, tool_path.length, 9)
    stairs = READY[1:4].sum() + 0.08 * np.floor(np.arange(9) / 3)
    q = configurations_on(model, tool_path, s, stairs)

    def wobble(stiffnesses):
        curve = fitter.fit(tool_path, s, q, stiffnesses, accepts_all)
        pitch = curve.evaluate(np.linspace(0.0, curve.length, 200)).q[:, 1:4].sum(axis=1)
        return np.abs(np.diff(pitch, 2)).max()

    assert wobble(SMOOTHED) < 0.3 * wobble(EXACT)


def test_a_pitch_that_stays_is_left_alone(model, fitter, tool_path):
    s = np.linspace(0.0, tool_path.length, 9)
    q = configurations_on(model, tool_path, s, np.full(9, READY[1:4].sum()))
    curve = fitter.fit(tool_path, s, q, SMOOTHED, accepts_all)
    knots = curve.evaluate(curve.knots[:: (len(curve.knots) - 1) // 8]).q
    assert knots == pytest.approx(q, abs=1e-9)


def test_a_curve_that_is_not_accepted_is_tried_less_smooth_and_then_given_up(
    model, fitter, tool_path
):
    s = np.linspace(0.0, tool_path.length, 9)
    q = configurations_on(
        model, tool_path, s, READY[1:4].sum() + 0.05 * np.array([0, 1, 0, 1, 0, 1, 0, 1, 0])
    )
    tried = []

    def refuse(curve):
        tried.append(curve)
        return FitFailure(s=0.01, q=q[0], in_contact=True)

    assert fitter.fit(tool_path, s, q, SMOOTHED, refuse).in_contact
    assert len(tried) == len(SMOOTHED)


def test_where_postures_are_not_one_motion_there_is_no_curve(model, fitter, tool_path):
    s = np.linspace(0.0, tool_path.length, 9)
    q = configurations_on(model, tool_path, s, np.full(9, READY[1:4].sum()))
    q[5:] = configurations_on(model, tool_path, s[5:], np.full(4, READY[1:4].sum() - 2.5))
    found = fitter.fit(tool_path, s, np.clip(q, model.lower, model.upper), EXACT, accepts_all)
    assert isinstance(found, FitFailure)
    assert s[4] < found.s < s[5]


def test_a_curve_does_not_bulge_over_a_joint_limit(model, chain):
    T = model.frame(READY)
    tool_path = straight_path(T, SE3(T.R, T.p + np.array([0.05, 0.0, 0.0])))
    s = np.linspace(0.0, tool_path.length, 9)
    q = configurations_on(model, tool_path, s, np.full(9, READY[1:4].sum()))
    tight = CurveFitter(chain, q.min(axis=0), q.max(axis=0), TOLERANCE)
    found = tight.fit(tool_path, s, q, EXACT, accepts_all)
    assert isinstance(found, JointPath)
    inside = found.evaluate(np.linspace(0.0, found.length, 2001)).q
    assert np.all(inside >= q.min(axis=0) - 1e-6)
    assert np.all(inside <= q.max(axis=0) + 1e-6)


def test_the_curve_through_points_of_a_cubic_is_that_cubic():
    u = np.linspace(0.0, 1.0, 9)[:, None]
    factors = np.arange(1.0, 6.0)
    path = curve_through(factors * (u**3 - u**2) + u, 1.0)
    at = np.linspace(0.0, 1.0, 41)
    expected = factors * (at**3 - at**2)[:, None] + at[:, None]
    assert path.evaluate(at).q == pytest.approx(expected, abs=1e-12)
    slope = factors * (3.0 * at**2 - 2.0 * at)[:, None] + 1.0
    assert path.evaluate(at).q_s == pytest.approx(slope, abs=1e-10)
