"""Plans for several arms at once: they begin and end together and keep apart all the way."""

import time
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from harness.coal_check import CoalJudge
from harness.facing_arms import T_LEFT_RIGHT, Facing, distance

from so101_motion.common.errors import ConfigError, InCollision, NoPath, Overloaded, Unreachable
from so101_motion.common.geometry import SE3, rot_z, rotation_angle, rotation_by
from so101_motion.planning.cell import together
from so101_motion.planning.cell.handover import JawGeometry, plan_handover
from so101_motion.planning.cell.meetings import grasps_of
from so101_motion.planning.cell.team_requests import HandoverRequest, TeamMember
from so101_motion.planning.cell.together import plan_together
from so101_motion.planning.collision import apart
from so101_motion.planning.collision.apart import ROOM, clearance_over_time, first_meeting
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.course import STEP, Course, OtherArm, stopping
from so101_motion.planning.collision.following_apart import GAP, RANGE, Beside, following_apart
from so101_motion.planning.collision.scene import Attached, Box, Scene, Sphere, StandingArm
from so101_motion.planning.goals import JointGoal, PoseGoal
from so101_motion.planning.paths import compiled_search
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point
from so101_motion.planning.timing.torque import Strength

CAPS = MotionLimits.uniform(velocity=1.5, acceleration=6.0, jerk=60.0)
PLACES = (SE3.identity(), T_LEFT_RIGHT)


@pytest.fixture(autouse=True)
def budgets_are_processor_time(monkeypatch):
    """What is found in time does not depend on what else the machine does."""
    for module in (together, compiled_search):
        clock = SimpleNamespace(monotonic=time.thread_time, perf_counter=time.thread_time)
        monkeypatch.setattr(module, "time", clock)


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


def in_a_circle(count, radius):
    angles = 2.0 * np.pi * np.arange(count) / count
    return [
        SE3(rot_z(angle), -radius * np.array([np.cos(angle), np.sin(angle), 0.0]))
        for angle in angles
    ]


def test_three_arms_at_each_others_goals_fold_first_which_is_quicker_than_one_path_for_all(planner):
    starts, goals = [[0.6, 0.0, 0.0, 0.3, 0.0]] * 3, [[-0.6, 0.0, 0.0, 0.3, 0.0]] * 3
    team = team_of(starts, [JointGoal(q=q) for q in goals], in_a_circle(3, 0.3))
    plans = plan_together(planner, team)
    assert_together(team, plans, goals)
    assert plans["arm 0"].duration < 3.5  # 2.9; one path for all takes 4.1


SIX_STARTS = [
    [0.7, -1.1, -0.4, -1.6, -1.3],
    [-0.3, -1.4, 0.4, -0.4, 1.3],
    [-0.6, 0.2, -1.0, 1.6, -1.4],
    [-0.9, -1.5, -0.8, 0.9, 1.2],
    [-0.5, -1.4, -1.0, -0.7, -1.0],
    [-1.6, 0.0, -1.0, -1.2, 0.1],
]
SIX_GOALS = [
    [-0.8, -0.8, -0.9, 1.6, -1.0],
    [0.8, 1.0, -1.1, -1.5, -0.3],
    [1.8, 0.6, -0.2, 0.2, 2.0],
    [0.7, -1.3, -1.0, 1.3, 0.4],
    [0.3, -1.2, -1.2, -0.9, -0.9],
    [0.2, -0.4, 0.5, -0.2, 0.1],
]


def test_six_arms_leave_places_before_others_come_there(planner):
    team = team_of(SIX_STARTS, [JointGoal(q=q) for q in SIX_GOALS], in_a_circle(6, 0.35))
    plans = plan_together(planner, team)
    assert_together(team, plans, SIX_GOALS)
    assert plans["arm 0"].duration < 3.2  # 2.7; in none of six rotated orders could all go


def test_three_arms_are_not_special(planner):
    places = in_a_circle(3, 0.3)
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


def test_an_arm_too_near_to_a_moving_one_leaves_and_never_comes_nearer(planner):
    facing = Facing(14)
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
        apart.nearness(*pair, T_LEFT_RIGHT, at=t, room=ROOM) or ROOM
        for t in np.arange(0.0, max(own.end, course.end) + 0.02, 0.02)
    ]
    assert min(gaps) > gaps[0] - 2.0 * apart.PARTING
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


# Handovers of random poses, checked by other means


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


def test_a_stick_in_a_random_pose_is_passed_on_without_contact(planner):
    random, model = np.random.default_rng(0), Facing(0).model
    jaw = JawGeometry(model)
    for _ in range(2):
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


# Whether two arms that move at the same time keep apart, by coal at single instants


FURTHER = SE3(T_LEFT_RIGHT.R, np.array([0.47, 0.0, 0.0]))


def random_courses(facing, t_right=0.0):
    left, right = (point_to_point(facing.near(), facing.near(), CAPS, 0.01) for _ in range(2))
    return Course.along(left, 0.3), Course.along(right, 0.0, t=t_right)


def pair_within(facing, low, high):
    """Configurations of both that are so far apart, and how far."""
    while True:
        pair = facing.near(), facing.near()
        far = distance(facing.bodies, *(np.append(q, 0.0) for q in pair))
        if low < far < high:
            return *pair, far


def test_compiled_distances_are_those_of_coal_at_least_and_about():
    random, bodies, count, enough = np.random.default_rng(3), bodies_of(), 40, 0.3
    q = [random.uniform(-0.8, 0.8, (count, 6)) for _ in range(2)]
    found = apart.distances(bodies, bodies, T_LEFT_RIGHT, *q, need=apart.ROOM, enough=enough)
    pair = [(bodies, Course(t=0.0, dt=1.0, q=each)) for each in q]
    true = np.array([*apart.gaps(*pair, T_LEFT_RIGHT, np.arange(float(count)))])
    moved = np.isfinite(true)
    np.testing.assert_array_equal(np.isfinite(found), moved)
    found, true = found[moved], true[moved]
    assert np.any(true < 0.0)
    assert np.all(found <= np.maximum(true, 0.0) + 1e-5)
    near = (true > 0.0) & (true < enough)
    assert np.all(found[near] > true[near] - 2e-4 - 0.12 * np.maximum(true[near] - apart.ROOM, 0.0))


def test_an_arm_that_follows_a_target_may_part_from_one_that_is_near():
    facing, verdicts = Facing(6), []
    while len(verdicts) < 12:
        q_left, q_right, far = pair_within(facing, 0.003, 0.009)
        stop = q_left + np.outer(np.linspace(0.0, 0.1, 8), facing.random.uniform(-1.0, 1.0, 5))
        following = Course(t=0.0, dt=0.02, q=np.column_stack([stop, np.zeros(8)]))
        still = Course.resting(q_right, 0.0)
        beside = Beside()
        pair = (facing.bodies, following), (facing.bodies, still)
        met = following_apart(*pair, T_LEFT_RIGHT, since=0.0, beside=beside)
        again = following_apart(*pair, T_LEFT_RIGHT, since=0.0, beside=beside)
        assert (met is None) == (again is None)
        assert beside.gained == (0.0 if met else pytest.approx(far - apart.PARTING, abs=2e-4))
        if met is None:
            nearest = [distance(facing.bodies, q, still.q[0]) for q in following.q]
            assert min(nearest) > 0.75 * (far - apart.PARTING)
        verdicts.append(met is None)
    assert set(verdicts) == {True, False}


@pytest.mark.parametrize("who", ["following", "other"])
def test_an_arm_that_is_near_and_comes_nearer_in_between_does_not_part(who):
    facing = Facing(9)
    bodies = facing.bodies
    share = np.sin(3.0 * np.pi * np.linspace(0.0, 1.0, 31)) ** 2  # three times there and back
    while True:
        q_left, q_right, far = pair_within(facing, 0.006, 0.009)
        away = facing.random.uniform(-0.05, 0.05, 5)
        q = (q_left, q_right)[who == "other"] + np.outer(share, away)
        moving = Course(t=0.0, dt=0.01, q=np.column_stack([q, np.zeros(31)]))
        course = {"following": Course.resting(q_left, 0.0), "other": Course.resting(q_right, 0.0)}
        course[who] = moving
        k = np.array([0.05])
        near = distance(bodies, *(each.at(k)[0] for each in course.values()))
        if 0.001 < near < far - 0.002:
            break
    beside = Beside()
    beside.gained = far - 1e-4
    pair = (bodies, course["following"]), (bodies, course["other"])
    assert following_apart(*pair, T_LEFT_RIGHT, since=0.0, beside=beside) is not None


def test_an_arm_that_follows_a_target_and_is_pushed_towards_another_may_only_part():
    facing = Facing(8)
    beside = Beside()
    beside.gained = 0.009
    *pair, far = pair_within(facing, 0.003, 0.005)
    still = [(facing.bodies, Course.resting(q, 0.0)) for q in pair]
    assert following_apart(*still, T_LEFT_RIGHT, since=0.0, beside=beside) is None
    assert beside.gained == pytest.approx(far - apart.PARTING, abs=2e-4)


def stop_from(q, qd):
    """A stop from a velocity, within 0.3 s."""
    passed = np.linspace(0.0, 0.3, 16)
    path = q + np.outer(passed - passed**2 / 0.6, qd)
    return Course(t=0.0, dt=0.02, q=np.column_stack([path, np.zeros(16)]))


def test_what_is_known_from_the_cycle_before_changes_no_verdict():
    facing, verdicts = Facing(12), []
    for _ in range(3):
        beside, known = Beside(), [facing.near(), facing.near()]
        qd = facing.random.uniform(-1.0, 1.0, (2, 5))
        for _ in range(60):
            known = [q + 0.01 * v for q, v in zip(known, qd, strict=True)]
            pair = [(facing.bodies, stop_from(q, v)) for q, v in zip(known, qd, strict=True)]
            fresh = Beside()
            fresh.gained = beside.gained
            met = following_apart(*pair, T_LEFT_RIGHT, since=0.0, beside=beside)
            same = following_apart(*pair, T_LEFT_RIGHT, since=0.0, beside=fresh)
            assert (met is None) == (same is None)
            assert beside.gained == pytest.approx(fresh.gained, abs=2e-4)
            verdicts.append(met is None)
    assert 0.1 < np.mean(verdicts) < 0.9


def test_it_is_known_what_is_near_of_another_arm_and_which_joints_bring_it_nearer():
    facing, seen = Facing(13), 0
    steps = 1e-4 * np.vstack([np.zeros(5), np.eye(5)])
    while seen < 30:
        q_left, q_right = facing.near(), facing.near()
        still = Course.resting(q_right, 0.0)
        pair = (facing.bodies, Course.resting(q_left, 0.0)), (facing.bodies, still)
        beside = Beside()
        following_apart(*pair, T_LEFT_RIGHT, since=0.0, beside=beside)
        if not beside.count:
            continue
        near = beside.near("right")
        moved = Course(t=0.0, dt=1.0, q=np.column_stack([q_left + steps, np.zeros(6)]))
        paths = (facing.bodies, moved), (facing.bodies, still)
        gaps = np.array([*apart.gaps(*paths, T_LEFT_RIGHT, np.arange(6.0))])
        own, other = np.nonzero(gaps[0, :-1] < apart.GUARDED + RANGE)  # the base goes nowhere
        if gaps[0].min() < 1e-3:
            continue
        assert len(near.bounds) == len(own)
        for k, (i, j) in enumerate(zip(own, other, strict=True)):
            names = facing.bodies.names[i], facing.bodies.names[j]
            assert near.words(k) == f"the {names[0]} close to right's {names[1]}"
            room, rates = gaps[0, i, j] - apart.GUARDED, (gaps[1:, i, j] - gaps[0, i, j]) / 1e-4
            assert near.bounds[k, 6] == pytest.approx(room, abs=2e-4)
            assert near.bounds[k, 5] == pytest.approx(max(min(0.0, GAP - room), -room), abs=4e-4)
            assert near.bounds[k, :5] == pytest.approx(rates, abs=0.02)
        seen += 1


@pytest.mark.parametrize("periods", [1.0, 2.0, 4.0, 8.0])
def test_arms_that_swing_to_and_fro_meet_although_they_are_apart_at_the_ends(periods):
    facing = Facing(6)
    met, times = 0, np.linspace(0.0, 16.0 * STEP, 17)
    for _ in range(150):
        courses = []
        for _ in range(2):
            swing = np.append(facing.random.normal(0.0, 0.2, 5), 0.0)
            share = 0.5 - 0.5 * np.cos(2.0 * np.pi * times / (periods * 2.0 * STEP))
            q = np.append(facing.near(), 0.2) + share[:, None] * swing
            courses.append(Course(t=0.0, dt=STEP, q=q))
        pair = (facing.bodies, courses[0]), (facing.bodies, courses[1])
        if apart.first_meeting(*pair, T_LEFT_RIGHT, since=0.0, room=0.01, early=0.0) is not None:
            met += 1
            continue
        between = np.linspace(0.0, courses[0].end, 129)
        q_left, q_right = (np.ascontiguousarray(course.at(between)) for course in courses)
        found = apart.distances(
            facing.bodies, facing.bodies, T_LEFT_RIGHT, q_left, q_right, need=0.01, enough=0.02
        )
        assert found.min() > 0.875 * 0.01 - 2e-4
    assert 20 < met < 130


def test_fast_arms_must_stay_further_apart_than_slow_ones():
    facing = Facing(5)
    changed = 0
    for _ in range(40):
        left, right = random_courses(facing)
        pair = (facing.bodies, left), (facing.bodies, right)
        met = [
            apart.first_meeting(*pair, FURTHER, since=0.0, early=early) is not None
            for early in (0.0, 0.05)
        ]
        assert met != [True, False]
        changed += met == [False, True]
    assert changed


def test_a_stop_stays_on_the_path_and_ends_at_rest():
    facing = Facing(2)
    course, _ = random_courses(facing)
    stop = stopping(course, 0.3)
    assert stop.q[0] == pytest.approx(course.at(np.array([0.3]))[0])
    dense = course.at(np.linspace(0.3, course.end, 2000))
    for q in stop.q:
        assert np.abs(dense - q).max(axis=1).min() < 2e-3
    assert np.abs(np.diff(stop.q, axis=0)[-1]).max() < np.abs(np.diff(stop.q, axis=0)[0]).max()


def test_stops_at_any_instant_are_judged_as_each_by_itself():
    facing = Facing(5)
    verdicts = []
    for _ in range(30):
        pair = tuple((facing.bodies, course) for course in random_courses(facing))
        how = {"room": 0.015, "early": 0.01}
        end = min(course.end for _, course in pair)
        begin = max(course.t for _, course in pair)
        each = (
            apart.first_meeting(
                *((bodies, stopping(course, t)) for bodies, course in pair),
                FURTHER,
                since=float(t),
                **how,
            )
            for t in np.arange(begin, end, 0.1)
        )
        met = next((found for found in each if found is not None), None)
        found = apart.stops_meeting(*pair, FURTHER, since=0.0, every=0.1, **how)
        assert (found is None) == (met is None)
        if met is not None:
            assert found.t == pytest.approx(met.t, abs=0.02)
            assert (found.first, found.second) == (met.first, met.second)
        verdicts.append(found is None)
    assert set(verdicts) == {True, False}
