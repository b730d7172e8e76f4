"""Whether two arms that move at the same time keep apart, checked against coal at single
instants."""

import math
from dataclasses import replace

import coal
import numpy as np
import pytest
from harness.facing_arms import T_LEFT_RIGHT, Facing, distance

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision import apart
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.course import STEP, Course, stopping
from so101_motion.planning.collision.following_apart import GAP, RANGE, Beside, following_apart
from so101_motion.planning.collision.scene import Attached, Box
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point

_PART = 0.25  # as in apart.c


def meet_by_coal(a, b, T, qa, qb, room, early):
    """The first time at which two arms come too near, by coal; ``early`` is in steps.

    A judge that shares no code with apart.c.
    """
    data = a.model.createData(), b.model.createData()
    travel_a, travel_b, last = a.travel(qa), b.travel(qb), len(qa) - 1
    due = np.zeros((len(a.objects), len(b.objects)))
    request, t = coal.DistanceRequest(), 0.0
    while t <= last:
        k = min(int(t), max(last - 1, 0))
        at = [q[k] + (t - k) * (q[min(k + 1, last)] - q[k]) for q in (qa, qb)]
        place_a = a.placed(at[0], SE3.identity(), data[0])
        place_b = b.placed(at[1], T, data[1])
        for i, j in zip(*np.nonzero(due <= t), strict=True):
            one, other = a.objects[i], b.objects[j]
            due[i, j] = math.inf
            if one.joint == other.joint == 0:
                continue
            speeds = np.column_stack((travel_a[k:, i], travel_b[k:, j]))
            need = room + (early * float(speeds[0].min()) if last else 0.0)
            gap = coal.distance(
                one.shape, place_a[i], other.shape, place_b[j], request, coal.DistanceResult()
            )
            if gap < need:
                return t, gap, int(i), int(j)
            due[i, j] = max(
                until(speeds, t, k, gap - room, early), until(speeds, t, k, _PART * room, 0.0)
            )
        following = float(due.min())
        t = last if t < last < following < math.inf else following
    return None


def until(speeds, t, k, room, early):
    """Like ``until`` in apart.c; ``speeds`` begin at step ``k``, shape (m, 2), [m]."""
    for step, (va, vb) in enumerate(speeds, k):
        left, late = (step + 1 - t) * (va + vb), early * min(va, vb)
        if left + late > room:
            return float(t + (room - late) / (va + vb)) if room > late else t
        room, t = room - left, step + 1.0
    return math.inf


FURTHER = SE3(T_LEFT_RIGHT.R, np.array([0.47, 0.0, 0.0]))
CAPS = MotionLimits.uniform(velocity=1.5, acceleration=6.0, jerk=60.0)


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


def test_arms_at_rest_are_apart_where_coal_says_so():
    facing = Facing(1)
    verdicts = set()
    for _ in range(40):
        q_left, q_right, far = pair_within(facing, -1.0, 1.0)
        if abs(far - 0.02) > 2e-4:
            assert facing.are_apart(q_left, q_right, room=0.02) == (far > 0.02)
            verdicts.add(far > 0.02)
    assert verdicts == {True, False}


def test_the_clearance_over_time_is_that_of_the_nearest_bodies():
    left, right = random_courses(Facing(3))
    bodies, times = Facing(3).bodies, np.linspace(0.0, left.end, 5)
    pair = (bodies, left), (bodies, right)
    for met, t in zip(apart.clearance_over_time(*pair, T_LEFT_RIGHT, times), times, strict=True):
        far = distance(bodies, left.at(np.array([t]))[0], right.at(np.array([t]))[0])
        assert met.t == t
        assert met.distance == pytest.approx(far)
        assert {met.first, met.second} <= set(bodies.names)


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
    for _ in range(12):
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


def test_a_look_without_a_proof_finds_the_same_near_bodies_also_after_contact():
    facing, rooms, parted = Facing(14), [], 0
    for _ in range(6):
        looking, proving = Beside(), Beside()
        looking.gained = 0.009
        q, qd = [facing.near(), facing.near()], facing.random.uniform(-1.0, 1.0, (2, 5))
        for _ in range(60):
            q = [each + 0.02 * v for each, v in zip(q, qd, strict=True)]
            pair = [(facing.bodies, stop_from(each, v)) for each, v in zip(q, qd, strict=True)]
            looking.look(*pair, T_LEFT_RIGHT, 0.0)
            following_apart(*pair, T_LEFT_RIGHT, since=0.0, beside=proving)
            rooms.append(distance(facing.bodies, *(course.q[0] for _, course in pair)))
            if rooms[-1] > 1e-4:
                each = [beside.near("right").bounds[:, 6] for beside in (looking, proving)]
                assert np.sort(each[0]) == pytest.approx(np.sort(each[1]), abs=2e-4)
                parted += len(rooms) > 1 and rooms[-2] <= 1e-4
        assert looking.gained == 0.009
    assert parted
    assert min(rooms) < -0.02


def test_what_is_proven_keeps_its_room_at_every_instant():
    facing = Facing(2)
    proven = 0
    for _ in range(60):
        left, right = random_courses(facing, t_right=0.3)
        pair = (facing.bodies, left), (facing.bodies, right)
        met = apart.first_meeting(*pair, FURTHER, since=0.0, room=0.02, early=0.0)
        if met is not None:
            times = np.array([met.t])
            near = distance(facing.bodies, left.at(times)[0], right.at(times)[0], FURTHER)
            assert near < met.distance + 2e-4  # of all pairs of bodies the nearest
            continue
        proven += 1
        times = np.linspace(0.0, max(left.end, right.end), 15)
        for q_left, q_right in zip(left.at(times), right.at(times), strict=True):
            assert distance(facing.bodies, q_left, q_right, FURTHER) > 0.75 * 0.02
    assert 5 < proven < 60


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


def test_the_verdict_is_that_of_coal():
    facing = Facing(3)
    verdicts = set()
    for _ in range(10):
        left, right = random_courses(facing)
        times = STEP * np.arange(np.ceil(max(left.end, right.end) / STEP - 1e-9) + 1)
        pair = (facing.bodies, left), (facing.bodies, right)
        found = apart.first_meeting(*pair, FURTHER, since=0.0, early=STEP)
        both = (facing.bodies, facing.bodies), (left.at(times), right.at(times))
        by_coal = meet_by_coal(*both[0], FURTHER, *both[1], apart.ROOM, 1.0)
        assert (found is None) == (by_coal is None)
        verdicts.add(found is None)
    assert verdicts == {True, False}


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


def test_what_an_arm_holds_counts():
    facing = Facing(7)
    held = Attached(
        name="stick",
        shape=Box(size=[0.02, 0.02, 0.3]),
        T_tool_object=SE3.from_translation((0.0, 0.0, 0.15)),
    )
    q = np.zeros(5)
    holding = bodies_of((held,)), Course.resting(q, 0.0)
    met = apart.first_meeting(
        holding, (facing.bodies, Course.resting(q, 0.0)),
        SE3(T_LEFT_RIGHT.R, np.array([0.6, 0.0, 0.0])), since=0.0,
    )  # fmt: skip
    assert met is not None
    assert met.first == "stick"


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


def test_bodies_are_made_once_whichever_arm_they_are_held_against():
    stick = Attached(name="stick", shape=Box(size=[0.02, 0.02, 0.1]), T_tool_object=SE3.identity())
    given = replace(stick, passed_to="right")
    assert bodies_of((stick,), "left") is bodies_of((stick,), "right")
    assert bodies_of((given,), "left") is not bodies_of((given,), "right")
    assert bodies_of((given,), "right").passed == {"stick"}
