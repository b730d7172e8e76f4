"""Control the joints of one port, tick by tick: mode, torque, both channels, the snapshot."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from so101_motion.common.compliance import Compliance, Wall
from so101_motion.common.errors import (
    BusError,
    CommandRefused,
    FollowingError,
    MotionError,
    NoReply,
    NotHolding,
    NotReady,
    ServoAlarm,
    So101Error,
)
from so101_motion.common.modes import HELD, Event, Mode, after, can, refusal
from so101_motion.common.state import (
    ANSWERS_AGAIN,
    ARM_JOINTS,
    GRIPPER_JOINT,
    JointReading,
    JointState,
    in_fault,
    lent_out,
)
from so101_motion.control.channel_player import ChannelPlayer
from so101_motion.control.following import Following
from so101_motion.control.joint_group import Channel, JointDriver, Tolerances
from so101_motion.control.motion_source import MotionSource
from so101_motion.control.request_queue import Outcomes
from so101_motion.drivers.bus.ticks import RAD_PER_TICK
from so101_motion.drivers.goal_limiter import PAUSE
from so101_motion.drivers.position_check import SCATTER
from so101_motion.planning.collision.course import Neighbours
from so101_motion.planning.timing.limits import MotionLimits

T = TypeVar("T")

_log = logging.getLogger(__name__)

STANDSTILL = 1.0
"""After so long without a setpoint a motion is given up [s]. It could go on from where the joints
stand, but nobody expects that any more. Chosen: longer than a busy machine keeps us waiting."""

_LOOKS = 12
"""Most readings that are taken before joints are held. Chosen: with 7 % of the replies corrupt, one
of six joints stays without a confirmed reading once in a million times."""


_QUIET_AFTER = 2.0
"""For so long nothing must have happened at resting joints before they are looked at less often
[s]. Chosen: what the driver learns of their load at rest is learnt by then."""

_STIRS = SCATTER * RAD_PER_TICK
"""A resting joint has been moved if it is this far from where it was [rad]."""


SPAN = 1.0  # how long a time an error's states cover [s]


class RecentStates:
    """The joint states of the last second, and who is told of a failure; I/O thread only."""

    def __init__(self, dt: float) -> None:
        self.on_failure: Callable[[Exception, tuple[JointState, ...]], None] | None = None
        self._states: deque[JointState] = deque(maxlen=1 + round(SPAN / dt))
        self._notified: Exception | None = None

    def append(self, state: JointState) -> None:
        """Add the newest state; it replaces one of the same time."""
        if self._states and self._states[-1].t == state.t:
            self._states.pop()
        self._states.append(state)

    def last_second(self) -> tuple[JointState, ...]:
        """The states of the last second, oldest first; the first is the one that held then."""
        since = self._states[-1].t - SPAN if self._states else 0.0
        before = [state for state in self._states if state.t < since]
        held = (replace(before[-1], t=since),) if before else ()
        return (*held, *(state for state in self._states if state.t >= since))

    def notify(self, error: Exception, recent: tuple[JointState, ...]) -> None:
        is_new = error is not self._notified and not isinstance(error, NotReady)
        if self.on_failure is not None and is_new:
            self._notified = error
            try:
                self.on_failure(error, recent)
            except Exception:
                _log.exception("a failure was not recorded; the joints are not affected")


class JointController:
    """The joints of one port. Used by the I/O thread only, ``state`` excepted. Never waits.

    Args: as for ``Executor``.

    Attributes:
        mode: What the arm is doing.
        k: The number of the coming tick, counted from when something began to move.
        outcomes: Results of the futures, set at the end of a tick.
        state: The newest snapshot; None before ``start``. Replaced whole.
        recent: The states of the last second; reports failures.
    """

    def __init__(
        self,
        driver: JointDriver,
        *,
        dt: float,
        stop_limits: MotionLimits,
        tolerances: Tolerances,
        jaw_stop_limits: MotionLimits | None = None,
        jaw_tolerances: Tolerances | None = None,
    ) -> None:
        self.mode = Mode.LIMP
        self.k = 0
        self.state: JointState | None = None
        self._driver, self._dt = driver, dt
        self._fault: str | None = None
        self._is_silence = False  # whether the fault is that servos do not answer
        self._lent_to: str | None = None
        self._watch: Callable[[], None] | None = None
        self._rested = np.zeros(6)  # where the joints were when something happened last [rad]
        self._quiet_from = 0.0
        self._gap_level = logging.WARNING
        self.outcomes = Outcomes()
        self.recent = RecentStates(dt)

        def player(channel: Channel, limits: MotionLimits, tolerances: Tolerances) -> ChannelPlayer:
            return ChannelPlayer(
                channel,
                dt=dt,
                stop_limits=limits,
                tolerances=tolerances,
                conclude=self._conclude,
                recent=self.recent.last_second,
            )

        self._arm = player(Channel.ARM, stop_limits, tolerances)
        self._jaw = player(
            Channel.JAW,
            jaw_stop_limits or stop_limits.for_one(),
            jaw_tolerances or tolerances,
        )

    @property
    def is_moving(self) -> bool:
        """Whether a motion of either channel is under way, settling included."""
        return self._arm.is_moving or self._jaw.is_moving

    @property
    def is_busy(self) -> bool:
        """Whether the joints need every tick, not only an occasional reading."""
        return self.is_moving or self.mode is Mode.GUIDING or self._watch is not None

    def is_quiet(self, now: float) -> bool:
        """Whether nothing has happened for a while, so that a look now and then will do."""
        return self.mode in (Mode.HOLDING, Mode.LIMP) and now >= self._quiet_from

    def stop_limits(self, channel: Channel) -> MotionLimits:
        return self._player(channel).stop_limits

    def set_stop_limits(self, limits: MotionLimits) -> None:
        """Brake the arm within ``limits`` from the next stop on; from any thread."""
        self._arm.stop_limits = limits

    def keep_off(self, neighbours: Neighbours | None) -> None:
        """Keep the arm off other arms in every tick; None ends that."""
        self._arm.neighbours = neighbours

    def start(self, now: float, *, holding: bool) -> None:
        """Read the joints, hold them there if ``holding``, and publish the first snapshot."""
        if holding:
            self._seed()
        self.tick(now, 0)

    def play(self, source: MotionSource, channel: Channel) -> None:
        """Play ``source`` from the coming tick on, or raise why that is not possible."""
        self._require(Event.MOVE, channel)
        self._player(channel).begin(source, self.k)
        self._enter(Event.MOVE)

    def turn(self, following: Following, channel: Channel) -> None:
        """Let ``following`` take over from what is under way, or raise why that cannot be."""
        self._require(Event.MOVE, channel)
        self._player(channel).turn(following, self.k)
        self._enter(Event.MOVE)

    def stop(self, channels: Collection[Channel], by: str, waiting: Future[None]) -> None:
        """Slow ``channels`` down; ``waiting`` completes when all are at rest."""
        if self.mode is Mode.GUIDING and Channel.ARM in channels:
            try:
                self.hold()
            except Exception as error:
                self.outcomes.conclude(waiting, error)
                return
        players = [self._player(channel) for channel in channels]
        self.outcomes.expect(waiting, len(players))
        try:
            for player in players:
                player.stop(by, waiting)
        except Exception as error:  # no ramp to rest: stay at the last setpoint
            self.fail(error)
            self.outcomes.conclude(waiting, error)

    def interrupt(self, motion: Future[Any], by: str, waiting: Future[None]) -> None:
        """End ``motion`` if it is under way; ``waiting`` completes when it is over."""
        for player in (self._arm, self._jaw):
            if player.is_playing(motion):
                player.stop(by, waiting)
                return
        self.outcomes.conclude(waiting)

    def hold(self) -> None:
        """Switch torque on where the joints are; does nothing if it is on already."""
        if self.mode in HELD:
            return
        self._require(Event.HOLD)
        with self._failing():
            if self.mode is not Mode.GUIDING:
                self._seed()
                return
            reading = self._looked()
            self._driver.guide(None)
            self._arm.rest_at(reading.q)
        self._enter(Event.HOLD)
        if self._jaw.is_moving:
            self._enter(Event.MOVE)

    def guide(self, compliance: Compliance, wall: Wall | None = None) -> None:
        """Let the arm yield to a hand, up to ``wall``; a limp one is held first, where it is."""
        self._require(Event.GUIDE)
        with self._failing():
            if self.mode is Mode.LIMP:
                self._seed()
            self._looked()
            self._driver.guide(compliance, wall)
        self._enter(Event.GUIDE)

    def release(self) -> None:
        """Switch torque off; ``MotionError`` while something moves."""
        self._require(Event.RELEASE)
        if self.is_moving:
            raise MotionError("the jaw is moving; stop it or wait for its end")
        with self._failing():
            self._driver.set_torque(False)
        self._enter(Event.RELEASE)
        self._fault = None

    def call(self, job: Callable[[JointDriver], T]) -> T:
        """Run ``job`` with the driver; ``MotionError`` while something moves or the bus is lent."""
        self._refuse_lent()
        if self.is_moving:
            raise MotionError("the bus is busy with a motion; stop it or wait for its end")
        return job(self._driver)

    def call_and_rehold(self, job: Callable[[JointDriver], T]) -> T:
        """Run a job that changes what the driver's angles mean, and hold the joints anew."""
        if self.mode is Mode.GUIDING and not self.is_moving:
            self.hold()
        try:
            return self.call(job)
        finally:  # even a job that failed may have left a driver that knows no goal yet
            if self.mode is Mode.HOLDING:
                with self._failing():
                    self._seed()

    def lend(self, purpose: str, job: Callable[[JointDriver], None]) -> None:
        """Lend the bus for ``purpose``; until ``take_back`` all other requests are refused.

        ``job`` makes the driver leave the servos alone. ``MotionError`` while something moves, or
        if the bus is lent already.
        """
        self._require(Event.CALIBRATE)
        job(self._driver)
        self._enter(Event.CALIBRATE)
        self._lent_to, self._fault = purpose, None

    def watch(self, job: Callable[[], None] | None) -> None:
        """Run ``job`` in every tick for the borrower of the bus; None ends that."""
        self._watch = job

    def take_back(self, job: Callable[[JointDriver], bool | None]) -> None:
        """Take the bus back, whatever ``job`` or the driver raises.

        ``job`` makes the servos ours again; it returns whether to hold them, to let go of them, or
        to leave them as they are (None).
        """
        self._watch = self._lent_to = None
        self._enter(Event.DONE)
        with self._failing():
            holds = job(self._driver)
            if holds:
                self._seed()
            elif holds is not None:
                self._driver.set_torque(False)

    def close(self) -> None:
        self._driver.close()

    def tick(self, now: float, late: int, missed: int = 0) -> None:
        """Run one tick: write, read, publish, check.

        Args:
            now: The time [s].
            late: How many ticks have been left out since the start.
            missed: How many of them just before this one.
        """
        arm, jaw = self._arm, self._jaw
        if missed:
            for player in (arm, jaw):
                player.run_on((missed + 1) * self._dt)
            if missed * self._dt > PAUSE and self.is_moving:
                self._go_on_from_rest((missed + 1) * self._dt)
        if arm.is_moving or jaw.is_moving:
            arm.step(self.k)
            if jaw.is_moving:
                jaw.step(self.k)
            try:
                self._driver.write(arm.command, float(jaw.command[0]), *arm.order)
            except CommandRefused as refused:
                if arm.lost is None:
                    raise
                raise arm.lost from refused  # a joint did not follow, and is elsewhere by now
        if self._watch is not None:
            self._watch()
        reading = self._driver.read()
        if self.mode in (Mode.LIMP, Mode.CALIBRATING):
            self._rest_at(reading)
        elif self.mode is Mode.GUIDING:
            self._arm.rest_at(reading.q)
        arm.update(reading.q, reading)
        if jaw.is_moving or jaw.recovery.is_needed or reading.out_of_range:
            jaw.update(np.array([reading.q_jaw]), reading)
        if reading.alarms and self.mode is Mode.HOLDING:
            missing = reading.unanswered | reading.unconfirmed
            if missing.isdisjoint(ARM_JOINTS) and self._arm.yield_to_push(
                reading.alarms, reading.let_go, reading.q
            ):  # joints that were pushed until their servo gave up stay; the jaw's grip does, too
                self._driver.write(self._arm.command, float(self._jaw.command[0]))
        if self._is_silence and self._fault is not None and not reading.unanswered:
            self._fault = ANSWERS_AGAIN
        if arm.is_moving or jaw.is_moving:
            self._quiet_from = now + _QUIET_AFTER
        else:
            self._note_events(reading, now)
        self.state = JointState(
            t=now,
            mode=self.mode,
            reading=reading,
            q_ref=arm.reference.q,
            qd_ref=arm.reference.qd,
            q_jaw_ref=float(jaw.reference.q[0]),
            arm_moving=arm.is_moving,
            jaw_moving=jaw.is_moving,
            late_ticks=late,
            fault=self._fault,
            lent_to=self._lent_to,
        )
        self.recent.append(self.state)
        if reading.unconfirmed.isdisjoint(ARM_JOINTS):
            self._arm.check(reading.q, reading.qd, reading.alarms)
        if jaw.is_moving and GRIPPER_JOINT not in reading.unconfirmed:
            q_jaw, qd_jaw = np.array([reading.q_jaw]), np.array([reading.qd_jaw])
            jaw.check(q_jaw, qd_jaw, reading.alarms)
        if self.mode in (Mode.MOVING, Mode.STOPPING):
            if not (arm.is_moving or jaw.is_moving):
                self._enter(Event.REST)
            elif arm.is_moving <= arm.is_stopping and jaw.is_moving <= jaw.is_stopping:
                self._enter(Event.STOP)
        self._republish()

    def fail(self, error: Exception) -> None:
        """Enter FAULT and end all motions with ``error``, because the joints cannot be reached."""
        if self.mode is Mode.GUIDING:
            with suppress(Exception):  # what can still be reached holds where it is
                self._driver.guide(None)
        if can(self.mode, Event.FAIL):
            is_ours = isinstance(error, So101Error)  # its message says all that a person needs
            self.recent.notify(error, self.recent.last_second())
            _log.error("the arm is in a fault: %s", error, exc_info=None if is_ours else error)
            self._enter(Event.FAIL)
        self._fault = str(error) or type(error).__name__
        self._is_silence = isinstance(error, NoReply)
        for player in (self._arm, self._jaw):
            player.fail(error)
        self._republish()

    # How

    def _player(self, channel: Channel) -> ChannelPlayer:
        return self._arm if channel is Channel.ARM else self._jaw

    @contextmanager
    def _failing(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            self.fail(error)
            raise

    def _seed(self) -> None:
        try:
            self._hold_at(self._looked())
        except NoReply:  # this machine may have stood still since that look
            self._hold_at(self._looked())

    def _hold_at(self, reading: JointReading) -> None:
        self._rest_at(reading)
        self._driver.write(reading.q, reading.q_jaw)
        self._driver.set_torque(True)
        self._enter(Event.HOLD)
        self._fault = None

    def _note_events(self, reading: JointReading, now: float) -> None:
        if not (
            self.state is None
            or self.state.mode is not self.mode
            or reading.alarms
            or reading.out_of_range
            or reading.unanswered
            or reading.unconfirmed
        ):
            q = np.append(reading.q, reading.q_jaw)
            if np.abs(q - self._rested).max() <= _STIRS:
                return
            self._rested = q
        self._quiet_from = now + _QUIET_AFTER

    def _looked(self) -> JointReading:
        """Read the joints until two readings of each agree."""
        reading = self._driver.read()
        missing = reading.unanswered | reading.unconfirmed
        for _ in range(_LOOKS - 1):
            if not missing:
                break
            reading = self._driver.read()
            missing &= reading.unanswered | reading.unconfirmed
        return reading

    def _rest_at(self, reading: JointReading) -> None:
        self._arm.rest_at(reading.q)
        self._jaw.rest_at(np.array([reading.q_jaw]))

    def _go_on_from_rest(self, gap: float) -> None:
        """Go on, or give up, because the joints came to rest while no setpoint was sent."""
        words = "no setpoint was sent for %.2f s in mid-motion; later gaps are counted (late_ticks)"
        _log.log(self._gap_level, words, gap)
        self._gap_level = logging.DEBUG  # a busy machine is late again and again
        error = MotionError(
            f"no setpoint could be sent for {gap:.2f} s, so the arm stopped where it was;"
            " look for what keeps this machine or the bus busy, then move again"
        )
        for player in (self._arm, self._jaw):
            if gap > STANDSTILL:
                player.halt(error)
            else:
                player.resume(error)

    def _require(self, event: Event, channel: Channel | None = None) -> None:
        if self.mode is Mode.GUIDING and event is Event.MOVE and channel is Channel.ARM:
            raise NotHolding("the arm is guided by hand; leave manual mode first")
        if can(self.mode, event):
            if event is Event.MOVE and channel is Channel.JAW:
                self._refuse_silent_jaw()
            if event is Event.MOVE and channel is not None and self.state is not None:
                self.state.reading.check_held(channel.joints)
            return
        self._refuse_lent()
        if self.mode is Mode.FAULT:
            raise NotHolding(in_fault(self._fault))
        silent = sorted(self.state.reading.unanswered) if self.state else []
        if self.mode is Mode.LIMP and silent:
            raise NotHolding(_silent(silent))
        if self.mode is Mode.LIMP:
            raise NotHolding("the arm is limp; let it hold first (arm.set_torque(True), or Hold)")
        raise MotionError(refusal(self.mode, event))

    def _refuse_silent_jaw(self) -> None:
        """Refuse to move a jaw whose servo does not answer: where it stands is not known."""
        is_silent = self.state is not None and GRIPPER_JOINT in self.state.reading.unanswered
        for _ in range(2):  # one answer that was lost is no reason
            if is_silent:
                with self._failing():
                    is_silent = GRIPPER_JOINT in self._driver.read().unanswered
        if is_silent:
            raise BusError(_silent([GRIPPER_JOINT]))

    def _refuse_lent(self) -> None:
        if self._lent_to is not None:
            raise MotionError(lent_out(self._lent_to))

    def _enter(self, event: Event) -> None:
        self.mode = after(self.mode, event)

    def _republish(self) -> None:
        """Say in the newest snapshot what has become of it since."""
        state, arm_moving, jaw_moving = self.state, self._arm.is_moving, self._jaw.is_moving
        if state is not None and not (
            state.mode is self.mode
            and state.arm_moving == arm_moving
            and state.jaw_moving == jaw_moving
            and state.fault == self._fault
            and state.lent_to == self._lent_to
        ):
            self.state = replace(
                state,
                mode=self.mode,
                arm_moving=arm_moving,
                jaw_moving=jaw_moving,
                fault=self._fault,
                lent_to=self._lent_to,
            )

    def _conclude(self, future: Future[Any], error: BaseException | None = None) -> None:
        if isinstance(error, FollowingError | ServoAlarm):
            self.recent.notify(error, error.recent)
        self.outcomes.conclude(future, error)


def _silent(joints: Sequence[str]) -> str:
    return (
        f"{', '.join(joints)} does not answer; check its cable and the arm's power supply, then let"
        " the arm hold"
    )
