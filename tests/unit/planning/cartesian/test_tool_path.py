import numpy as np
import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, rot_z, rotation_angle
from so101_motion.planning.cartesian.tool_path import LEVER, path_through, straight_path
from so101_motion.planning.goals import ArcTo, LineTo

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
