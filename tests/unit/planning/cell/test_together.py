"""Plans for several arms at once: they begin and end together and keep apart all the way."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from harness.coal_check import CoalJudge
from harness.facing_arms import T_LEFT_RIGHT, Facing

from so101_motion.common.errors import ConfigError, InCollision, NoPath, Overloaded, Unreachable
from so101_motion.common.geometry import SE3, rot_z, rotation_angle, rotation_by
from so101_motion.planning.cell import together
from so101_motion.planning.cell.grasps import grasps_of
from so101_motion.planning.cell.handover import JawGeometry, plan_handover
from so101_motion.planning.cell.team_requests import HandoverRequest, TeamMember
from so101_motion.planning.cell.together import FAR, SHARE, pace_on, plan_together
from so101_motion.planning.collision.apart import (
    EARLY,
    PARTING,
    ROOM,
    clearance_over_time,
    distances,
    first_meeting,
    nearness,
)
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.course import Course, OtherArm
from so101_motion.planning.collision.scene import Attached, Box, Scene, Sphere, StandingArm
from so101_motion.planning.goals import JointGoal, PoseGoal
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.path_geometry import blended_path
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


def assert_together(team, plans, goals=(), within=0.0):
    """They begin and end together, at their goals, and keep apart."""
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
    for each, q in zip(trajectories, goals, strict=bool(goals)):
        np.testing.assert_allclose(each.q[-1], q, rtol=0.0, atol=within)


def swapping(facing):
    """A task in which nobody can go first: each goal is where the other arm stands."""
    apart = facing.are_apart
    while True:
        starts, goals = facing.task_of_starts()
        if not apart(goals[0], starts[1], 0.005) and not apart(starts[0], goals[1], 0.005):
            return starts, goals


def test_arms_that_cross_are_there_together(planner):
    facing = Facing(41)
    for _ in range(2):
        starts, goals = facing.task()
        team = team_of(starts, [JointGoal(q=q) for q in goals])
        assert_together(team, plan_together(planner, team), goals)


def test_where_nobody_can_go_first_all_make_room(planner):
    facing = Facing(42)
    starts, goals = swapping(facing)
    team = team_of(starts, [JointGoal(q=q) for q in goals])
    assert_together(team, plan_together(planner, team), goals, within=1e-9)


def test_goals_that_exclude_each_other_are_refused_with_both_names(planner):
    facing = Facing(43)
    starts, goals = facing.task()
    if facing.are_apart(*goals, 0.005):
        goals = facing.drawn(lambda *q: not facing.are_apart(*q, 0.005))
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
    assert_together(team, plan_together(planner, team))


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


# How fast several arms may move along a common path


T_FACING = SE3(rot_z(np.pi), np.array([0.35, 0.0, 0.0]))
TURNED = np.array([0.9, 0.0, 0.0, 0.0, 0.0])


def arms(T=T_FACING):
    request = PlanRequest(q_start=TURNED, goal=JointGoal(q=TURNED), limits=CAPS)
    return [TeamMember(name="", T_cell_base=each, request=request) for each in (SE3.identity(), T)]


def test_arms_are_slow_where_they_are_near_and_free_where_they_are_not():
    nearer = np.array([0.45, -0.2, 0.2, 0.0, 0.0])
    path = blended_path(np.array([np.tile(TURNED, 2), np.tile(nearer, 2)]), 0.01)
    pace = pace_on(path, arms())
    rate = np.ones((2, 10))
    q = path.evaluate(np.array([0.0, path.length])).q
    far, near = pace(q, rate)
    assert near > 2.0 * far
    assert pace(q, 2.0 * rate) == pytest.approx([2.0 * far, 2.0 * near])
    rate[:, 5:] = 0.0  # who rests is never early
    np.testing.assert_array_equal(pace(q, rate), 0.0)
    bodies = bodies_of()
    q_both = np.append(nearer, 0.0)[None]
    gap = distances(bodies, bodies, T_FACING, q_both, q_both, need=ROOM, enough=FAR)[0]
    fast = bodies.levers[:, :5].sum(axis=1)
    wanted = np.minimum(fast[:, None], fast) * EARLY / (SHARE * (gap - ROOM))
    assert near == pytest.approx(wanted.max(), rel=0.02)


def test_a_path_on_which_arms_could_not_move_at_all_has_no_pace():
    ahead = np.zeros(5)
    path = blended_path(np.array([np.tile(TURNED, 2), np.tile(ahead, 2)]), 0.01)
    assert pace_on(path, arms()) is None
    far = SE3(rot_z(np.pi), np.array([2.0, 0.0, 0.0]))
    pace = pace_on(path, arms(far))
    assert np.all(pace(path.evaluate([0.0]).q, np.ones((1, 10))) < 0.2)


# Plans among other moving arms


def request(q_start, q_goal, *others, **more):
    goal = JointGoal(q=q_goal)
    return PlanRequest(q_start=q_start, goal=goal, limits=CAPS, others=others, **more)


def right(course):
    return OtherArm(name="right", T_base_other=T_LEFT_RIGHT, course=course)


def left(course):
    return OtherArm(name="left", T_base_other=T_LEFT_RIGHT.inverse, course=course)


def test_a_plan_keeps_off_an_arm_that_moves_and_the_earlier_of_two_paths_is_taken(planner):
    facing = Facing(11)
    waited = 0
    for _ in range(5):
        starts, goals = facing.task()
        first = planner.plan(request(starts[0], goals[0], right(Course.resting(starts[1], 0.0))))
        course = Course.along(first.trajectory, 0.0)
        second = planner.plan(request(starts[1], goals[1], left(course)))
        pair = (facing.bodies, course), (facing.bodies, Course.along(second.trajectory, 0.0))
        assert first_meeting(*pair, T_LEFT_RIGHT, since=0.0, room=0.99 * ROOM) is None
        np.testing.assert_array_equal(second.trajectory.q[-1], goals[1])
        report = second.report
        if report.waits:
            still = round(report.waits / second.trajectory.dt)
            assert np.all(second.trajectory.q[: still + 1] == starts[1])
            assert report.waits_for == ("left",)
            assert report.waits <= first.duration + 0.1
            assert report.for_others == f"waits {report.waits:.2f} s for left"
            waited += 1
            report = replace(report, waits=0.0)
            assert report.for_others == "goes around left"
        elif not report.waits_for:
            assert report.for_others == ""
    assert waited


def test_a_goal_where_another_arm_will_rest_is_refused_by_its_name(planner):
    facing = Facing(12)
    apart = facing.are_apart
    q_left, q_right, q_goal = facing.drawn(
        lambda a, b, goal: apart(a, b) and not apart(goal, b, room=0.005), 3
    )
    with pytest.raises(InCollision) as caught:
        planner.plan(request(q_left, q_goal, right(Course.resting(q_right, 0.0))))
    assert caught.value.second.startswith("right's ")
    assert f"from {caught.value.second}" in str(caught.value) or "into right's" in str(caught.value)


def test_an_arm_too_near_to_a_moving_one_leaves_and_never_comes_nearer(planner):
    facing = Facing(14)
    for _ in range(2):
        while True:
            (q_left, q_right), goals = (facing.near(), facing.near()), facing.task()[1]
            is_near = not facing.are_apart(q_left, q_right, 0.018)
            can_go = facing.are_apart(q_left, goals[1], 0.03)
            if is_near and can_go and facing.are_apart(q_left, q_right, 0.008):
                break
        away = planner.plan(request(q_right, goals[1], left(Course.resting(q_left, 0.0))))
        course = Course.along(away.trajectory, 0.0)
        plan = planner.plan(request(q_left, goals[0], right(course)))
        own = Course.along(plan.trajectory, 0.0)
        pair = (facing.bodies, own), (facing.bodies, course)
        gaps = [
            nearness(*pair, T_LEFT_RIGHT, at=t, room=ROOM) or ROOM
            for t in np.arange(0.0, max(own.end, course.end) + 0.02, 0.02)
        ]
        assert min(gaps) > gaps[0] - 2.0 * PARTING
        assert gaps[-1] == ROOM
        assert min(gaps[gaps.index(ROOM) + 15 :]) > 0.75 * ROOM


def test_an_arm_that_stands_blocks_like_its_bodies_do(planner):
    facing = Facing(13)
    verdicts = set()
    for _ in range(30):
        q_left, q_right = facing.near(), facing.near()
        arm = StandingArm(name="right", T_base_arm=T_LEFT_RIGHT, q=[[*q_right, 0.0]], room=ROOM)
        scene = Scene(arms=(arm,))
        free = CollisionModel(facing.model, scene).is_free(q_left)
        by_coal = CoalJudge(facing.model, scene).is_free(q_left)
        assert free == by_coal
        if facing.are_apart(q_left, q_right, room=ROOM + 0.0031):
            assert free
        if not facing.are_apart(q_left, q_right, room=ROOM + 0.0029):
            assert not free
        verdicts.add(free)
    assert verdicts == {True, False}


def test_scenes_with_other_arms_are_told_apart():
    arm = StandingArm(name="right", T_base_arm=T_LEFT_RIGHT, q=np.zeros((1, 6)))
    scene = Scene(arms=(arm,))
    assert scene == Scene(arms=(replace(arm),))
    assert scene != Scene()
    assert scene != Scene(arms=(replace(arm, room=0.01),))
    assert scene.called("right's gripper") == "right's gripper"


# Handovers: fifty random poses, checked by other means


AWAY = np.radians([60.0, -30.0, 30.0, 30.0, 0.0])


def stick_in_hand(random, jaw):
    """A stick that is held somehow."""
    sides = random.uniform((0.012, 0.012, 0.1), (0.03, 0.03, 0.18))
    stick = Box(size=sides)
    grasps = list(grasps_of(stick))
    held = grasps[random.integers(len(grasps))]
    off = SE3(rotation_by(random.uniform(-0.1, 0.1, 3)), random.uniform(-0.003, 0.003, 3))
    T_tool_object = jaw.T_tool_grip(held.thickness) @ off @ held.T_object_grip.inverse
    return Attached(name="stick", shape=stick, T_tool_object=T_tool_object, mass=0.05)


def request_for(thing, q_left=AWAY, q_right=AWAY):
    strength = Strength.of_servos(12.0)
    team = [
        TeamMember(
            name=name,
            T_cell_base=T,
            request=PlanRequest(
                q_start=q,
                goal=JointGoal(q=q),
                limits=CAPS,
                scene=Scene(attached=held),
                strength=strength,
            ),
        )
        for name, T, q, held in (
            ("left", SE3.identity(), q_left, (thing,)),
            ("right", T_LEFT_RIGHT, q_right, ()),
        )
    ]
    return HandoverRequest(team=tuple(team), giver="left", taker="right", thing=thing.name)


def clearance(left, right, held_left, held_right):
    """How near the arms come, what they hold included [m]."""
    pair = (bodies_of(held_left), left), (bodies_of(held_right), right)
    times = np.linspace(0.0, max(left.end, right.end), 12)
    return min(each.distance for each in clearance_over_time(*pair, T_LEFT_RIGHT, times))


@pytest.mark.parametrize("seed", range(5))
def test_ten_random_poses_of_a_stick_are_passed_on(planner, seed):
    """Fifty of them in all."""
    random, model = np.random.default_rng(seed), Facing(0).model
    jaw = JawGeometry(model)
    for _ in range(10):
        thing = stick_in_hand(random, jaw)
        plan = plan_handover(planner, request_for(thing))
        left, right = plan.approach["left"], plan.approach["right"]
        np.testing.assert_allclose(plan.take.q_start, right.q_goal, atol=1e-9)
        np.testing.assert_allclose(plan.leave.q_start, left.q_goal, atol=1e-9)
        # One thing: it is where it was, in either hand.
        before = model.frame(left.q_goal) @ thing.T_tool_object
        after = T_LEFT_RIGHT @ model.frame(plan.take.q_goal) @ plan.taken.T_tool_object
        np.testing.assert_allclose(after.p, before.p, atol=1e-9)
        assert rotation_angle(after.R.T @ before.R) < 1e-9
        # The arms keep apart all the time, and the thing off the taker until it goes for it.
        comes = Course.along(right.trajectory, plan.q_jaw_open)
        assert clearance(Course.along(left.trajectory, 0.0), comes, (thing,), ()) > 0.019
        rest = Course.resting(left.q_goal, plan.q_jaw_free)
        assert clearance(rest, Course.along(plan.take.trajectory, plan.q_jaw_open), (), ()) > 0.019
        rest = Course.resting(plan.take.q_goal, plan.q_jaw_closed)
        leave = Course.along(plan.leave.trajectory, plan.q_jaw_free)
        assert clearance(leave, rest, (), ()) > 0.019
        last = Course.resting(plan.leave.q_goal, plan.q_jaw_free)
        assert clearance(last, rest, (), (plan.taken,)) > 0.019


def test_an_impossible_handover_says_why(planner):
    at = SE3.from_translation((0.0, 0.0, 0.1))
    ball = Attached(name="ball", shape=Sphere(radius=0.015), T_tool_object=at)
    with pytest.raises(NoPath, match=r"'ball' is too small to be passed on: .*20 mm must stay"):
        plan_handover(planner, request_for(ball))
    crate = replace(ball, name="crate", shape=Box(size=[0.1, 0.1, 0.1]))
    with pytest.raises(NoPath, match="'crate' is too thick"):
        plan_handover(planner, request_for(crate))
    with pytest.raises(ConfigError, match="left, right"):
        plan_handover(planner, replace(request_for(ball), taker="middle"))
    with pytest.raises(ConfigError, match="which holds: ball"):
        plan_handover(planner, replace(request_for(ball), thing="stick"))
    with pytest.raises(ConfigError, match="itself"):
        plan_handover(planner, replace(request_for(ball), taker="left"))
