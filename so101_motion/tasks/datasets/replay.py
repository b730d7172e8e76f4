"""Replay an episode of a data set on an arm, in the time of the episode.

After a planned approach the arm follows the recorded angles within its caps and its guard. Time is
counted in control periods, so a late period skips nothing.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import Future, wait
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from so101_motion.arm.gripper import JawFollowing
from so101_motion.calib.record.store import Stored
from so101_motion.common.encoder_zeros import shift
from so101_motion.common.errors import ConfigError, PlanningError
from so101_motion.common.geometry import Array
from so101_motion.common.realtime import LOOK_FOR_SIGNALS
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_rad
from so101_motion.control.following import APPROACH, Following
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.request import Plan
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.rig import Rig
from so101_motion.tasks.datasets.check import angles
from so101_motion.tasks.datasets.data_set import DataSet
from so101_motion.tasks.datasets.joint_checks import Differences, tracking
from so101_motion.tasks.datasets.metadata import refusal
from so101_motion.tasks.datasets.units import Units, UnitsGuess
from so101_motion.tasks.teleop.sides import jaw_of

_REST = 0.5  # [s] that the last frame is held, so that the arm gets there
_AHEAD = (
    0.045  # [s] that the arm is aimed ahead of time, as in teleoperation, so that it is not late
)
_LONGEST_LAG = 0.5  # [s] that may be removed from the deviation
_BEYOND = to_rad(0.5)  # a joint farther outside the range than this counts as beyond it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EpisodeReplay:
    """A replay that is ready to begin."""

    t: Array  # when each frame is due, from 0 on, shape (n,), [s]
    q: Array  # where the arm joints are sent, within the arm's range, shape (n, 5), [rad]
    aperture: Array | None  # how far the jaw is open, 0 to 1, shape (n,); None to leave it alone
    approach: Plan  # the plan from where the arm is to the first frame
    fps: float  # frames a second by the time stamps
    # in how many frames each joint was recorded beyond this arm's range, so that it stays at its
    # limit; only joints that were
    beyond: Mapping[str, int]
    doubts: tuple[str, ...]  # why the numbers are hardly in the units that were given, as text

    @property
    def duration(self) -> float:
        """How long it takes after the approach [s]."""
        return float(self.t[-1])


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOutcome:
    """How a replay went."""

    differences: Differences  # how far the arm was from the recording
    held_s: float  # how long obstacles held it back [s]
    held_by: tuple[str, ...]  # the obstacles, the most frequent first


def calibration_of(rig: Rig) -> Stored | None:
    """The calibration that a rig uses; None for a simulated one."""
    if not isinstance(rig, HardwareRig):
        return None
    rig.require_ready()
    setups = rig.servos.setups
    return Stored(
        path=Path("the arm's own"),
        calibration={joint: setup.calibration for joint, setup in setups.items()},
        zeros={joint: setup.zero for joint, setup in setups.items() if joint in ARM_JOINTS},
        notes=(),
    )


def plan_episode(
    rig: Rig,
    data_set: DataSet,
    number: int,
    *,
    units: Units,
    of: str = "action",
    start: float = 0.0,
) -> EpisodeReplay:
    """Prepare the replay of an episode and plan the path to its first frame; moves nothing.

    Args:
        rig: The arm; its caps, range and scene count.
        data_set: The data set of the episode.
        number: The episode's number.
        units: The units of its numbers.
        of: ``"action"``, where the joints were sent, or ``"state"``, where they were.
        start: How far into the episode it begins [s].

    Raises:
        ConfigError: The data set declares other units, there is no such episode, its time stamps do
            not increase, or a frame of it lacks a number.
        PlanningError: The first frame cannot be reached.
    """
    data_set.refuse_other_units(units)
    episode = data_set.episode(number)
    steps = np.diff(episode.t)
    if not (np.isfinite(episode.t).all() and (steps > 0.0).all()):
        frame = int(np.argmin(np.isfinite(steps) & (steps > 0.0))) + 1
        reason = f"frame {frame} of episode {number} has no later time stamp than the one before"
        raise refusal(data_set.metadata.root, reason)
    t = episode.t - episode.t[0]
    action, state = angles(data_set, units, episode)
    if of not in ("action", "state") or (of == "state" and state is None):
        raise ConfigError("of", of, "must be action, or state where the data set holds it")
    recorded = action if of == "action" or state is None else state
    recorded[:, :5] += _moved_zeros(rig, data_set, units)
    begin = int(np.searchsorted(t, start - 1e-4))
    recorded, t = recorded[begin:], t[begin:]
    if not len(recorded):
        raise ConfigError("start", start, f"episode {number} is {np.ptp(episode.t):.1f} s long")
    guess = UnitsGuess()
    guess.add(episode.state if of == "state" and episode.state is not None else episode.action)
    missing = np.flatnonzero(np.isnan(recorded).any(axis=1))
    if len(missing):
        frame = len(episode) - len(recorded) + int(missing[0])
        reason = f"frame {frame} of episode {number} lacks a number; so101 dataset check says more"
        raise refusal(data_set.metadata.root, reason)
    lower, upper = rig.arm.range
    q = np.clip(recorded[:, :5], lower, upper)
    over = (np.abs(recorded[:, :5] - q) > _BEYOND).sum(axis=0).tolist()
    try:
        approach = rig.arm.plan(JointGoal(q=q[0]), limits=_gentle(rig.arm.limits))
    except PlanningError as error:
        raise error.about(f"the first frame of episode {number}") from None
    has_jaw = data_set.has_jaw and jaw_of(rig) is not None
    return EpisodeReplay(
        t=t - t[0],
        q=q,
        aperture=units.aperture(recorded[:, 5]) if has_jaw else None,
        approach=approach,
        fps=1.0 / float(np.median(steps)) if len(steps) else data_set.metadata.fps,
        beyond={joint: n for joint, n in zip(ARM_JOINTS, over, strict=True) if n},
        doubts=guess.doubts(),
    )


def _moved_zeros(rig: Rig, data_set: DataSet, units: Units) -> Array:
    """What to add to the arm joints' angles, because this arm was calibrated anew, [rad].

    Zeros that differ by more are those of another arm, for which the angles of the model count.
    """
    here, root = rig.connection.encoder_zeros, data_set.metadata.root
    try:
        return shift(units.encoder_zeros, here, what="the data set", file=root)
    except ConfigError:
        return np.zeros(5)


def replay_episode(rig: Rig, replay: EpisodeReplay) -> ReplayOutcome:
    """Move to the first frame and along the recording; returns when the arm rests again.

    Raises:
        Interrupted: It was stopped, or another motion took over.
        So101Error: It ended early for another reason; the arm holds.
    """
    rig.arm.move(replay.approach)
    jaw = jaw_of(rig) if replay.aperture is not None else None
    run = _Run(rig, replay)
    following = rig.arm.follow(approach=_gentle(rig.arm.limits), each=run.aim)
    hand = None if jaw is None else jaw.follow(each=run.aim_jaw)
    try:
        _wait_for(following.future)
    finally:
        if hand is not None:
            hand.close()
    if hand is not None:
        _wait_for(hand.future)
    return run.outcome()


class _Run:
    """Leads arm and jaw through the frames, on the I/O thread, and records what they do."""

    def __init__(self, rig: Rig, replay: EpisodeReplay) -> None:
        self._arm, self._replay, self._dt = rig.arm, replay, rig.executor.dt
        self._calls = 0
        self._wanted: list[Array] = []
        self._measured: list[Array] = []
        self._held: Counter[str] = Counter()
        self._held_calls = 0

    def aim(self, following: Following) -> None:
        """Aim at the frame that is due next; close the following after the last one."""
        t, replay = self._calls * self._dt, self._replay
        self._calls += 1
        q = self._at(t + _AHEAD)
        if t <= replay.duration:
            self._wanted.append(self._at(t))
            self._measured.append(self._arm.state.q)
        if following.is_held:
            self._held_calls += 1
            self._held.update(following.held_by)
        if t > replay.duration + _REST:
            following.close()
        elif t < replay.duration:
            qd = (self._at(t + _AHEAD + self._dt) - q) / self._dt
            following.aim(q, qd, most=math.inf)
        else:
            following.aim(q, most=math.inf)

    def aim_jaw(self, jaw: JawFollowing) -> None:
        """Open or close the jaw as far as is due."""
        aperture = self._replay.aperture
        assert aperture is not None
        wanted = float(np.interp(self._calls * self._dt, self._replay.t, aperture))
        jaw.aim(wanted, most=math.inf)

    def outcome(self) -> ReplayOutcome:
        wanted, measured = np.array(self._wanted), np.array(self._measured)
        found, _ = tracking(wanted, measured, round(_LONGEST_LAG / self._dt))
        assert found is not None
        return ReplayOutcome(
            differences=Differences.of([found], 1.0 / self._dt),
            held_s=round(self._held_calls * self._dt, 3),
            held_by=tuple(what for what, _ in self._held.most_common()),
        )

    def _at(self, t: float) -> Array:
        times, q = self._replay.t, self._replay.q
        return np.array([np.interp(t, times, q[:, i]) for i in range(5)])


def _gentle(limits: MotionLimits) -> MotionLimits:
    return APPROACH.lowered_to(limits.velocity, limits.acceleration)


def _wait_for(future: Future[None]) -> None:
    """Wait for a following in short steps, so that Ctrl-C is noticed."""
    while not future.done():
        wait((future,), LOOK_FOR_SIGNALS)
    future.result()
