"""Plans for several arms at once: they begin and end together and keep apart all the way."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from harness.facing_arms import T_LEFT_RIGHT, Facing

from so101_motion.common.errors import InCollision, NoPath, Overloaded, Unreachable
from so101_motion.common.geometry import SE3, rot_z
from so101_motion.planning.cell import together
from so101_motion.planning.cell.team_requests import TeamMember
from so101_motion.planning.cell.together import plan_together
from so101_motion.planning.collision.apart import ROOM, first_meeting
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.course import Course
from so101_motion.planning.goals import JointGoal, PoseGoal
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Strength

CAPS = MotionLimits.uniform(velocity=1.5, acceleration=6.0, jerk=60.0)
PLACES = (SE3.identity(), T_LEFT_RIGHT)


def team_of(starts, goals, places=PLACES):
    return [
        TeamMember(
            name=f"arm {k}", T_cell_base=T, request=PlanRequest(q_start=q, goal=goal, limits=CAPS)
        )
        for k, (q, goal, T) in enumerate(zip(starts, goals, places, strict=True))
    ]


def assert_apart(team, plans):
    trajectories = [plans[each.name].trajectory for each in team]
    assert len({len(each) for each in trajectories}) == 1
    for (a, one), (b, other) in combinations(zip(team, trajectories, strict=True), 2):
        met = first_meeting(
            (bodies_of(), Course.along(one, 0.0)),
            (bodies_of(), Course.along(other, 0.0)),
            a.T_cell_base.inverse @ b.T_cell_base,
            since=0.0,
            room=0.99 * ROOM,
        )
        assert met is None


def swapping(facing):
    """A task in which nobody can go first: each goal is where the other arm stands."""
    while True:
        starts, goals = facing.task_of_starts()
        if not facing.are_apart(goals[0], starts[1], 0.005) and not facing.are_apart(
            starts[0], goals[1], 0.005
        ):
            return starts, goals


def test_arms_that_cross_are_there_together(planner):
    facing = Facing(41)
    for _ in range(2):
        starts, goals = facing.task()
        team = team_of(starts, [JointGoal(q=q) for q in goals])
        plans = plan_together(planner, team)
        assert_apart(team, plans)
        for member, q in zip(team, goals, strict=True):
            np.testing.assert_array_equal(plans[member.name].trajectory.q[-1], q)


def test_where_nobody_can_go_first_all_make_room(planner):
    facing = Facing(42)
    starts, goals = swapping(facing)
    team = team_of(starts, [JointGoal(q=q) for q in goals])
    plans = plan_together(planner, team)
    assert_apart(team, plans)
    for member, q in zip(team, goals, strict=True):
        np.testing.assert_allclose(plans[member.name].trajectory.q[-1], q, atol=1e-9)


def test_goals_that_exclude_each_other_are_refused_with_both_names(planner):
    facing = Facing(43)
    starts, goals = facing.task()
    while facing.are_apart(*goals, 0.005):
        goals = facing.near(), facing.near()
    with pytest.raises(InCollision, match=r"arm 0's .* arm 1's"):
        plan_together(planner, team_of(starts, [JointGoal(q=q) for q in goals]))


def test_three_arms_are_not_special(planner):
    places = [
        SE3(rot_z(angle), -0.3 * np.array([np.cos(angle), np.sin(angle), 0.0]))
        for angle in (0.0, 2.0 * np.pi / 3.0, 4.0 * np.pi / 3.0)
    ]
    starts = [np.array([0.6, -0.4, 0.4, 0.3, 0.0])] * 3
    points = [np.array([0.22, y, 0.16]) for y in (-0.1, -0.1, -0.1)]
    team = team_of(starts, [PoseGoal.at_point(p) for p in points], places)
    plans = plan_together(planner, team)
    assert_apart(team, plans)


class HopelessPlanner:
    """Finds nothing, and takes all the time that it may on a clock of its own."""

    def __init__(self):
        self.t = 0.0

    def monotonic(self):
        return self.t

    def plan(self, request):
        self.t += request.time_budget
        raise NoPath("there is no path", where="path", blockers=())


def test_all_methods_together_keep_to_one_time_budget(planner, monkeypatch):
    six = tuple(SE3(np.eye(3), np.array([k, 0.0, 0.0])) for k in range(6))
    team = team_of([np.zeros(5)] * 6, [JointGoal(q=np.full(5, 0.1))] * 6, six)
    hopeless = HopelessPlanner()
    monkeypatch.setattr(together, "time", hopeless)
    left = []
    monkeypatch.setattr(
        together, "_as_one", lambda _planner, _team, ends: left.append(ends - hopeless.t)
    )
    plan_together(hopeless, team)
    budget = team[0].request.time_budget
    assert left[0] > 0.3 * budget
    assert hopeless.t + left[0] <= 1.2 * budget


ASIDE, LOW = np.array([0.6, -0.4, 0.4, 0.3, 0.0]), np.array([0.5, 1.2, 0.3, 0.0, 0.0])


@pytest.mark.parametrize(
    ("goals", "error", "says"),
    [
        ((JointGoal(q=LOW), JointGoal(q=0.9 * ASIDE)), InCollision, "^arm 0: at the goal .* floor"),
        ((JointGoal(q=0.9 * ASIDE), JointGoal(q=LOW)), InCollision, "^arm 1: at the goal .* floor"),
        ((JointGoal(q=0.9 * ASIDE), PoseGoal.at_point([0.9, 0, 0.1])), Unreachable, "^arm 1: "),
    ],
)
def test_a_goal_that_one_arm_cannot_have_is_refused_with_its_name(planner, goals, error, says):
    with pytest.raises(error, match=says):
        plan_together(planner, team_of([ASIDE, ASIDE], goals))


def test_an_arm_too_weak_to_make_room_for_the_other_is_named(planner):
    """It could go to its goal alone, but not on the path of both."""
    starts, goals = swapping(Facing(46))
    weak = replace(Strength.of_servos(12.0), shares=(0.25,) * 5)
    one, other = team_of(starts, [JointGoal(q=q) for q in goals])
    planner.plan(replace(other.request, strength=weak))
    team = [one, replace(other, request=replace(other.request, strength=weak))]
    with pytest.raises(Overloaded, match=r"^arm 1: shoulder_lift .* on the way"):
        plan_together(planner, team)
