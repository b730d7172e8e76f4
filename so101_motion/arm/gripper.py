"""Move the gripper: an aperture from 0 (closed) to 1 (open), and a grip.

How a grab works. The jaw closes, and what is between the jaws stops it: it falls behind its
setpoints, and the executor then tells it to stay where it is. From there it is sent ``SQUEEZE``
further, which it cannot reach; the servo's position loop turns that distance into a steady force,
a quarter of what the motor could do, that it can keep up without getting hot. As long as the jaw is
held off the place it was sent to, something is held; when the thing slips out, the jaw closes the
distance and nothing is.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Protocol

import numpy as np

from so101_motion.arm.motion_handle import Motion
from so101_motion.common.errors import (
    SUPERSEDED,
    ConfigError,
    FollowingError,
    Interrupted,
    So101Error,
)
from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.control.executor import Channel, Executor
from so101_motion.control.target_tracking import Pursuit, TrackingTarget
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Setpoint

JAW_CLOSED = to_rad(-10.0)
"""Jaw angle at aperture 0 [rad]; the lower joint limit of the robot description."""

JAW_OPEN = to_rad(100.0)
"""Jaw angle at aperture 1 [rad]; the upper joint limit."""

JAW_LIMITS = MotionLimits.uniform(velocity=to_rad(220.0), acceleration=20.0, jerk=400.0, n=1)
"""How fast the jaw moves. Speed: the published simulated gripper's 200 % of the travel a second,
just under what the servo can do; acceleration and jerk: chosen."""

SQUEEZE = to_rad(2.5)
"""How far beyond the contact the jaw is sent [rad]: 28 ticks, which with a P gain of 32 make 23 %
of full drive, 0.6 A. Chosen; a jaw at full drive was reported at 50 degC within a minute."""

GRIP = to_rad(0.9)
"""How far short of its goal the jaw stands at least while it grips [rad]; chosen: thrice what the
servo's dead band and friction leave."""

THINNEST = to_rad(1.5)
"""How far from closed the jaw must have been stopped [rad]: 2 mm between the tips. A jaw that
stands nearer is taken for closed, for calibrations end about there."""

SAME_APERTURE = 0.02
"""An aperture nearer than this to what is wanted needs no motion; chosen."""


class Jaw(Protocol):
    """What ``set_jaw`` needs of a jaw; ``Gripper`` says what each promises."""

    @property
    def aperture(self) -> float:
        """How far it is open: 0 closed, 1 open."""

    @property
    def is_holding(self) -> bool:
        """Whether the last grab got hold of something that is still there."""

    def start_move(self, aperture: float) -> Motion:
        """Open or close to ``aperture``."""

    def start_grab(self, aperture: float = ...) -> Motion:
        """Close until something is gripped or the jaw is closed."""


def set_jaw(jaw: Jaw, aperture: float, motion: Motion) -> None:
    """Open or close a jaw while the arm stands; what it closes on is gripped.

    A jaw that holds something and shall close further goes on holding it.

    Args:
        jaw: The jaw.
        aperture: How far, 0 closed to 1 open.
        motion: The motion of the arm that this is part of; ending it stops the jaw.

    Raises:
        Interrupted: The motion of the arm was ended; the jaw stops, too.
    """
    here = jaw.aperture
    if abs(aperture - here) <= SAME_APERTURE or (jaw.is_holding and aperture < here):
        return
    moving = jaw.start_grab(aperture) if aperture < here else jaw.start_move(aperture)
    try:
        motion.wait_for(moving.future)
    except BaseException:
        moving.interrupt("stop")
        raise


class Gripper:
    """One jaw that opens and closes. A new motion takes over from the one under way.

    Args:
        executor: The I/O thread that moves it; owned by the rig.
        closed: Jaw angle at aperture 0 [rad].
        opened: Jaw angle at aperture 1 [rad].
        limits: How fast it moves, one joint.

    Attributes:
        closed: As given; changes with the calibration.
        opened: Likewise.
        limits: As given; for motions that start from now on.
    """

    def __init__(
        self,
        *,
        executor: Executor,
        closed: float = JAW_CLOSED,
        opened: float = JAW_OPEN,
        limits: MotionLimits = JAW_LIMITS,
    ) -> None:
        self.closed, self.opened, self.limits = closed, opened, limits
        self._executor = executor
        self._lock = threading.Lock()
        self._latest: Motion | None = None
        self._grabs = False  # whether the latest motion is a grab

    @property
    def q_jaw(self) -> float:
        """Measured jaw angle [rad]."""
        return self._executor.state.q_jaw

    @property
    def aperture(self) -> float:
        """How far it is open, from the measured jaw angle: 0 closed, 1 open."""
        return (self.q_jaw - self.closed) / (self.opened - self.closed)

    @property
    def is_moving(self) -> bool:
        """Whether a motion of the jaw is under way."""
        return self._executor.state.jaw_moving

    @property
    def is_holding(self) -> bool:
        """Whether the last grab got hold of something that is still there."""
        state = self._executor.state
        driven = state.mode in (Mode.HOLDING, Mode.MOVING, Mode.STOPPING)
        return (
            self._grabs
            and driven
            and not state.jaw_moving
            and state.q_jaw - state.q_jaw_ref >= GRIP
            and state.q_jaw - self.closed >= THINNEST
        )

    def start_move(self, aperture: float, *, limits: MotionLimits | None = None) -> Motion:
        """Open or close to ``aperture``.

        Args:
            aperture: Where to, 0 closed to 1 open.
            limits: How fast, this once; the gripper's own if None.

        Raises:
            ConfigError: Outside 0 to 1.
        """
        motion = Motion()
        running = self._begin_latest(motion, self.angle_of(aperture), limits, grabs=False)
        running.add_done_callback(motion.take_outcome)
        return motion

    def start_grab(self, aperture: float = 0.0, *, limits: MotionLimits | None = None) -> Motion:
        """Close until something is gripped or the jaw is closed; ``is_holding`` tells which.

        Args:
            aperture: What counts as closed.
            limits: How fast, this once; the gripper's own if None.
        """
        motion = Motion()
        running = self._begin_latest(motion, self.angle_of(aperture), limits, grabs=True)
        running.add_done_callback(partial(self._closed_or_met, motion))
        return motion

    def open_pursuit(self, aim: Callable[[Setpoint], TrackingTarget | None]) -> Pursuit:
        """Let the jaw follow a moving target; takes over from what is under way.

        Blocks until the jaw rests. Ends with ``FollowingError`` when the jaw meets something;
        ``start_grab`` then holds it.

        Args:
            aim: Says in every period where to go; see ``Pursuit``.

        Raises:
            Interrupted: A newer motion or a stop was asked for meanwhile.
            So101Error: The jaw cannot be moved now.
        """
        motion = Motion()
        with self._lock:
            previous, self._latest, self._grabs = self._latest, motion, False
        if previous is not None:
            previous.interrupt(SUPERSEDED)
        executor = self._executor
        executor.stop(Channel.JAW, by=SUPERSEDED).result()
        ends = sorted((self.closed, self.opened))
        pursuit = Pursuit(
            aim,
            q_start=np.array([executor.state.q_jaw_ref]),
            lower=np.array(ends[:1]),
            upper=np.array(ends[1:]),
            stop_limits=executor.stop_limits(Channel.JAW),
            dt=executor.dt,
        )
        motion.begin(lambda: executor.play(pursuit, channel=Channel.JAW).future, executor.interrupt)
        pursuit.future.add_done_callback(motion.take_outcome)
        return pursuit

    def regrip(self) -> None:
        """Press again on the gripped object, after the joints were held anew.

        Being held anew takes the force away, for every goal is then where its joint stands. The
        jaw moves by ``SQUEEZE`` at most, whatever has become of the thing.
        """
        with self._lock:
            if self._grabs and self.q_jaw - self.closed >= THINNEST:
                self._begin(Motion(), max(self.q_jaw - SQUEEZE, self.closed))

    def stop(self) -> None:
        """Slow to rest and hold; returns when the jaw is at rest. The arm is left alone."""
        self.start_stop().result()

    def start_stop(self) -> Future[None]:
        """Like ``stop``, but returns at once; completes when the jaw is at rest.

        A grab that has just met something does not press on it afterwards.
        """
        latest = self._latest
        if latest is not None:
            latest.interrupt("stop")
        return self._executor.stop(Channel.JAW)

    def angle_of(self, aperture: float) -> float:
        """The jaw angle [rad] that an aperture stands for.

        Raises:
            ConfigError: Outside 0 to 1.
        """
        if not 0.0 <= aperture <= 1.0:
            raise ConfigError("aperture", aperture, "must be between 0 (closed) and 1 (open)")
        return self.closed + aperture * (self.opened - self.closed)

    def _begin_latest(
        self, motion: Motion, q_goal: float, limits: MotionLimits | None, *, grabs: bool
    ) -> Future[None]:
        with self._lock:
            previous, self._latest, self._grabs = self._latest, motion, grabs
            running = self._begin(motion, q_goal, limits)
        if previous is not None:  # the jaw has turned already; what is only prepared must not begin
            previous.interrupt(SUPERSEDED)
        return running

    def _begin(
        self, motion: Motion, q_goal: float, limits: MotionLimits | None = None
    ) -> Future[None]:
        goal = np.array([q_goal])
        return motion.begin(
            lambda: self._executor.retarget(goal, limits or self.limits, channel=Channel.JAW),
            self._executor.interrupt,
        )

    def _closed_or_met(self, motion: Motion, done: Future[None]) -> None:
        if not isinstance(done.exception(), FollowingError):
            motion.take_outcome(done)
            return
        try:
            with self._lock:
                if self._latest is not motion:
                    raise Interrupted(SUPERSEDED)
                pressing = self._begin(motion, max(self.q_jaw - SQUEEZE, self.closed))
        except So101Error as error:
            motion.future.set_exception(error)
        else:
            pressing.add_done_callback(partial(self._pressed, motion))

    @staticmethod
    def _pressed(motion: Motion, done: Future[None]) -> None:
        if isinstance(done.exception(), FollowingError):
            motion.future.set_result(None)  # that it cannot get there is the grip
        else:
            motion.take_outcome(done)
