"""Paths of two arms that keep apart whenever each of them moves, checked against pairs of
points."""

import numpy as np
import pytest
from harness.facing_arms import T_LEFT_RIGHT, Facing

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.apart import are_apart, first_meeting
from so101_motion.planning.collision.apart_at_any_timing import SPACING, evenly, never_meet
from so101_motion.planning.collision.course import Course


def away(x):
    return SE3(T_LEFT_RIGHT.R, np.array([x, 0.0, 0.0]))


def some_path(facing):
    """From one place to another and back, and the jaw opened at the end, [rad]."""
    q, to = facing.near(), facing.near()
    return np.array([[*q, 0.0], [*to, 0.0], [*q, 0.0], [*q, 1.0]])


def test_paths_are_cut_evenly_and_keep_their_ends():
    facing = Facing(2)
    q = some_path(facing)
    cut = evenly(facing.bodies, q)
    assert facing.bodies.travel(cut).max() <= SPACING + 1e-9
    assert cut[[0, -1]] == pytest.approx(q[[0, -1]])
    assert evenly(facing.bodies, q[:1]) == pytest.approx(q[:1])


def test_what_is_proven_keeps_its_room_wherever_both_are():
    facing, verdicts = Facing(4), set()
    for x in (0.45, 0.75) * 2:
        ways = [evenly(facing.bodies, some_path(facing)) for _ in range(2)]
        proven = never_meet(facing.bodies, facing.bodies, away(x), *ways)
        looked = [np.ascontiguousarray(way[:: max(1, len(way) // 12)]) for way in ways]
        seen = all(
            are_apart(
                facing.bodies, facing.bodies, away(x),
                np.ascontiguousarray(one[None]), np.ascontiguousarray(other[None]), room=0.015,
            )
            for one in looked[0]
            for other in looked[1]
        )  # fmt: skip
        assert seen or not proven
        verdicts.add(proven)
    assert verdicts == {True, False}


def test_arms_that_only_their_timing_keeps_apart_may_meet():
    """Both reach over the same place, one after the other."""
    facing = Facing(1)
    folded, over = np.radians([0.0, -92.0, 78.0, 60.0, 0.0, 0.0]), np.zeros(6)
    there_and_back = Course(t=0.0, dt=1.0, q=np.array([folded, over, folded, folded, folded]))
    later = Course(t=2.0, dt=1.0, q=there_and_back.q)
    pair = (facing.bodies, there_and_back), (facing.bodies, later)
    assert first_meeting(*pair, away(0.6), since=0.0) is None
    ways = [evenly(facing.bodies, course.q) for _, course in pair]
    assert not never_meet(facing.bodies, facing.bodies, away(0.6), *ways)
    assert never_meet(facing.bodies, facing.bodies, away(1.2), *ways)
