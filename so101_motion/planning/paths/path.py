"""Find a collision-free joint path from a start to one of several goals.

How it works. Most paths are straight: of random pairs of free configurations in an empty scene,
only one in two hundred is not. So the straight joint line to each goal is tried first, nearest goal
first. Only then a path is searched and shortened (``compiled_search.py``). Both check
samples and prove nothing, because they discard most of what they try. The final path is proven,
edge by edge (``collision.py``). Shortening keeps a little more than the margins, otherwise
its paths would graze them and often fail the proof. An edge that still fails is replaced by a
search between its ends in which every edge is proven.

With ``Routing`` more routes are searched, and the quickest is taken (``routes.py``).

The same request with the same seed gives the same path; only giving up depends on time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from so101_motion.common.errors import NoPath
from so101_motion.common.geometry import Array, freeze
from so101_motion.planning.collision.batch_check import LineCheck
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import FLOOR, LINKS
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.paths.compiled_search import (
    CompiledSearch,
    Deadline,
    Seeds,
    Space,
    Tree,
    compiled_shortened,
)
from so101_motion.planning.paths.infeasibility import Closed, Infeasibility
from so101_motion.planning.paths.routes import Route, Routing, quickest
from so101_motion.planning.timing.path_geometry import JointPath

SPACING = 0.025
"""Travel between two samples [m]. Chosen: one in ten paths around a shelf then needs an edge
replaced, and half the spacing costs a tenth more time."""

ROOM = 0.001  # extra margin of shortened paths [m]; chosen: without it a third fail

NEARBY, TRIES_NEARBY = 0.3, 30
"""A path around an edge that fails its proof is first searched within the first of it [rad], in at
most the second number of rounds. Chosen: it fails by tenths of a millimetre, and two or three tries
are enough."""

CONFINED, ENCLOSED = 0.25, 0.5
"""A tree that in the end spans less than the first share of the joints' range counts as shut in; so
does all that can be reached from an end, if it spans less than the second."""

_REASONS = {
    "goal": (
        ("the goal is free but shut in", ": nothing leads up to it"),
        "choose another approach",
    ),
    "start": (
        ("the start is free but shut in", ": nothing leads away from it"),
        "clear its surroundings",
    ),
    "path": (
        ("start and goal are free, the path between them is blocked", ""),
        "move in smaller steps",
    ),
}
"""What is wrong, in two parts between which the bodies are named, and what to do about it."""

MOST_NAMED = 4  # most bodies that a message names
PROBES, NAMED = 30, 50  # most further rounds to find what blocked, and most contacts counted

ROUNDS = (500, 1000, 2000, 4000)
"""After so many rounds of a search, enough for nearly all paths, and again after so many more, it
is examined whether there is a path at all. Chosen by bench_plan and bench_no_path."""

LOOKS = (20_000, 60_000, 250_000, 600_000)  # configurations checked for that, from each end
BRIEF = 0.1  # of shorter searches [s] the failure is not examined; chosen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FreePath:
    """A polyline in joint space, proven free of contact."""

    waypoints: Array  # from start to goal, shape (m, 5), m >= 2, [rad]
    goal: int  # which of the goals it leads to, as an index
    # a quicker motion of the same kind, over time [s]; it leaves these lines, is proven nowhere,
    # and its jerk has no bound
    motion: JointPath | None = None
    routes: int = 0  # how many routes were compared
    out_of_time: bool = False  # whether the time budget ended the comparison

    def __post_init__(self) -> None:
        freeze(self, waypoints=(-1, 5))


class PathFinder:
    """Finds free paths for one arm, one jaw opening and one set of surroundings."""

    def __init__(
        self, model: RobotModel, collision: CollisionModel, *, q_jaw: float = 0.0, seed: int = 0
    ) -> None:
        self._collision, self._q_jaw = collision, q_jaw
        self._space = Space(lower=model.lower, upper=model.upper, weights=collision.reach)
        self._seeds = Seeds(seed)

    def find(
        self,
        q_start: Array,
        goals: Iterable[Array],
        time_budget: float,
        routing: Callable[[], Routing] | None = None,
    ) -> FreePath:
        """A free path to one of the goals, straight if there is such.

        Start and goals (5,) [rad] are free and inside the limits, the nearest goal first; goals are
        taken one by one, so the later ones may be computed only if needed. A path found within
        ``time_budget`` [s] is not shortened any further then. ``routing`` compares routes that are
        not straight.

        Raises:
            NoPath: None was found in time. The message names an end that is shut in and the bodies
                around it, unless there was less time than ``BRIEF``.
        """
        blocked = []
        for index, goal in enumerate(goals):
            if self.is_free_line(q_start, goal):
                return FreePath(waypoints=np.array([q_start, goal]), goal=index)
            blocked.append(goal)
        return self._around(q_start, blocked, Deadline(time_budget), routing)

    def is_free_line(self, q_from: Array, q_to: Array) -> bool:
        """Whether the straight joint line from ``q_from`` to ``q_to`` is free, ends included."""
        return self._is_free([q_from, q_to])

    def _is_free(self, points: list[Array]) -> bool:
        return self._collision.first_blocked(np.array(points), self._q_jaw) is None

    def _around(
        self,
        q_start: Array,
        goals: Sequence[Array],
        deadline: Deadline,
        routing: Callable[[], Routing] | None,
    ) -> FreePath:
        """A path that is not straight."""
        random = self._seeds.again()
        look = self._collision.sampled_check(self._q_jaw, spacing=SPACING)
        points, goal = self._searched(look, q_start, goals, random, deadline)
        wide = self._collision.sampled_check(self._q_jaw, spacing=SPACING, extra=ROOM)
        points = compiled_shortened(points, wide, random, deadline)
        proven = self._proven(points, random, deadline)
        if routing is None:
            return FreePath(waypoints=proven, goal=goal)
        how = routing()
        first = Route(points, goal, how, wide, self._space, random.next())
        best, routes, out_of_time = quickest(
            first, q_start, goals, how, self._space, (look, wide), random, deadline
        )
        if best is not first:
            try:
                proven = self._proven(best.points, random, deadline)
            except NoPath:  # the time is up
                best = first
        return FreePath(
            waypoints=proven,
            goal=best.goal,
            motion=best.motion(),
            routes=routes,
            out_of_time=out_of_time,
        )

    def _proven(self, points: list[Array], random: Seeds, deadline: Deadline) -> Array:
        is_free = self._is_free(points)
        return np.array(points if is_free else self._mended(points, random, deadline))

    def _mended(self, points: list[Array], random: Seeds, deadline: Deadline) -> list[Array]:
        """The path with detours in place of the edges that fail their proof."""
        # A corner on an edge that was only checked at samples may be too close itself.
        ends, inner = (points[0], points[-1]), points[1:-1]
        inner = [q for q in inner if self._collision.is_free(q, self._q_jaw)]
        proven = [points[0]]
        for a, b in pairwise([ends[0], *inner, ends[1]]):
            if self.is_free_line(a, b):
                proven.append(b)
            else:
                proven += self._detour(a, b, random, deadline)[1:]
        return proven

    def _detour(self, a: Array, b: Array, random: Seeds, deadline: Deadline) -> list[Array]:
        """Waypoints between two configurations near each other, every edge proven."""
        checker = self._collision.sampled_check(self._q_jaw, spacing=SPACING).proven()
        nearby = CompiledSearch(self._space.around(a, b, NEARBY), checker, a, [b], random)
        found = nearby.run(deadline, TRIES_NEARBY) or self._searched(
            checker, a, [b], random, deadline
        )
        return compiled_shortened(found[0], checker, random, deadline, only_skip=True)

    def _searched(
        self,
        checker: LineCheck,
        q_start: Array,
        goals: Sequence[Array],
        random: Seeds,
        deadline: Deadline,
    ) -> tuple[list[Array], int]:
        search = CompiledSearch(self._space, checker, q_start, goals, random)
        found = None
        if deadline.budget >= BRIEF and not checker.arms[0].proven:
            found = self._unless_closed(search, q_start, goals, deadline)
        found = found or search.run(deadline)
        if found is None:
            raise self._no_path(search, deadline)
        return found

    def _unless_closed(
        self, search: CompiledSearch, q_start: Array, goals: Sequence[Array], deadline: Deadline
    ) -> tuple[list[Array], int] | None:
        """What the search finds early; raises ``NoPath`` if it is shown that there is nothing."""
        ends: Infeasibility | None = None
        for rounds, looks in zip(ROUNDS, LOOKS, strict=True):
            found = search.run(deadline, rounds)
            if found is not None or deadline.has_passed():
                return found
            ends = ends or Infeasibility(self._space, self._collision, self._q_jaw, q_start, goals)
            closed = ends.look(deadline, looks, NAMED)
            if closed is not None:
                raise self._closed(closed)
        return None

    def _no_path(self, search: CompiledSearch, deadline: Deadline) -> NoPath:
        if deadline.budget < BRIEF:
            message = f"no path found in {max(deadline.budget, 0.0):.3f} s; allow more time"
            return NoPath(message, where="path", blockers=())
        trees = search.trees()
        counts = [len(tree.points) for tree in trees]
        blockers = [self._blockers(tree) for tree in trees]
        shut_in = [tree.spread() < CONFINED for tree in trees]
        if shut_in[0] == shut_in[1]:
            where, by = "path", blockers[0] + blockers[1]
        else:
            where, by = ("start", "goal")[shut_in[1]], blockers[shut_in[1]]
        says, advice = _REASONS[where]
        names = tuple(name for name, _ in by.most_common())
        mostly = f", mostly by {self._collision.scene.called(names[0])}" if names else ""
        return NoPath(
            f"no path found in {deadline.budget:.1f} s ({counts[0]} configurations reached from the"
            f" start, {counts[1]} from the goal): {mostly.join(says)}; {advice}, or allow more"
            " time",
            where=where,
            blockers=names,
        )

    def _closed(self, closed: Closed) -> NoPath:
        """The error where all that can be reached from an end was looked at."""
        by = Counter(self._collision.clearance(q, self._q_jaw).second for q in closed.rim)
        order = sorted(by, key=lambda name: (name in LINKS, name == FLOOR, -by[name]))
        things = [name for name in order if name not in LINKS]
        names = tuple(things or order)
        where, range_ = "path", self._space.upper - self._space.lower
        if (np.ptp(closed.rim, axis=0) < ENCLOSED * range_).all():
            where = "start" if closed.at_start else "goal"
        says, advice = _REASONS[where]
        called = [self._collision.scene.called(name) for name in names[:MOST_NAMED]]
        by_all = " and ".join(filter(None, (", ".join(called[:-1]), called[-1])))
        advice = "choose another goal" if where == "path" else advice
        clear = ", or clear the way" if things and things != [FLOOR] else ""
        return NoPath(
            f"there is no path: {f' by {by_all}'.join(says)}; {advice}{clear}",
            where=where,
            blockers=names,
        )

    def _blockers(self, tree: Tree) -> Counter[str]:
        """Count the bodies that block further growth of a tree."""
        met: Counter[str] = Counter()
        look = self._collision.sampled_check(self._q_jaw, spacing=SPACING)
        for _ in range(PROBES):
            for branch in tree.probe(look):
                if met.total() == NAMED:
                    break
                blocked = self._collision.first_blocked(branch, self._q_jaw)
                if blocked is not None:
                    met[self._collision.clearance(blocked, self._q_jaw).second] += 1
        return met
