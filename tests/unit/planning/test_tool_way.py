import numpy as np
import pytest

from so101_motion.errors import ConfigError
from so101_motion.geometry import SE3, rot_z, rotation_angle
from so101_motion.planning.goals import ArcTo, LineTo
from so101_motion.planning.tool_way import LEVER, straight_way, way_through

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
    way = straight_way(T0, T1)
    s = np.linspace(0.0, way.length, 5)
    turned = [rotation_angle(T0.R.T @ R) for R in way.rotations(s)]
    assert turned == pytest.approx(np.linspace(0.0, way.turn, 5), abs=1e-12)
    assert way.rotations(s)[-1] == pytest.approx(T1.R, abs=1e-12)
    assert way.places(s)[2] == pytest.approx(0.5 * (T0.p + T1.p))


@pytest.mark.parametrize("angle", [1e-9, 0.3, 3.0, np.pi])
def test_a_turn_on_the_spot_counts_as_long_as_its_lever(angle):
    way = straight_way(T0, SE3(T0.R @ rot_z(angle), T0.p))
    assert way.spin
    assert way.turn == pytest.approx(angle, abs=1e-12)
    assert way.length == pytest.approx(max(LEVER * angle, 1e-6))
    end = way.rotations(np.array([way.length]))[0]
    assert end == pytest.approx(T0.R @ rot_z(angle), abs=1e-9)


def test_without_blending_the_way_rests_at_every_corner():
    way = way_through(T0, SEGMENTS, 0.0)
    assert len(way.rests) == 2
    assert way.places(np.array(way.rests)) == pytest.approx(np.array([T1.p, T2.p]))
    assert way.rotations(np.array(way.rests))[0] == pytest.approx(T1.R)
    assert way.segments == 3
    assert [way.segment_at(s) for s in np.linspace(0.0, way.length, 7)] == [0, 0, 1, 1, 2, 2, 2]


@pytest.mark.parametrize("blend", [0.005, 0.02, 0.05])
def test_with_blending_place_and_orientation_have_no_corners(blend):
    way = way_through(T0, SEGMENTS, blend)
    assert way.rests == []
    s = np.linspace(0.0, way.length, 40001)
    h = s[1]
    for values, most in ((way.places(s), 1.0), (way.rotations(s).reshape(-1, 9), 40.0)):
        rate = np.diff(values, axis=0) / h
        bend = np.diff(rate, axis=0) / h
        # Where direction or curvature jumped, a difference would be as large as what it is of.
        assert np.abs(rate).max() < 1.05 * most
        assert np.abs(np.diff(rate, axis=0)).max() < 0.01 * most
        assert np.abs(np.diff(bend, axis=0)).max() < 0.02 * np.abs(bend).max() + 1e-3
    assert way.places(s[[0, -1]]) == pytest.approx(np.array([T0.p, T3.p]))
    assert way.rotations(s[[0, -1]]) == pytest.approx(np.array([T0.R, T3.R]), abs=1e-12)


def test_a_short_segment_gives_half_of_itself_to_each_corner():
    middle = LineTo(T_base_tool=SE3(T1.R, T1.p + np.array([0.0, 0.004, 0.0])))
    last = LineTo(T_base_tool=SE3(T1.R, T1.p + np.array([0.05, 0.004, 0.0])))
    way = way_through(T0, (SEGMENTS[0], middle, last), 0.02)
    p = way.places(np.linspace(0.0, way.length, 5001))
    assert (
        np.linalg.norm(p - (T1.p + np.array([0.0, 0.002, 0.0])), axis=1).min() < way.length / 5000
    )


@pytest.mark.parametrize("blend", [-0.01, float("nan"), float("inf")])
def test_a_blend_that_is_no_length_is_refused(blend):
    with pytest.raises(ConfigError, match=r"blend.*must be 0 or more and finite"):
        way_through(T0, SEGMENTS, blend)


def test_a_path_of_nothing_is_refused():
    with pytest.raises(ConfigError, match="needs at least one line or arc"):
        way_through(T0, (), 0.0)
