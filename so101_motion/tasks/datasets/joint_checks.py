"""Check the joints of an episode for missing numbers, jumps, limits, speeds, standing and lag.

Arrays in, moments out; all angles are the model's [rad]. Contact is in ``check``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_rad
from so101_motion.tasks.datasets.data_set import LARGEST_NUMBER, Episode
from so101_motion.tasks.datasets.moments import (
    FROZEN,
    JUMP,
    LIMIT,
    MISSING,
    MOST_OF_EPISODE,
    SPEED,
    TIME,
    TRACKING,
    About,
    Moments,
    runs,
)

_LONGEST_LAG = 0.5  # [s] that a state may be behind its action to be compared with it
_SLACK = 0.1  # [s] by which a joint may start later, or stop earlier, than its lag says; chosen
_STILL = to_rad(1e-4)  # less is no change; a servo's count is 0.09 deg

# Beyond which values something is reported; all chosen.
SPEED_CAP = to_rad(180.0)  # of a joint [rad/s]; teleoperation's own cap
_JUMP = to_rad(400.0)  # in a single step [rad/s]: a servo without load turns at some 300 deg/s
_JUMP_STEP = to_rad(5.0)  # smallest such step [rad]; a smaller one may be noise of the encoder
_BEYOND = to_rad(2.0)  # of a joint's travel [rad]; play and rounding
_OFF = to_rad(10.0)  # from where it was sent, without the lag [rad]; droop and friction cause 5 deg
_OFF_TIME = 0.2  # how long it must be that far off [s]
_FROZEN_TIME = 1.0  # how long a joint must stand while its action moves on [s]
_FROZEN_TRAVEL = to_rad(8.0)  # how far the action moves meanwhile [rad]; more than a joint droops
_GAP = 1.5  # periods that may pass from frame to frame


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tracking:
    """How far the state of an episode is from the action, without the lag."""

    lag: int  # how many frames the state is behind
    frames: int  # how many frames were compared
    squares: Array  # the sum of squared differences by arm joint, shape (5,), [rad^2]
    sums: Array  # the sum of differences, state minus action, shape (5,), [rad]
    worst: Array  # the largest difference, shape (5,), [rad]


@dataclass(frozen=True, slots=True, kw_only=True)
class Differences:
    """How far states are from actions, without the lag of each episode."""

    lag_s: float  # the median lag [s]
    rms_deg: Mapping[str, float]  # root mean square, by arm joint [deg]
    mean_deg: Mapping[str, float]  # mean of state minus action, which is droop, by arm joint [deg]
    worst_deg: Mapping[str, float]  # the largest, by arm joint [deg]

    @classmethod
    def of(cls, tracked: Sequence[Tracking], fps: float) -> Differences:
        """Combine one episode or more, recorded at ``fps`` frames a second."""
        frames = sum(each.frames for each in tracked)
        squares = np.sum([each.squares for each in tracked], axis=0)
        sums = np.sum([each.sums for each in tracked], axis=0)
        worst = np.max([each.worst for each in tracked], axis=0)
        lags = np.repeat([each.lag for each in tracked], [each.frames for each in tracked])

        def by_joint(values: Array) -> dict[str, float]:
            degrees = to_deg(values).tolist()
            return {joint: round(each, 3) for joint, each in zip(ARM_JOINTS, degrees, strict=True)}

        return cls(
            lag_s=round(float(np.median(lags)) / fps, 4),
            rms_deg=by_joint(np.sqrt(squares / frames)),
            mean_deg=by_joint(sums / frames),
            worst_deg=by_joint(worst),
        )


class JointCheck:
    """Checks episodes one after the other.

    ``lower`` and ``upper`` are the ends of the arm joints' travels, shapes (5,), [rad].
    """

    def __init__(
        self,
        moments: Moments,
        *,
        fps: float,
        lower: Array,
        upper: Array,
        has_jaw: bool,
        speed: float,
    ) -> None:
        self._moments, self._fps, self._speed = moments, fps, speed
        self._lower, self._upper, self._has_jaw = lower, upper, has_jaw

    def check(self, episode: Episode, action: Array, state: Array | None) -> Tracking | None:
        """Check an episode; returns how far the state is from the action, None if it is not known.

        Angles have shape (n, 6), [rad], and are NaN where they are not known.
        """
        self._check_time(episode)
        for of, q in (("action", action), ("state", state)):
            if q is not None:
                self._check_missing(episode, of, q)
                for i in range(5):
                    self._check_steps(episode, of, i, q[:, i])
                    self._check_travel(episode, of, i, q[:, i])
        if state is None:
            return None
        found = self._check_tracking(episode, action[:, :5], state[:, :5])
        for i in range(5):
            self._check_frozen(episode, i, action[:, i], state[:, i], found.lag if found else 0)
        return found

    def _check_time(self, episode: Episode) -> None:
        period, n = 1.0 / self._fps, len(episode)
        if episode.expected is not None and episode.expected != n:
            lack = abs(n - episode.expected)
            about = About(TIME, "", "", 1.0, "frames")
            words = f"has {n} frames, but its metadata says {episode.expected}"
            self._moments.add(about, episode.index, 0, n - 1, 0, float(lack), words)
        if n < 2:
            return
        with np.errstate(invalid="ignore", over="ignore"):
            step, count = np.diff(episode.t), np.diff(episode.frame)
            off = np.abs(step - period)
        in_time = np.less_equal(off, (_GAP - 1.0) * period)
        wrong = np.array(np.logical_not(in_time) | np.not_equal(count, 1.0), dtype=np.bool_)

        def say(k: int, _: int) -> str:
            if count[k] != 1.0:
                was, now = episode.frame[k : k + 2]
                return f"frame_index goes from {was:.0f} to {now:.0f}"
            if not np.isfinite(step[k]):
                return "a time stamp is not a number"
            return f"{1e3 * step[k]:.0f} ms to the next frame; it should be {1e3 * period:.0f}"

        size = np.where(np.isfinite(step), np.abs(step), LARGEST_NUMBER)
        about = About(TIME, "", "", _GAP * period, "s")
        self._add_runs(episode, about, wrong, size, say)

    def _check_missing(self, episode: Episode, of: str, q: Array) -> None:
        missing = np.asarray(np.isnan(q if self._has_jaw else q[:, :5]).any(axis=1))
        self._add_runs(
            episode,
            About(MISSING, of, "", 1.0, "frames"),
            missing,
            missing.astype(float),
            lambda _, n: f"{of}: {n} frames lack a number, or have one that cannot be an angle",
        )

    def _check_steps(self, episode: Episode, of: str, i: int, q: Array) -> None:
        joint, step_deg = ARM_JOINTS[i], to_deg(np.abs(np.diff(q)))
        limit_deg = to_deg(max(_JUMP / self._fps, _JUMP_STEP))
        speed_deg = to_deg(self._speed)
        jumps = np.greater(step_deg, limit_deg)
        fast = np.greater(step_deg * self._fps, speed_deg) & np.logical_not(jumps)

        def say(k: int, _: int) -> str:
            turn = ", about a whole turn" if abs(step_deg[k] - 360.0) < 30.0 else ""
            return f"{of}: {joint} jumps by {step_deg[k]:.1f} deg in one frame{turn}"

        self._add_runs(episode, About(JUMP, of, joint, limit_deg, "deg"), jumps, step_deg, say)
        self._add_runs(
            episode,
            About(SPEED, of, joint, speed_deg, "deg/s"),
            fast,
            step_deg * self._fps,
            lambda k, _: f"{of}: {joint} goes at {step_deg[k] * self._fps:.0f} deg/s",
        )

    def _check_travel(self, episode: Episode, of: str, i: int, q: Array) -> None:
        joint, over_deg = ARM_JOINTS[i], to_deg(np.maximum(self._lower[i] - q, q - self._upper[i]))
        limit_deg = to_deg(_BEYOND)

        def say(k: int, _: int) -> str:
            at_deg = to_deg(float(q[k]))
            return f"{of}: {joint} is at {at_deg:.1f} deg, {over_deg[k]:.1f} beyond its travel"

        beyond = np.greater(over_deg, limit_deg)
        self._add_runs(episode, About(LIMIT, of, joint, limit_deg, "deg"), beyond, over_deg, say)

    def _check_frozen(
        self, episode: Episode, i: int, action: Array, state: Array, lag: int
    ) -> None:
        """Compare each standing of a joint with the action ``lag`` frames before.

        A joint starts later and stops earlier than the mean lag makes it, so ``_SLACK`` is left out
        at both ends.
        """
        slack = round(_SLACK * self._fps)
        joint, least = ARM_JOINTS[i], max(round(_FROZEN_TIME * self._fps), 2)
        about = About(FROZEN, "state", joint, to_deg(_FROZEN_TRAVEL), "deg")
        for first, last in runs(np.abs(np.diff(state)) <= _STILL):
            begin, stood = max(first + slack - lag, 0), last + 2 - first
            part = action[begin : max(last + 2 - slack - lag, 0)]
            if stood <= least or not len(part) or np.isnan(part).any():
                continue
            travel_deg = to_deg(float(np.ptp(part)))
            if travel_deg > about.limit:
                frame = begin + lag + int(np.argmax(np.abs(part - state[first])))
                words = (
                    f"state: {joint} stands for {stood / self._fps:.1f} s while the action"
                    f" turns it by {travel_deg:.0f} deg"
                )
                self._moments.add(about, episode.index, first, last + 1, frame, travel_deg, words)

    def _check_tracking(self, episode: Episode, action: Array, state: Array) -> Tracking | None:
        found, off = tracking(action, state, round(_LONGEST_LAG * self._fps))
        if found is None:
            return None
        lag = found.lag
        least = max(round(_OFF_TIME * self._fps), 1)
        lag_ms = 1e3 * lag / self._fps
        for i, joint in enumerate(ARM_JOINTS):
            about = About(TRACKING, "", joint, to_deg(_OFF), "deg")
            off_deg = to_deg(np.abs(off[:, i]))
            for first, last in runs(np.greater(off_deg, about.limit)):
                if last - first + 1 < least:
                    continue
                k = first + int(np.argmax(off_deg[first : last + 1]))
                words = (
                    f"{joint} is {off_deg[k]:.1f} deg from where it was sent {lag_ms:.0f} ms before"
                )
                self._moments.add(
                    about, episode.index, first + lag, last + lag, k + lag, float(off_deg[k]), words
                )
        return found

    def _add_runs(
        self,
        episode: Episode,
        about: About,
        mask: NDArray[np.bool_],
        value: Array,
        say: Callable[[int, int], str],
    ) -> None:
        """Add a moment for each stretch of ``mask``; if there are very many, count the others.

        ``value`` is how bad it is at a frame, in the unit of ``about``; ``say(worst, frames)``
        returns the sentence for a stretch.
        """
        found = []
        for first, last in runs(mask):
            k = first + int(np.argmax(value[first : last + 1]))
            found.append((float(value[k]), k, first, last))
        found.sort(key=lambda each: -each[0])
        for worst, k, first, last in found[:MOST_OF_EPISODE]:
            self._moments.add(about, episode.index, first, last, k, worst, say(k, last - first + 1))
        for *_, first, last in found[MOST_OF_EPISODE:]:
            self._moments.count(about.kind, 1, last - first + 1)


def tracking(action: Array, state: Array, most: int) -> tuple[Tracking | None, Array]:
    """Measure how far a state is from an action, shapes (n, 5), [rad], without its lag.

    The lag is ``most`` frames at most. Returns also the difference of each frame, (n - lag, 5),
    [rad]; None instead of the result if nothing can be compared.
    """
    lag = best_lag(action, state, most)
    off = state[lag:] - action[: len(state) - lag]
    known = off[np.logical_not(np.isnan(off).any(axis=1))]
    if not len(known):
        return None, off
    found = Tracking(
        lag=lag,
        frames=len(known),
        squares=np.square(known).sum(axis=0),
        sums=known.sum(axis=0),
        worst=np.abs(known).max(axis=0),
    )
    return found, off


def best_lag(action: Array, state: Array, most: int) -> int:
    """The lag, up to ``most`` frames, at which the squared difference is least."""
    known = np.logical_not(np.isnan(action).any(axis=1) | np.isnan(state).any(axis=1))
    action, state = np.where(known[:, None], action, 0.0), np.where(known[:, None], state, 0.0)
    best, least = 0, np.inf
    for lag in range(min(most, len(state) // 4) + 1):
        n = len(state) - lag
        both = known[lag:] & known[:n]
        if both.any():
            off = np.square(state[lag:] - action[:n]).sum(axis=1)
            mean = float(off[both].mean())
            if mean < least * (1.0 - 1e-9):
                best, least = lag, mean
    return best
