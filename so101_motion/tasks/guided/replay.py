"""Plan the replay of a guided path completely, before anything moves.

The hand's own timing is not replayed. The thinned path is cut where the arm stood and only the jaw
moved, where a jaw that had closed begins to open, and at both ends of a stretch on which the jaw
needs much longer than the arm. Each part, a *leg*, is planned as one motion; its jaw's aperture
depends on where the arm is. Two fifths of the tolerance are for thinning, two for rounding corners;
an arm that stays within the last fifth stands, and where the jaw leads within all of it, because a
hand that closes the jaw nudges the arm.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from so101_motion.arm.arm import Arm
from so101_motion.arm.gripper import Gripper, JawFollowing, move_jaw
from so101_motion.arm.motion_handle import Motion, Step
from so101_motion.common.errors import ConfigError, InCollision, OutsideLimits, PlanningError
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import range_deg, to_deg, to_rad
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import MARGIN_TOLERANCE
from so101_motion.planning.goals import JointGoal, PathGoal
from so101_motion.planning.request import Plan
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import slowed
from so101_motion.tasks.guided.path import TOLERANCE, GuidedPath, along

TOLERANCE_RANGE = (to_rad(0.5), to_rad(15.0))
"""Allowed tolerances [rad]; chosen: with less the replay follows every tremor of the hand, with
more it is another path."""

_SHARE = 0.4  # of the tolerance, for the thinning, and for the rounding
_STANDS = 0.2  # share of the tolerance within which an arm counts as standing
_RESERVE = 0.8  # share of the jaw's speed that a leg may use; the rest lets it catch up
_LEADS = 2.0
"""The jaw leads if it needs so many times as long as the arm from one corner to the next. Chosen: a
whole leg is slowed down for its jaw, and a nudge of half a degree while the jaw closed made a path
of four seconds last four minutes."""

_JAW_LOOK = to_rad(5.0)  # between two jaw angles at which a leg is checked for contact; chosen
_LOOKS = 25  # jaw angles that are checked while the arm stands
_STILL = 1e-3  # smaller changes of the aperture are ignored


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReplayLeg:
    """A part of the path that is played as one motion."""

    begin: float | None  # aperture to which the jaw moves before; None to leave it
    plan: Plan | None  # the motion of the arm; None if only the jaw moves
    aperture: Array | None = None  # the jaw's at each sample, shape (n,); None to leave it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Replay:
    """A planned replay of a guided path."""

    tolerance: float  # how far any joint may be from it [rad]
    approach: Plan  # the plan from where the arm is to the beginning of the path
    legs: tuple[ReplayLeg, ...]  # the motions along the path

    @property
    def plans(self) -> tuple[Plan, ...]:
        """The plans of the arm, one after the other; the approach first."""
        return (self.approach, *(leg.plan for leg in self.legs if leg.plan is not None))

    @property
    def duration(self) -> float:
        """How long the arm moves [s]; motions of the jaw alone are not counted."""
        return sum(plan.duration for plan in self.plans)


def plan_replay(
    arm: Arm,
    path: GuidedPath,
    *,
    gripper: Gripper | None = None,
    tolerance: float = TOLERANCE,
    limits: MotionLimits | None = None,
) -> Replay:
    """Plan to move to the beginning of a path and along it; moves nothing.

    Args:
        arm: The arm; its caps, range and scene count.
        path: The recorded path. Where it is beyond the arm's range by less than ``tolerance``,
            because a hand pushed against a stop, the arm goes to the limit.
        gripper: The arm's; None to leave the jaw alone.
        tolerance: How far any joint may be from the path [rad].
        limits: Caps of the motion; the arm's own if not given.

    Raises:
        PlanningError: The path cannot be replayed; the message has the time in the recording.
        ConfigError: The tolerance is out of range.
    """
    lower, upper = TOLERANCE_RANGE
    if not lower <= tolerance <= upper:
        raise ConfigError(
            "tolerance_deg", to_deg(tolerance), f"must be {to_deg(lower):g} to {to_deg(upper):g}"
        )
    if gripper is None:
        path = replace(path, aperture=None)
    corners = _within_range(arm, path, tolerance).thinned(_SHARE * tolerance)
    approach = arm.plan(JointGoal(q=corners.q[0]), limits=limits)
    legs, q_from = [], approach.q_goal
    maker = _LegMaker(arm, gripper, _SHARE * tolerance, limits)
    pace = None if gripper is None else _Pace.of(gripper, limits or arm.limits)
    for cut in _cut(corners, tolerance, pace):
        leg = maker.leg(cut, q_from)
        legs.append(leg)
        q_from = q_from if leg.plan is None else leg.plan.q_goal
    return Replay(tolerance=tolerance, approach=approach, legs=tuple(legs))


# Planning


def _within_range(arm: Arm, path: GuidedPath, tolerance: float) -> GuidedPath:
    lower, upper = arm.range
    over = np.maximum(lower - path.q, path.q - upper)
    k, i = np.unravel_index(int(np.argmax(over)), over.shape)
    if over[k, i] > tolerance:
        raise OutsideLimits(
            f"{path.t[k]:.1f} s into the recording {ARM_JOINTS[i]} is at"
            f" {to_deg(float(path.q[k, i])):.1f} deg, but this arm goes from"
            f" {range_deg(float(lower[i]), float(upper[i]), 1)} deg; show it again"
            " with this arm",
            joint=ARM_JOINTS[i],
            value=float(path.q[k, i]),
            lower=float(lower[i]),
            upper=float(upper[i]),
        )
    return replace(path, q=np.clip(path.q, lower, upper))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Cut:
    """The corners between two cuts."""

    corners: GuidedPath  # at least one; their times are those of the recording
    begin: float | None  # aperture to which the jaw moves before; None to leave it
    t: tuple[float, float]  # when in the recording they begin and end [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Pace:
    """The speed limits of arm and jaw."""

    joints: Array  # shape (5,), [rad/s]
    jaw: float  # shares of its travel [1/s]

    @classmethod
    def of(cls, gripper: Gripper, limits: MotionLimits) -> _Pace:
        span = abs(gripper.opened - gripper.closed)
        return cls(joints=limits.velocity, jaw=_RESERVE * float(gripper.limits.velocity[0]) / span)

    def jaw_leads(self, corners: GuidedPath, k: int) -> bool:
        """Whether the jaw needs much longer than the arm from corner ``k - 1`` to ``k``."""
        assert corners.aperture is not None
        jaw = abs(float(corners.aperture[k] - corners.aperture[k - 1])) / self.jaw
        arm = float((np.abs(corners.q[k] - corners.q[k - 1]) / self.joints).max())
        return jaw > _LEADS * arm


def _cut(corners: GuidedPath, tolerance: float, pace: _Pace | None) -> Iterator[_Cut]:
    """Cut a path where the arm must stand or wait for the jaw; see the top of this file."""
    if corners.aperture is None or pace is None:
        yield _Cut(corners=corners, begin=None, t=(0.0, corners.duration))
        return
    corners = corners.taken(_without_halves(corners, _STANDS * tolerance))
    jaw = corners.aperture
    assert jaw is not None
    start, begin, closes, jaw_led = 0, float(jaw[0]), False, False
    for k in range(1, len(corners)):
        change = float(jaw[k] - jaw[k - 1])
        moves = abs(change) > _STILL
        leads = moves and pace.jaw_leads(corners, k)
        standing = moves and _is_near(corners, k - 1, k, (1.0 if leads else _STANDS) * tolerance)
        opens = moves and closes and change > 0.0
        if standing or opens or ((leads or jaw_led) and k > 1):
            yield _part(corners, start, k - 1, begin)
            # The jaw has arrived before the arm goes on, wherever it was while the arm stood.
            start, begin = k - 1, float(jaw[k] if standing else jaw[k - 1])
        jaw_led = leads and not standing
        closes = change < 0.0 if moves else closes
    yield _part(corners, start, len(corners) - 1, begin)


def _without_halves(corners: GuidedPath, stands: float) -> NDArray[np.intp]:
    """Drop corners so that the jaw moves in one go where the arm stands; returns their indices."""
    jaw = corners.aperture
    assert jaw is not None
    kept = [0]
    for k in range(1, len(corners)):
        if len(kept) > 1:
            before, last = kept[-2:]
            first, second = jaw[last] - jaw[before], jaw[k] - jaw[last]
            if (
                abs(first) > _STILL
                and first * second > 0.0
                and _is_near(corners, before, k, stands)
            ):
                kept.pop()
        kept.append(k)
    return np.array(kept)


def _is_near(corners: GuidedPath, a: int, b: int, within: float) -> bool:
    return float(np.abs(corners.q[b] - corners.q[a]).max()) <= within


def _part(corners: GuidedPath, first: int, last: int, begin: float) -> _Cut:
    part = corners.taken(slice(first, last + 1))
    jaw = np.array(part.aperture)
    jaw[0] = begin
    return _Cut(
        corners=replace(part, aperture=jaw),
        begin=begin,
        t=(float(corners.t[first]), float(corners.t[last])),
    )


class _LegMaker:
    """Plans the legs of one replay, one after the other."""

    def __init__(
        self, arm: Arm, gripper: Gripper | None, tolerance: float, limits: MotionLimits | None
    ) -> None:
        self._arm, self._gripper = arm, gripper
        self._tolerance, self._limits = tolerance, limits
        self._aperture = 0.0 if gripper is None else min(max(gripper.aperture, 0.0), 1.0)

    def leg(self, cut: _Cut, q_from: Array) -> ReplayLeg:
        """Plan the leg between two cuts, from where the one before ends, shape (5,), [rad]."""
        try:
            if self._gripper is None or cut.begin is None or cut.corners.aperture is None:
                return ReplayLeg(begin=None, plan=self._plan(cut.corners, q_from, None))
            return self._with_jaw(self._gripper, cut, cut.begin, cut.corners.aperture, q_from)
        except PlanningError as error:
            when = f"{cut.t[0]:.1f} to {cut.t[1]:.1f} s into the recording"
            raise error.about(when) from None

    def _plan(self, corners: GuidedPath, q_from: Array, q_jaw: float | None) -> Plan | None:
        if len(corners) == 1:
            return None
        goal = PathGoal(waypoints=corners.q[1:], tolerance=self._tolerance)
        return self._arm.plan(goal, limits=self._limits, q_start=q_from, q_jaw=q_jaw)

    def _with_jaw(
        self, gripper: Gripper, cut: _Cut, begin: float, jaw: Array, q_from: Array
    ) -> ReplayLeg:
        turn = np.linspace(self._aperture, begin, _LOOKS)
        self._check(gripper, np.tile(q_from, (_LOOKS, 1)), turn)
        self._aperture = begin
        plan = self._plan(cut.corners, q_from, float(angles(gripper, np.array([begin]))[0]))
        if plan is None or np.ptp(jaw) <= _STILL:
            return ReplayLeg(begin=begin, plan=plan)
        plan, aperture = _together(plan, cut.corners.q, jaw, gripper)
        self._check(gripper, plan.trajectory.q, aperture)
        self._aperture = float(aperture[-1])
        return ReplayLeg(begin=begin, plan=plan, aperture=aperture)

    def _check(self, gripper: Gripper, q: Array, aperture: Array) -> None:
        """Check a motion, shape (n, 5), with the jaw's aperture at each place."""
        q_jaws = angles(gripper, aperture)
        level = np.round(q_jaws / _JAW_LOOK).astype(int)
        changes = [0, *(np.flatnonzero(np.diff(level)) + 1).tolist(), len(level)]
        for begin, end in pairwise(changes):
            q_jaw = float(np.mean(q_jaws[begin:end]))
            part = q[max(begin - 1, 0) : end]
            blocked = self._collision.first_blocked(part, q_jaw, tolerance=MARGIN_TOLERANCE)
            if blocked is not None:
                found = self._collision.clearance(blocked, q_jaw)
                raise InCollision(
                    f"with the jaw as it was there, {found.message()}; record it with more room",
                    first=found.first,
                    second=found.second,
                    where="path",
                )

    @cached_property
    def _collision(self) -> CollisionModel:
        return CollisionModel(self._arm.model, self._arm.scene)


def _together(plan: Plan, q: Array, jaw: Array, gripper: Gripper) -> tuple[Plan, Array]:
    """Slow a plan down for the jaw; return it with the aperture at each sample."""
    aperture = _apertures(plan, q, jaw)
    span = abs(gripper.opened - gripper.closed)
    fastest = float(np.abs(np.diff(aperture)).max()) * span / plan.trajectory.dt
    share = fastest / (_RESERVE * float(gripper.limits.velocity[0]))
    if share <= 1.0:
        return plan, aperture
    plan = replace(plan, trajectory=slowed(plan.trajectory, share))
    return plan, _apertures(plan, q, jaw)


def _apertures(plan: Plan, q: Array, jaw: Array) -> Array:
    return np.interp(along(q, plan.trajectory.q), np.arange(len(jaw)), jaw)


def angles(gripper: Gripper, aperture: Array) -> Array:
    return np.asarray(gripper.closed + aperture * (gripper.opened - gripper.closed))


# Running

_AHEAD = 4  # samples ahead in which the arm's place is searched in a period; chosen


def start_replay(
    arm: Arm, gripper: Gripper | None, replay: Replay | Callable[[], Future[Replay]]
) -> Motion:
    """Move along a planned path; supersedes what is under way.

    A stop, a newer motion or ``Motion.interrupt`` ends it at any point, and the jaw stops too.

    Args:
        arm: The arm that it was planned for; it must be where the plan begins.
        gripper: Its gripper; None to leave the jaw alone.
        replay: The planned replay, or a function that starts planning it once the arm rests.
    """
    runs: list[_JawRun] = []
    motion = arm.start_series(_steps(arm, gripper, replay, runs))
    motion.future.add_done_callback(lambda _: _close(runs))
    return motion


def _steps(
    arm: Arm,
    gripper: Gripper | None,
    replay: Replay | Callable[[], Future[Replay]],
    runs: list[_JawRun],
) -> Iterator[Step]:
    if callable(replay):
        planning, planned = replay(), list[Replay]()
        yield lambda motion: planned.append(motion.wait_for(planning))
        replay = planned[0]
    yield partial(_checked, arm, gripper, ReplayLeg(begin=None, plan=replay.approach))
    for leg in replay.legs:
        if gripper is not None and leg.begin is not None:
            yield partial(move_jaw, gripper, leg.begin)
        if leg.plan is None:
            continue
        going = partial(_checked, arm, gripper, leg)
        if gripper is None or leg.aperture is None:
            yield going
            continue
        run = _JawRun(arm, gripper, leg.plan, leg.aperture)
        runs.append(run)
        yield run.begin
        yield going
        yield run.end


def _checked(arm: Arm, gripper: Gripper | None, leg: ReplayLeg, _: Motion) -> Plan | None:
    """The motion of a leg, checked again with the jaw as wide open as it will be."""
    widest = None
    if gripper is not None and leg.aperture is not None:
        widest = float(angles(gripper, leg.aperture.max(keepdims=True))[0])
    return leg.plan and arm.check_again(leg.plan, widest)


def _close(runs: list[_JawRun]) -> None:
    for run in runs:
        run.close()


class _JawRun:
    """Moves the jaw on one leg: it follows the aperture that belongs to the arm's place."""

    def __init__(self, arm: Arm, gripper: Gripper, plan: Plan, aperture: Array) -> None:
        self._arm, self._gripper = arm, gripper
        self._q, self._aperture, self._dt = plan.trajectory.q, aperture, plan.trajectory.dt
        self._rate = np.gradient(aperture, self._dt)
        self._at = 0
        self._following: JawFollowing | None = None

    def begin(self, motion: Motion) -> None:
        """Start the jaw; a jaw that grips and is not to open keeps its grip."""
        if self._gripper.is_holding and self._aperture.max() <= self._gripper.aperture:
            return
        self._following = self._gripper.follow(each=self._aim)

    def end(self, motion: Motion) -> None:
        """Wait for the jaw, because the arm has arrived."""
        if self._following is not None:
            motion.wait_for(self._following.close())

    def close(self) -> None:
        if self._following is not None:
            self._following.close()

    # The I/O thread

    def _aim(self, jaw: JawFollowing) -> None:
        q_ref = self._arm.state.q_ref
        ahead = self._q[self._at : self._at + _AHEAD]
        self._at += int(np.argmin(np.abs(ahead - q_ref).max(axis=1)))
        coming = min(self._at + 1, len(self._q) - 1)  # where the arm is wanted after this period
        jaw.aim(self._aperture[coming], self._rate[coming], most=math.inf)
