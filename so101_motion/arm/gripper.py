"""Move the gripper: an aperture from 0 (closed) to 1 (open), and a grip.

How a grab works. The jaw closes, and what is between the jaws stops it: it falls behind its
setpoints, and the executor then tells it to stay where it is. From there it is sent ``SQUEEZE``
further (or a share of it, see ``set_force``), which it cannot reach; the servo's position loop
turns that distance into a steady force that it can keep up without getting hot. As long as the jaw
stays short of its goal, something is held; when the thing slips out, the jaw closes the distance. A
jaw that was only late meets no resistance when it presses; it then closes further.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from numbers import Real
from typing import Protocol, Unpack

import so101_description

from so101_motion.arm.motion_handle import Motion
from so101_motion.arm.stop_order import NUMBERS, STOP, refuse_older
from so101_motion.common.attributes import checked_number
from so101_motion.common.errors import (
    SUPERSEDED,
    ConfigError,
    FollowingError,
    Interrupted,
    NotHolding,
    So101Error,
)
from so101_motion.common.geometry import is_finite
from so101_motion.common.modes import HELD
from so101_motion.common.public import Complete, explained
from so101_motion.common.state import GRIPPER_JOINT, JointState
from so101_motion.common.units import to_rad
from so101_motion.control.executor import Channel, Executor
from so101_motion.control.following import STALE_AFTER, Following, FollowingSettings
from so101_motion.control.motion_source import EndsWithBlock
from so101_motion.control.request_queue import running_future
from so101_motion.planning.timing.limits import MotionLimits, checked_limits

LET_GO = 0.03
"""A grip ends when the wanted aperture is wider than the jaw by this share of the travel; chosen:
more than a hand on a trigger trembles."""


class JawFollowing(EndsWithBlock):
    """A jaw that follows apertures, and grips what it closes on; made by ``Gripper.follow``.

    An object that stops a closing jaw is pressed with a steady force instead of ever harder. When
    the jaw is to open farther than it stands, or the object has slipped out, it follows again.

    Attributes:
        future: Completes when the jaw is at rest after ``close``, or raises why it ended earlier.
    """

    _name = "following"

    def __init__(
        self,
        gripper: Gripper,
        begin: Callable[[JawFollowing], Following],
        halt: Callable[[Future[None], str], object],
    ) -> None:
        self.future: Future[None] = running_future()
        self._gripper, self._begin, self._halt = gripper, begin, halt
        self._lock = threading.RLock()  # a following that ends at once calls back at once
        self._wanted: float | None = None
        self._grip: Future[None] | None = None  # completes when it presses; None while it follows
        self._closing = False
        self._follow()

    # Any thread

    def aim(self, aperture: float, rate: float = 0.0, *, most: float = 2.0) -> float:
        """Open or close to an aperture, from the next control cycle on; never waits.

        Args:
            aperture: How far, 0 closed to 1 open.
            rate: How fast that changes, shares of the travel [1/s].
            most: Values beyond it, either way, are taken for percent and refused; a hand's
                overshoot is less.

        Returns:
            The aperture as it was taken, within 0 to 1.

        Raises:
            ConfigError: These are not finite numbers, or the aperture is beyond ``most``; the one
                before stays.
            So101Error: The following has ended; the error says why.
        """
        try:
            values = [float(aperture), float(rate)]
        except (TypeError, ValueError):
            raise ConfigError("aperture", aperture, "must be a number from 0 to 1") from None
        if not is_finite(values):
            raise ConfigError("aperture", aperture, "must be finite, and so must its rate")
        if abs(values[0]) > most:
            raise ConfigError("aperture", aperture, f"must be from 0 to 1{_in_percent(values[0])}")
        taken = min(max(values[0], 0.0), 1.0)
        with self._lock:
            self._refuse_if_over()
            self._wanted = taken
            if self._grip is not None:
                lost = self._grip.done() and not self._gripper.is_holding
                if taken <= self._gripper.aperture + LET_GO and not lost:
                    return taken
                self._follow()
            gripper = self._gripper
            span = gripper.opened - gripper.closed
            self._following.aim([gripper.closed + taken * span], [values[1] * span])
        return taken

    def hold(self, *, briefly: bool = False) -> None:
        """Slow to rest and wait for the next aperture; a grip stays. Never waits.

        Args:
            briefly: As for ``Following.hold``.
        """
        with self._lock:
            self._following.hold(briefly=briefly)

    def regrip(self) -> None:
        """Press again on what is gripped, after the joints were held anew."""
        if self._grip is not None:
            self._gripper.regrip()

    def close(self) -> Future[None]:
        """Come to rest and end; what is gripped stays gripped. May be called again."""
        with self._lock:
            self._closing = True
            if self._grip is None:
                self._following.close()
            elif not self.future.done():
                self.future.set_result(None)
        return self.future

    @property
    def is_gripping(self) -> bool:
        """Whether it has closed on something that is still there."""
        return self._grip is not None and self._gripper.is_holding

    def interrupt(self, by: str) -> None:
        """End it early, at once when it grips, with ``Interrupted(by)``."""
        with self._lock:
            if self._grip is None:
                self._halt(self._following.future, by)
            else:
                self._end(Interrupted(by))

    # How

    def _follow(self) -> None:
        with self._lock:  # the I/O thread may ask for an aperture at once
            self._grip = None
            self._following = self._begin(self)
            self._following.future.add_done_callback(self._ended)

    def _ended(self, done: Future[None]) -> None:
        with self._lock:
            if done is not self._following.future:
                return
            error, wanted = done.exception(), self._wanted
            is_late = isinstance(error, FollowingError) and not self._closing
            if is_late and wanted is not None and wanted < self._gripper.aperture + LET_GO:
                self._grip = self._gripper.press()
            else:
                self._end(error)

    def _end(self, error: BaseException | None) -> None:
        if self.future.done():
            return
        if error is None:
            self.future.set_result(None)
        else:
            self.future.set_exception(error)


_CLOSED_TO_OPEN: tuple[float, float] = so101_description.ROBOT.limits[GRIPPER_JOINT]
JAW_CLOSED, JAW_OPEN = _CLOSED_TO_OPEN
"""Jaw angle at aperture 0 and at aperture 1 [rad]: the joint's limits in the robot description."""

JAW_LIMITS = MotionLimits.uniform(velocity=to_rad(220.0), acceleration=20.0, jerk=400.0, n=1)
"""How fast the jaw moves. Speed: the published simulated gripper's 200 % of the travel a second,
just under what the servo can do; acceleration and jerk: chosen."""

SQUEEZE = to_rad(2.0)
"""How far beyond the contact the jaw is sent [rad]: 23 ticks, which with a P gain of 32 make 19 %
of full drive: 0.6 A in the winding of the fitted 12 V servo, which warm it by 24 K, and 1.3 N m.
Chosen: 55 degC, where a servo is told to be hot, are then not reached in a room of 30 degC."""

GENTLEST = 0.6
"""The least share of ``SQUEEZE`` that a grip may be given; chosen: with less a grip would pass for
a jaw that rests, see ``GRIP``."""

GRIP = to_rad(0.9)
"""How far short of its goal the jaw stands at least while it grips [rad]; chosen: thrice what the
servo's dead band and friction leave."""

THINNEST = to_rad(1.5)
"""How far from closed the jaw must have been stopped [rad]: 2 mm between the tips. A jaw that
stands nearer is taken for closed, for calibrations end about there."""

NEAR = to_rad(5.0)
"""Within this distance of its target the jaw follows at full speed [rad]; chosen."""

SAME_APERTURE = 0.02
"""If the aperture is nearer than this to the wanted one, the jaw need not move; chosen."""


@dataclass(frozen=True)
class _JawMove:
    """Where a motion takes the jaw [rad], how fast, and whether it grabs."""

    q_goal: float
    limits: MotionLimits | None
    grabs: bool


class Jaw(Protocol):
    """What ``move_jaw`` needs of a jaw; see ``Gripper``."""

    @property
    def aperture(self) -> float: ...

    @property
    def is_holding(self) -> bool: ...

    def move(self, aperture: float, *, wait: bool = ...) -> Motion: ...
    def grab(self, aperture: float = ..., *, wait: bool = ...) -> Motion: ...


class JawVerbs(Complete):
    """What every jaw can be told in one word."""

    @explained("half open is move(0.5)")
    def open(self: Jaw, *, wait: bool = True) -> Motion:
        """Open as far as it goes."""
        return self.move(1.0, wait=wait)

    def close(self: Jaw, *, wait: bool = True) -> Motion:
        """Close; what is in between is gripped. It is ``grab`` by another name."""
        return self.grab(wait=wait)


def move_jaw(jaw: Jaw, aperture: float, motion: Motion) -> None:
    """Open or close a jaw while the arm rests, and wait for it; what it closes on is gripped.

    A jaw that holds something and is to close further goes on holding it. Ending ``motion``, the
    arm's, which this is part of, stops the jaw and raises ``Interrupted``.
    """
    here = jaw.aperture
    if abs(aperture - here) <= SAME_APERTURE or (jaw.is_holding and aperture < here):
        return
    moving = (jaw.grab if aperture < here else jaw.move)(aperture, wait=False)
    try:
        motion.wait_for(moving.future)
    except BaseException:
        moving.interrupt("stop")
        raise


class Gripper(JawVerbs):
    """One jaw that opens and closes. A new motion takes over from the one under way.

    In all methods ``limits`` are the caps of that motion, by default the gripper's own; with
    ``wait`` False a motion is returned at once.

    Attributes:
        closed: Jaw angle at aperture 0 [rad]; changes with the calibration.
        opened: Jaw angle at aperture 1 [rad]; likewise.
        limits: How fast it moves, one joint; for motions that start from now on.
        feels: Whether an object stops the jaw. A simulated jaw closes through all but the items of
            a scene; this is True from when there has been one.
        is_there: Whether its servo was found when the arm was opened.
    """

    _shown = (
        "aperture close feels follow force grab is_holding is_moving is_silent is_there limits "
        "move open set_force stop"
    )

    def __init__(self, executor: Executor) -> None:
        self.closed, self.opened, self.limits = JAW_CLOSED, JAW_OPEN, JAW_LIMITS
        self._executor = executor
        self._lock = threading.Lock()
        self._latest: Motion | None = None
        self._grabs = False  # whether the latest motion is a grab
        self._stopped = 0  # the number of the newest stop
        self._force = 1.0
        self.feels = self.is_there = True

    def __repr__(self) -> str:
        if self._executor.requests.has_ended:
            return "<Gripper of a closed arm>"
        return f"<Gripper {self.aperture:.0%} open{', holds a thing' * self.is_holding}>"

    def listen(self, listener: Callable[[JointState], None]) -> Callable[[], None]:
        """As ``Executor.listen``."""
        return self._executor.listen(listener)

    @property
    def q_jaw(self) -> float:
        """Measured jaw angle [rad]; like ``aperture``, ``ArmClosed`` once the arm is closed."""
        return self._executor.live_state.q_jaw

    @property
    def aperture(self) -> float:
        """How far it is open, from the measured jaw angle: 0 closed, 1 open."""
        return (self.q_jaw - self.closed) / (self.opened - self.closed)

    @property
    def is_silent(self) -> bool:
        """Whether its servo does not answer; its angle is then the last known."""
        return GRIPPER_JOINT in self._executor.state.reading.silent

    @property
    def is_moving(self) -> bool:
        """Whether a motion of the jaw is under way, until it has settled."""
        latest = self._latest
        return self._executor.state.jaw_moving or (latest is not None and not latest.future.done())

    @property
    def is_holding(self) -> bool:
        """Whether the last grab got hold of something that is still there."""
        state = self._executor.live_state
        driven = state.mode in HELD
        return (
            self._grabs
            and driven
            and not self.is_silent
            and not state.jaw_moving
            and state.q_jaw - state.q_jaw_ref >= GRIP
            and state.q_jaw - self.closed >= THINNEST
        )

    @property
    def force(self) -> float:
        """How hard a grip presses, as a share of what the servo can keep up."""
        return self._force

    def set_force(self, force: float) -> None:
        """Set how hard grips press; a grip under way changes at once.

        ``force`` is a share of what the servo can keep up, ``GENTLEST`` to 1; else ``ConfigError``.
        """
        self._force = checked_number("force", force, lower=GENTLEST, upper=1.0)
        latest = self._latest
        if self.is_holding and (latest is None or latest.future.done()):
            self.press()

    def move(
        self, aperture: float, *, limits: MotionLimits | None = None, wait: bool = True
    ) -> Motion:
        """Open or close to ``aperture``, 0 closed to 1 open; ``ConfigError`` outside of that.

        An object that it closes on is gripped, and ``is_holding`` becomes True; the motion then
        raises ``FollowingError``, because it has not arrived.
        """
        return self._start(_JawMove(self.angle_of(aperture), limits, grabs=False), wait)

    def grab(
        self, aperture: float = 0.0, *, limits: MotionLimits | None = None, wait: bool = True
    ) -> Motion:
        """Close until something is gripped or the jaw is closed, as ``aperture`` says.

        ``is_holding`` tells which.
        """
        return self._start(_JawMove(self.angle_of(aperture), limits, grabs=True), wait)

    def follow(
        self,
        *,
        limits: MotionLimits | None = None,
        approach: MotionLimits | None = None,
        stale_after: float | None = STALE_AFTER,
        each: Callable[[JawFollowing], None] | None = None,
    ) -> JawFollowing:
        """Let the jaw follow apertures; takes over from what is under way. Never waits.

        An object that it closes on is gripped with a steady force, and released when the jaw is to
        open.

        Args:
            limits: Caps.
            approach: Caps while a first aperture is far; ``limits`` if None.
            stale_after: After how long without a new aperture it brakes to rest [s]; None for
                never.
            each: Called with the following before every setpoint, on the I/O thread; must be brief.
        """

        def begin(jaw: JawFollowing) -> Following:
            hook = None if each is None else lambda _: each(jaw)
            following = self._following(
                limits, approach=approach, gate=NEAR, stale_after=stale_after, each=hook
            )
            with self._lock:
                self._grabs = False
            self._executor.turn(following, channel=Channel.JAW)
            return following

        motion = Motion()
        with self._lock:
            refuse_older(self._stopped)
            previous, self._latest = self._latest, motion
        with _failing(motion), motion.begin():
            jaw = JawFollowing(self, begin, self._executor.interrupt)
            motion.halt = jaw.interrupt
        jaw.future.add_done_callback(motion.take_outcome)
        if previous is not None:
            previous.interrupt(SUPERSEDED)
        return jaw

    def press(self) -> Future[None]:
        """Press with a steady force on what has stopped the jaw; completes when it presses.

        The jaw moves by ``SQUEEZE`` at most, even if the object is gone.
        """
        with self._lock:
            self._grabs = True
            return self._begin(Motion(), self._pressing)

    def regrip(self) -> None:
        """Press again on the gripped object, after the joints were held anew.

        Holding anew takes the force away, because it sets every goal to where its joint is. The
        jaw moves by ``SQUEEZE`` at most, even if the object is gone.
        """
        if self._grabs and self.q_jaw - self.closed >= THINNEST:
            self.press()

    def stop(self) -> None:
        """Slow to rest and hold; returns when the jaw is at rest. The arm is left alone."""
        self.start_stop().result()

    def start_stop(self) -> Future[None]:
        """Like ``stop``, but returns at once; completes when the jaw is at rest.

        A grab that has just met something does not press on it afterwards.
        """
        with self._lock:
            self._stopped = next(NUMBERS)
            latest = self._latest
        if latest is not None:
            latest.interrupt(STOP)
        return self._executor.stop(Channel.JAW)

    def angle_of(self, aperture: float) -> float:
        """The jaw angle [rad] that an aperture stands for; ``ConfigError`` outside 0 to 1."""
        if not isinstance(aperture, Real) or not 0.0 <= aperture <= 1.0:
            hint = _in_percent(aperture) if isinstance(aperture, Real) else ""
            raise ConfigError("aperture", aperture, f"must be a number from 0 (closed) to 1{hint}")
        return self.closed + aperture * (self.opened - self.closed)

    def _start(self, move: _JawMove, wait: bool) -> Motion:
        motion = Motion()
        with self._lock:
            refuse_older(self._stopped)
            previous, self._latest, self._grabs = self._latest, motion, move.grabs
            with _failing(motion):
                running = self._begin(motion, move.q_goal, move.limits)
        if previous is not None:  # it is superseded already; a prepared one must not begin
            previous.interrupt(SUPERSEDED)
        running.add_done_callback(partial(self._arrived_or_met, motion, move))
        if wait:
            motion.result()
        return motion

    @property
    def _pressing(self) -> float:
        """Where the jaw is sent to press on what it stands at [rad]."""
        return max(self.q_jaw - self._force * SQUEEZE, self.closed)

    def _begin(
        self, motion: Motion, q_goal: float, limits: MotionLimits | None = None
    ) -> Future[None]:
        following = self._following(limits, stale_after=None, ends_there=True)
        following.aim([q_goal])
        with motion.begin():
            running = self._executor.turn(following, channel=Channel.JAW)
            motion.halt = partial(self._executor.interrupt, running)
        return running

    def _following(
        self, limits: MotionLimits | None, **how: Unpack[FollowingSettings]
    ) -> Following:
        if not self.is_there:
            raise NotHolding(
                "gripper did not answer when the arm was opened; check its cable and power, then"
                " open the arm again"
            )
        executor, ends = self._executor, sorted((self.closed, self.opened))
        return Following(
            q_start=[executor.state.q_jaw_ref],
            lower=ends[:1],
            upper=ends[1:],
            limits=checked_limits(limits, 1) or self.limits,
            stop_limits=executor.stop_limits(Channel.JAW),
            dt=executor.dt,
            **how,
        )

    def _arrived_or_met(self, motion: Motion, move: _JawMove, done: Future[None]) -> None:
        """Press on what has stopped a jaw that closes."""
        error = done.exception()
        if not isinstance(error, FollowingError) or (
            not move.grabs and move.q_goal > self.q_jaw  # it opens
        ):
            motion.take_outcome(done)
            return
        pressed = partial(self._pressed, motion, move, None if move.grabs else error)
        self._go_on(motion, self._pressing, pressed, grabs=True)

    def _pressed(
        self, motion: Motion, move: _JawMove, missed: FollowingError | None, done: Future[None]
    ) -> None:
        """End with the grip; close further if there was nothing to press on.

        A jaw whose servo answers late misses its goal without an object, too.
        """
        state, error = self._executor.state, done.exception()
        grips = state.q_jaw - state.q_jaw_ref >= GRIP
        if not isinstance(error, FollowingError | None):
            motion.take_outcome(done)
        elif not grips and state.q_jaw_ref > move.q_goal:
            met = partial(self._arrived_or_met, motion, move)
            self._go_on(motion, move.q_goal, met, grabs=move.grabs, limits=move.limits)
        elif error is None or missed is None:
            motion.future.set_result(None)  # it cannot reach its goal: it grips
        else:
            motion.future.set_exception(missed)

    def _go_on(
        self,
        motion: Motion,
        q_goal: float,
        then: Callable[[Future[None]], None],
        *,
        grabs: bool,
        limits: MotionLimits | None = None,
    ) -> None:
        try:
            with self._lock:
                if self._latest is not motion:
                    raise Interrupted(SUPERSEDED)
                self._grabs = grabs
                running = self._begin(motion, q_goal, limits)
        except So101Error as refusal:
            motion.future.set_exception(refusal)
        else:
            running.add_done_callback(then)


def _in_percent(aperture: float) -> str:
    return f"; {aperture:g} % is {aperture / 100.0:g}" if 1.0 < aperture <= 100.0 else ""


@contextmanager
def _failing(motion: Motion) -> Iterator[None]:
    """End ``motion`` with what is raised in this block."""
    try:
        yield
    except BaseException as error:
        motion.future.set_exception(error)
        raise
