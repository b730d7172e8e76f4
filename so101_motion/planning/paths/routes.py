"""Find several routes around what is in the way, and the quickest motion along any of them.

The first path that a search finds may be twice as long as need be. So there are more searches, some
only near the straight line, with other random choices. Each path becomes a motion that is cut short
in time a little (``native/cuts.c``); the two quickest are cut short further. All work is counted,
so the same request gives the same motion on every machine.
"""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.batch_check import LineCheck, pointer
from so101_motion.planning.paths.compiled_search import (
    CompiledSearch,
    Deadline,
    Seeds,
    Space,
    compiled_shortened,
)
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.path_geometry import JointPath
from so101_motion.planning.timing.retime import averaging

FIRST_CUTS, MORE_CUTS = 75, 60
"""Cuts that are tried on each route, and further ones, for each route, on each of the two quickest
and on the winner twice as many. Chosen: more searches gain more than more cuts."""

FINALISTS = 2

BEYOND = (0.6, 1.2, np.inf, 0.3)
"""How far beyond start and goal the searches go, in turn, each until it fails [rad]. Chosen: with
the third alone routes through a slot are a sixth slower at the 95th percentile, with the first and
the last alone those around a shelf."""

MOST_ROUNDS = 200  # of a search; chosen: half as many find fewer routes into a shelf
SEARCHING = 0.8  # share of the time for searches; chosen: the rest is for cuts
DIRECT = 1.01  # times the joints' least time: not improved


class Routing(NamedTuple):
    """How routes are compared."""

    effort: int  # how many are searched, 1 or more
    velocity: Array  # caps of the joints, shape (5,), [rad/s]
    acceleration: Array  # the same, [rad/s^2]
    window: float  # time over which the motion is averaged later [s]

    @classmethod
    def within(cls, limits: MotionLimits, effort: int) -> Routing:
        """Compare under these limits, without the cap on the tool's speed."""
        window, share = averaging(limits)
        return cls(effort, limits.velocity, share * limits.acceleration, window)

    def least(self, q_start: Array, goals: Sequence[Array]) -> float:
        """A bound on the time to any of the goals, without jerk [s]."""
        far, fastest, hardest = np.abs(goals - q_start), self.velocity, self.acceleration
        cruise = far / fastest + fastest / hardest
        times = np.where(far * hardest > fastest**2, cruise, 2.0 * np.sqrt(far / hardest))
        return float(times.max(axis=1).min())


class Route:
    """A path to the goal of that index, and a motion along it, which may be cut short in time."""

    def __init__(
        self,
        points: list[Array],
        goal: int,
        routing: Routing,
        checker: LineCheck,
        space: Space,
        seed: ctypes.c_uint64,
    ) -> None:
        self.points, self.goal = points, goal
        self._check, self._library = checker, checker.library
        limits = (routing.velocity, routing.acceleration, space.lower, space.upper)
        given, packed = np.array(points), np.concatenate(limits, dtype=np.float64)
        handle = self._library.so101_motion_new(
            pointer(given), len(given), pointer(packed), ctypes.c_double(routing.window), seed
        )
        self._motion = ctypes.c_void_p(handle)
        if not handle:
            raise MemoryError("no memory for a motion")

    def __del__(self) -> None:
        self._library.so101_motion_free(self._motion)

    def cut(self, tries: int, deadline: Deadline) -> float:
        """Try some cuts; the duration after them [s]."""
        with self._check.until(deadline.has_passed):
            return float(self._library.so101_motion_cut(self._check.team, self._motion, tries))

    def motion(self) -> JointPath:
        """The motion as it is now, over time [s]."""
        library, motion = self._library, self._motion
        pieces = library.so101_motion_pieces(motion, None, None)
        t, coefficients = np.empty(pieces + 1), np.zeros((pieces, 4, 5))
        library.so101_motion_pieces(motion, pointer(t), pointer(coefficients))
        return JointPath(knots=t, coefficients=coefficients)


def quickest(
    first: Route,
    q_start: Array,
    goals: Sequence[Array],
    routing: Routing,
    space: Space,
    checks: tuple[LineCheck, LineCheck],
    random: Seeds,
    deadline: Deadline,
) -> tuple[Route, int, bool]:
    """The quickest route, how many were compared, and whether the time was up before all were.

    If the first route is direct no others are searched. ``checks`` are for contact during a search,
    and for a path that is shortened.
    """
    look, wide = checks
    best, compared = [(first.cut(FIRST_CUTS, deadline), 0, first)], 1
    if best[0][0] <= DIRECT * routing.least(q_start, goals):
        return first, compared, False
    ends = np.array([q_start, *goals])
    low, high, turns = ends.min(axis=0), ends.max(axis=0), deque(BEYOND)
    searched, enough = 1, deadline.earlier(SEARCHING)
    while searched < routing.effort and not enough.has_passed():
        part = space.around(low, high, turns[0])
        path = CompiledSearch(part, look, q_start, goals, random).run(enough, MOST_ROUNDS)
        searched += 1
        if path is None:
            if len(turns) > 1:
                turns.popleft()
            continue
        turns.rotate(-1)
        points = compiled_shortened(path[0], wide, random, deadline)
        route = Route(points, path[1], routing, wide, space, random.next())
        best = sorted([*best, (route.cut(FIRST_CUTS, deadline), searched, route)])[:FINALISTS]
        compared += 1
    tries = MORE_CUTS * searched
    _, _, winner = min((route.cut(tries, deadline), k, route) for _, k, route in best)
    winner.cut(FINALISTS * tries, deadline)
    return winner, compared, searched < routing.effort or deadline.has_passed()
