"""Straight lines of the tool.

How it works. On a line every point of the tool's way is prescribed; what five joints leave open is
the pitch, and for some goals the roll. Both are laid down for the whole line before anything is
computed along it: kept as they are if that works, otherwise changed steadily towards some final
pitch, the nearest that works, early or late on the way if evenly will not do. So a line that begins
well cannot end in a dead end that a different pitch would have avoided.

The closed form then gives a posture for each of many points of the line, and a smooth curve in
joint space goes through them. It is refined until the tool, in the middle between the points, is
off by less than half the tolerance.

How the arm then moves along that curve is told in ``tool_line.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np

from so101_motion.errors import ConfigError, InCollision, PlanningError, Unreachable
from so101_motion.geometry import Array
from so101_motion.planning import verify
from so101_motion.planning.collision import CollisionModel
from so101_motion.planning.goals import GoalMetric, LineGoal, PoseGoal
from so101_motion.planning.ik import IkSolver
from so101_motion.planning.ik_task import check_goal, limit_name
from so101_motion.planning.path_geometry import JointPath
from so101_motion.planning.tool_line import ToolLine, curve_through
from so101_motion.units import to_mm

SPACING = 0.005
"""First distance between the points of a line that get a posture of their own [m]."""

LOOK = 0.012
"""Distance between the points at which a pitch is tried out [m]. Chosen: ten on a short line."""

CLOSE = 0.001
"""The same where it is to be said how far a line can be followed [m]."""

FEWEST = 8
"""Fewest parts that a line is cut into, so that a turn on the spot is looked at too."""

MOST_POINTS = 400
"""A line that needs more than this is given up: it passes too close to a singular posture."""

CURVES = 8
"""For so many profiles a curve is tried; it fails only near singular postures. Chosen."""

JUMP = 0.5
"""Neighbouring postures further apart than this in a joint are not one motion [rad]. Chosen."""

PITCH_STEP = 0.1
"""How far apart the final pitches are that are tried [rad]. Chosen: 6 degrees."""

NEAR_LIMIT = 0.03
"""A joint this close to its limit where a line ends is what ended it [rad]. Chosen: what a joint
moves in one or two millimetres."""

NEAR_END = 0.010
"""A point that cannot be reached so soon after the line ends is what ended it [m]. Chosen."""

LIMIT_SLACK = 0.5 * verify.POSITION_TOLERANCE
"""How far a curve may be outside the joint limits [rad]: safely what verification lets pass."""

_LOOKS_PER_PIECE = 8
"""At how many points of each piece a curve is held against the joint limits. Chosen."""

_LOOKED_INTO = 12
"""How many profiles are followed closely to say where a line ends."""

_SHAPES: tuple[Callable[[float], float], ...] = (
    lambda u: u,
    lambda u: 1.0 - (1.0 - u) ** 3,
    lambda u: u**3,
)
"""Ways to spread a change over the line: evenly, early, late."""


class Profile(NamedTuple):
    """How pitch and roll change along a line.

    Attributes:
        pitch: At the start and at the end [rad].
        roll: At the start and at the end [rad].
        shape: The share of the change done when the share ``u`` of the line is.
    """

    pitch: tuple[float, float]
    roll: tuple[float, float]
    shape: Callable[[float], float]

    def at(self, u: float) -> tuple[float, float]:
        """Pitch and roll [rad] at a share of the line."""
        part = self.shape(u)
        pitch, roll = (begin + part * (end - begin) for begin, end in (self.pitch, self.roll))
        return pitch, roll


class Followed(NamedTuple):
    """How far a line can be followed with one profile.

    Attributes:
        q: A posture for each point, the start's included, shape (k, 5), [rad].
        done: The share of the line that is.
        blocked: The posture in contact that ended it, shape (5,), [rad], or None.
    """

    q: Array
    done: float
    blocked: Array | None


class LinePlanner:
    """Finds joint motions for straight lines of the tool. Belongs to one thread."""

    def __init__(self, ik: IkSolver) -> None:
        self._ik = ik

    def find(
        self, goal: LineGoal, q_start: Array, collision: CollisionModel, q_jaw: float
    ) -> ToolLine:
        """A curve along which the tool moves straight to a goal, free of contact.

        Where the approach or the whole pose counts, pitch and roll change evenly from the start's
        to the goal's; the azimuth is then whatever the arm's plane makes it.

        Args:
            goal: Where the line ends, and what else counts.
            q_start: A free posture inside the limits, shape (5,), [rad]; the line starts there.
            collision: What is in the way.
            q_jaw: Jaw angle during the motion [rad].

        Raises:
            Unreachable: The line leaves the reach of the arm; says after how many millimetres and
                what stops it there.
            InCollision: The line can be followed, but not free of contact.
            ConfigError: The goal holds numbers that cannot be meant.
        """
        line = _Line(self._ik, goal, q_start, collision, q_jaw)
        passing = filter(line.passes, line.profiles())
        for profile in islice(passing, CURVES):
            found = line.curve(profile, line.spaced(SPACING))
            if found is not None:
                return found
        profile, followed = line.farthest()
        found = line.curve(profile, len(followed.q) - 1) if followed.done == 1.0 else None
        if found is None:
            raise line.refusal(followed)
        return found


class _Line:
    """One line under way: where it runs, and what has been tried."""

    def __init__(
        self, ik: IkSolver, goal: LineGoal, q_start: Array, collision: CollisionModel, q_jaw: float
    ) -> None:
        if ik.structure is None:
            raise PlanningError(
                "straight lines need an arm with a pan, three parallel joints and a roll, which"
                " this URDF does not describe; move to the pose instead"
            )
        self._ik, self._structure, self._model = ik, ik.structure, ik.model
        self._goal, self._q_start = goal, q_start
        self._collision, self._q_jaw = collision, q_jaw
        self._end = PoseGoal(T_base_tool=goal.T_base_tool, metric=goal.metric, frame=goal.frame)
        check_goal(self._model, self._end)
        if not 0.0 < goal.tolerance < math.inf:
            raise ConfigError("tolerance", goal.tolerance, "must be positive and finite [m]")
        self._p_start = np.array(self._model.rotation_and_position(q_start, goal.frame)[1])
        self._way = goal.T_base_tool.p - self._p_start
        self.length = float(np.linalg.norm(self._way))
        self._most, self._farthest = -1.0, list[Profile]()
        self._touching: Array | None = None
        self._beyond: float | None = None  # where the curve tried last leaves the joint limits

    def profiles(self) -> Iterator[Profile]:
        """Ways for pitch and roll, the gentlest first.

        Raises:
            Unreachable: There is no posture for the line's end, where more than the point counts.
        """
        pitch, roll = float(self._q_start[1:4].sum()), float(self._q_start[4])
        if self._goal.metric is GoalMetric.POSITION_ONLY:
            yield Profile((pitch, pitch), (roll, roll), _SHAPES[0])
            for shape in _SHAPES:
                for step in range(1, math.ceil(math.pi / PITCH_STEP)):
                    for change in (step * PITCH_STEP, -step * PITCH_STEP):
                        yield Profile((pitch, pitch + change), (roll, roll), shape)
        else:
            for solution in self._ik.candidates(self._end, self._q_start):
                end_pitch, end_roll = float(solution.q[1:4].sum()), float(solution.q[4])
                yield Profile((pitch, end_pitch), (roll, end_roll), _SHAPES[0])

    def passes(self, profile: Profile) -> bool:
        """Whether the line can be followed to its end, looking at points a little apart."""
        done = self._followed(profile, self.spaced(LOOK)).done
        if done > self._most:
            self._most, self._farthest = done, []
        if done == self._most:
            self._farthest.append(profile)
        return done == 1.0

    def curve(self, profile: Profile, count: int) -> ToolLine | None:
        """The smooth curve for a profile, None if it is blocked or too close to singular.

        Args:
            profile: One that passes.
            count: Into how many parts to cut the line first.
        """
        while count <= MOST_POINTS:
            followed = self._followed(profile, count)
            if followed.done < 1.0:
                return None
            path = curve_through(followed.q)
            self._beyond = self._share_outside(path)
            if self._beyond is None and self._error(path) <= 0.5 * self._goal.tolerance:
                self._touching = self._collision.blocked_posture(followed.q, self._q_jaw)
                return ToolLine(path=path, length=self.length) if self._touching is None else None
            count *= 2
        return None

    def farthest(self) -> tuple[Profile, Followed]:
        """The profile that gets furthest when the line is looked at closely."""
        tried = [
            (profile, self._followed(profile, self.spaced(CLOSE)))
            for profile in self._farthest[-_LOOKED_INTO:]
        ]
        return max(tried, key=lambda each: each[1].done)

    def refusal(self, followed: Followed) -> PlanningError:
        """What is wrong with a line that cannot be followed any further than this."""
        blocked = followed.blocked if followed.blocked is not None else self._touching
        if followed.done < 1.0 and followed.blocked is None:
            q = followed.q[-1]
            return self._ended(followed.done, q, self._limit(q, followed.done))
        if blocked is None and self._beyond is not None:
            q = followed.q[int(self._beyond * (len(followed.q) - 1))]
            return self._ended(self._beyond, q, self._limit(q, self._beyond))
        if blocked is None:
            # Where the joints have to move most for their millimetre.
            worst = int(np.argmax(np.abs(np.diff(followed.q, axis=0)).max(axis=1)))
            done = worst / (len(followed.q) - 1)
            return self._ended(done, followed.q[worst], "a singular posture")
        closest = self._collision.clearance(blocked, self._q_jaw)
        return InCollision(
            f"{self._how_far(followed.done)}, then {closest.told()}"
            f" ({to_mm(self._collision.margin):.0f} mm must stay free); end the line earlier, or"
            " start it from another posture",
            first=closest.first,
            second=closest.second,
            where="way",
        )

    def spaced(self, spacing: float) -> int:
        """Into how many parts of at most ``spacing`` [m] to cut the line; never too few."""
        return max(FEWEST, math.ceil(self.length / spacing))

    def _how_far(self, done: float) -> str:
        length_mm = to_mm(self.length)
        return (
            f"the {self._goal.frame} can follow {done * length_mm:.0f} of the {length_mm:.0f} mm of"
            " the line"
        )

    def _ended(self, done: float, q: Array, limit: str | None) -> Unreachable:
        why = f"stopped by {limit}" if limit else "about to change its posture at once"
        return Unreachable(
            f"{self._how_far(done)}: there it is {why}; end the line earlier, or start it from"
            " another posture",
            error_position=(1.0 - done) * self.length,
            error_angle=0.0,
            p_base_nearest=self._point(done),
            q_nearest=q,
            limit=limit,
        )

    def _limit(self, q: Array, done: float) -> str | None:
        """What ends the line after posture ``q``; None if only continuity does.

        Args:
            q: The last posture, shape (5,), [rad].
            done: The share of the line that ends there.
        """
        ahead = NEAR_END / self.length if self.length > 0.0 else 0.0
        try:
            for u in np.linspace(done, min(1.0, done + ahead), 11):
                self._ik.solve(PoseGoal.at_point(self._point(u), frame=self._goal.frame), q)
        except Unreachable as error:
            return error.limit
        room = np.minimum(q - self._model.lower, self._model.upper - q)
        i = int(np.argmin(room))
        if room[i] > NEAR_LIMIT:
            return None
        return limit_name(i, 1.0 if self._model.upper[i] - q[i] < NEAR_LIMIT else -1.0)

    def _point(self, u: float) -> Array:
        return self._p_start + u * self._way

    def _postures(self, u: float, profile: Profile) -> list[Array]:
        x, y, z = self._point(u).tolist()
        pitch, roll = profile.at(u)
        found = self._structure.postures((x, y, z), pitch, roll, self._goal.frame)
        lower, upper = self._model.lower, self._model.upper
        return [np.clip(posture.q, lower, upper) for posture in found]

    def _followed(self, profile: Profile, steps: int) -> Followed:
        """Postures along the line as far as they are one motion and free of contact."""
        q = [self._q_start]
        blocked = None
        for k in range(1, steps + 1):
            found = self._postures(k / steps, profile)
            apart = [float(np.abs(each - q[-1]).max()) for each in found]
            if not found or min(apart) > JUMP:
                break
            nearest = found[apart.index(min(apart))]
            if not self._collision.is_free(nearest, self._q_jaw):
                blocked = nearest
                break
            q.append(nearest)
        return Followed(np.array(q), (len(q) - 1) / steps, blocked)

    def _share_outside(self, path: JointPath) -> float | None:
        """Where the curve first leaves the joint limits between its postures, None if nowhere."""
        u = np.linspace(0.0, 1.0, _LOOKS_PER_PIECE * (len(path.knots) - 1) + 1)
        q = path.evaluate(u).q
        outside = np.maximum(self._model.lower - q, q - self._model.upper).max(axis=1)
        beyond = np.flatnonzero(outside > LIMIT_SLACK)
        return float(u[beyond[0]]) if len(beyond) else None

    def _error(self, path: JointPath) -> float:
        """How far the tool is from the line in the middle between the points [m]."""
        middles = 0.5 * (path.knots[:-1] + path.knots[1:])
        tool = [
            self._model.rotation_and_position(q, self._goal.frame)[1].copy()
            for q in path.evaluate(middles).q
        ]
        off = np.array(tool) - (self._p_start + middles[:, None] * self._way)
        return float(np.linalg.norm(off, axis=1).max())
