"""Constraints of Viam on the way of a component: what is read, kept and refused."""

import math

import numpy as np
import pytest
from viam.proto.service.motion import (
    Constraints,
    LinearConstraint,
    OrientationConstraint,
    PseudolinearConstraint,
)

from so101_motion.common.errors import ConfigError, PlanningError
from so101_motion.common.geometry import SE3, rot_x, rot_z
from so101_motion.viam.conversion.tool_constraints import ToolConstraints

COUNT = 41


def component(q):
    """A component where the first three numbers say, turned about x and then about its own z."""
    return SE3(rot_x(q[3]) @ rot_z(q[4]), q[:3])


def way(*, length=0.1, turn_deg=0.0, mm=0.0, off_deg=0.0, about_z_deg=0.0):
    """A straight way along x with a steady turn; off both in its middle alone."""
    share = np.linspace(0.0, 1.0, COUNT)
    q = np.zeros((COUNT, 5))
    q[:, 0], q[:, 3] = length * share, np.radians(turn_deg) * share
    q[COUNT // 2, 1] += 1e-3 * mm
    q[COUNT // 2, 3] += np.radians(off_deg)
    q[COUNT // 2, 4] += np.radians(about_z_deg)
    return q


@pytest.mark.parametrize(
    ("constraints", "kept", "broken", "says"),
    [
        ({"line": 2e-3}, {"mm": 2.05}, {"mm": 2.2}, "50 % along.* 2.2 mm off .* 2 mm are allowed"),
        ({"line": 2e-3}, {"length": 0.0, "mm": 2.05}, {"length": 0.0, "mm": 2.2}, "2.2 mm off"),
        ({"line_share": 0.1}, {"mm": 10.05}, {"mm": 10.2}, "10.2 mm off .* 10 mm are allowed"),
        ({"line_share": 0.1, "line": 2e-3}, {"mm": 2.05}, {"mm": 2.2}, "2 mm are allowed"),
        ({"line_share": 0.1, "line": 2e-2}, {"mm": 10.05}, {"mm": 10.2}, "10 mm are allowed"),
        ({"turn": math.radians(5.0)}, {"turn_deg": 40.0, "off_deg": 5.0},
         {"turn_deg": 40.0, "off_deg": 5.1}, "50 % along.*turned 5.1 deg .* 5 deg are allowed"),
        ({"turn": math.radians(5.0)}, {"off_deg": -5.0}, {"about_z_deg": 5.1}, "turned 5.1 deg"),
        ({"turn_share": 0.2}, {"turn_deg": 40.0, "off_deg": 8.0},
         {"turn_deg": 40.0, "off_deg": 8.1}, "turned 8.1 deg .* 8 deg are allowed"),
        ({"turn": math.radians(5.0), "axis_only": True}, {"about_z_deg": 90.0}, {"off_deg": 5.1},
         "turned 5.1 deg"),
    ],
)  # fmt: skip
def test_a_way_within_its_constraints_is_kept_and_one_beyond_is_refused_with_both_figures(
    constraints, kept, broken, says
):
    asked = ToolConstraints(**constraints)
    asked.check(way(**kept), component)
    with pytest.raises(PlanningError, match=says):
        asked.check(way(**broken), component)
    ToolConstraints().check(way(**broken), component)  # nothing is asked


def test_a_way_beyond_its_goal_is_off_the_line_and_places_tell_how_far_it_should_have_turned():
    beyond = way()
    beyond[COUNT // 2, 0] = 0.105
    with pytest.raises(PlanningError, match=r"5\.0 mm off the straight line"):
        ToolConstraints(line=4e-3).check(beyond, component)
    late = way(turn_deg=40.0)
    late[:, :4] = late[[*[0] * (COUNT // 2), *range(COUNT - COUNT // 2)], :4]  # waits at its start
    late[-1] = way(turn_deg=40.0)[-1]
    ToolConstraints(turn=math.radians(1.0)).check(late, component)


def test_the_tightest_of_each_kind_is_read_in_si_units_and_0_asks_for_no_turn():
    asked = ToolConstraints.of(
        Constraints(
            linear_constraint=[
                LinearConstraint(line_tolerance_mm=5.0, orientation_tolerance_degs=0.0),
                LinearConstraint(line_tolerance_mm=2.0, orientation_tolerance_degs=9.0),
            ],
            pseudolinear_constraint=[
                PseudolinearConstraint(line_tolerance_factor=0.3, orientation_tolerance_factor=0.0),
                PseudolinearConstraint(line_tolerance_factor=0.2, orientation_tolerance_factor=0.4),
            ],
            orientation_constraint=[
                OrientationConstraint(orientation_tolerance_degs=4.0, ignore_theta=True),
                OrientationConstraint(orientation_tolerance_degs=6.0, ignore_theta=False),
            ],
        ),
        counts_turn=True,
    )
    kept = (asked.line, asked.line_share, asked.turn_share)
    assert kept == pytest.approx((0.002, 0.2, 0.4))
    assert asked.turn == pytest.approx(math.radians(4.0))
    assert (asked.axis_only, asked.wants_line, asked.is_any) == (False, True, True)
    assert ToolConstraints.of(None, counts_turn=True) == ToolConstraints()
    assert not ToolConstraints().is_any


def test_a_goal_without_an_orientation_leaves_it_free_on_a_line_and_theta_may_be_ignored():
    turning = Constraints(
        linear_constraint=[LinearConstraint(line_tolerance_mm=5.0, orientation_tolerance_degs=9.0)],
        pseudolinear_constraint=[PseudolinearConstraint(orientation_tolerance_factor=0.4)],
    )
    free = ToolConstraints.of(turning, counts_turn=False)
    assert free == ToolConstraints(line=0.005, wants_line=True)
    oriented = OrientationConstraint(orientation_tolerance_degs=4.0, ignore_theta=True)
    asked = ToolConstraints.of(Constraints(orientation_constraint=[oriented]), counts_turn=False)
    assert (asked.axis_only, asked.wants_line) == (True, False)
    for bad in (
        {"orientation_constraint": [OrientationConstraint(orientation_tolerance_degs=0.0)]},
        {"orientation_constraint": [OrientationConstraint(orientation_tolerance_degs=-1.0)]},
        {"linear_constraint": [LinearConstraint(line_tolerance_mm=-1.0)]},
        {"pseudolinear_constraint": [PseudolinearConstraint(line_tolerance_factor=math.nan)]},
    ):
        with pytest.raises(ConfigError):
            ToolConstraints.of(Constraints(**bad), counts_turn=True)
