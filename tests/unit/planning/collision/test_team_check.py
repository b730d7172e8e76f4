"""The check of several arms' paths: the compiled library agrees with Python."""

from itertools import pairwise

import numpy as np
from harness.facing_arms import T_LEFT_RIGHT, Facing

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.apart import ROOM
from so101_motion.planning.collision.team_check import TeamArm, TeamCheck
from so101_motion.planning.paths.compiled_search import (
    CompiledSearch,
    Deadline,
    Seeds,
    Space,
    compiled_shortened,
)


def two_arms(facing, *, spacing=0.01, room=ROOM):
    arms = [
        TeamArm(collision=facing.collision, q_jaw=0.3 * k, bodies=facing.bodies, T_cell_base=T)
        for k, T in enumerate((SE3.identity(), T_LEFT_RIGHT))
    ]
    return TeamCheck(arms, spacing=spacing, room=room)


def crossing_task(facing, team):
    """Where two arms are and want to be, where straight lines would bring them together."""
    while True:
        start, goal = (np.concatenate([facing.near(), facing.near()]) for _ in range(2))
        if team.is_free(start) and team.is_free(goal) and not team.is_clear(start, goal):
            return start, goal


def length(points):
    return np.linalg.norm(np.diff(points, axis=0), axis=1).sum()


def test_the_library_finds_and_shortens_a_path_that_is_clear_for_all_arms():
    facing = Facing(11)
    team, model, reach = two_arms(facing), facing.model, facing.collision.reach
    limits = np.tile(model.lower, 2), np.tile(model.upper, 2)
    space = Space(lower=limits[0], upper=limits[1], weights=np.tile(reach, 2))
    kept = two_arms(facing, spacing=1.0, room=0.7 * ROOM)  # a proof leaves seven eighths
    for _ in range(2):
        start, goal = crossing_task(facing, team)
        seeds, deadline = Seeds(0), Deadline(60.0)
        found = CompiledSearch(space, team.compiled(), start, [goal], seeds).run(deadline)
        points = compiled_shortened(found[0], team.compiled(), seeds, deadline)
        for each in (found[0], points):
            np.testing.assert_array_equal(each[0], start)
            np.testing.assert_array_equal(each[-1], goal)
            assert all(team.is_free(q) for q in each)
            assert all(kept.is_clear(*line) for line in pairwise(each))
        assert length(points) <= length(found[0])
