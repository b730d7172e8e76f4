import numpy as np
import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.planning.cartesian.tool_path import Arc, Line, curve_of, rounded
from so101_motion.planning.goals import ArcTo, LineTo

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
