"""Play the motion of one channel, the arm's five joints or the jaw, and check that joints follow.

Once a tick the executor calls ``step`` of a ``ChannelPlayer``, which gives the setpoint, and then
``check`` with the measured joints. ``reference`` is the last setpoint; a stop or a new goal starts
from there, so nothing jumps. A motion goes through at most three stages::

    playing --last setpoint--> settling --error and velocity small--> over
       |                          |
       +--stop, or a joint left behind--> slowing down --velocity small--> over

Before the first, a motion waits for joints outside their limits: see ``limit_recovery.py``. In the
second row ``ending`` is set, the error that the motion's future will raise. Futures are handed to
``conclude``, because the executor completes them after the snapshot that shows their effect.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.errors import (
    SUPERSEDED,
    FollowingError,
    Interrupted,
    MotionError,
    ServoAlarm,
)
from so101_motion.common.geometry import Array
from so101_motion.common.state import JointReading, JointState
from so101_motion.common.units import to_deg, to_rad
from so101_motion.control.following import Following
from so101_motion.control.following_check import FollowingCheck
from so101_motion.control.joint_group import Channel, Tolerances
from so101_motion.control.limit_recovery import RECOVERY_TIME, LimitRecovery
from so101_motion.control.motion_source import MotionSource, OpenEndedMotion, PlannedMotion
from so101_motion.control.streamed_trajectory import Stream
from so101_motion.planning.collision.course import Neighbours
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Setpoint

JUMP = 1e-4
"""How far the first setpoint of a motion may be from the reference [rad], and how much faster
[rad/s]. Chosen: a fifteenth of what the servo resolves, far above rounding."""


def refuse_jump(joints: Sequence[str], jump: Array, unit: str) -> None:
    """Refuse a first setpoint that is ``jump`` [rad] or [rad/s], shape (n,), off the joints."""
    i = int(np.argmax(np.abs(jump)))
    if abs(jump[i]) > JUMP:
        raise MotionError(
            f"{joints[i]} would jump by {to_deg(float(jump[i])):.3g} {unit}:"
            " this motion does not begin where the arm is; plan again from there"
        )


_PUSHED = to_rad(3.0)
"""A resting joint this far from its goal was pushed [rad]; chosen, ten times the droop."""

_REST = 0.2
"""A motion rests so long before it goes on, if joints have missed goals [s]; chosen: emulated ones
are where they should be by then."""

_log = logging.getLogger(__name__)

_NO_ALARMS: Mapping[str, str] = {}


@dataclass(slots=True, kw_only=True)
class _Motion:
    source: MotionSource
    start: int | None  # the tick of its first setpoint; None while it waits for joints outside
    ending: MotionError | None = None
    waiting: list[Future[None]] = field(default_factory=list)  # of those who asked it to stop
    still: int = 0  # ticks at rest in a row
    last: int | None = None  # the tick of its last setpoint
    waits_until: int | None = None  # until which tick it may wait for joints to come inside
    lost: NDArray[np.bool_] | None = None  # joints that did not follow; they stay where they are


class ChannelPlayer:
    """Plays the motions of one channel, one at a time. Used by the I/O thread only.

    Args:
        channel: Which channel.
        dt: The period of the ticks [s].
        stop_limits: Caps of a stop, one entry a joint.
        tolerances: When a motion has arrived, and when it is lost.
        conclude: Called with a future and the error that it shall raise, None for success.
        recent: Returns the states of the last second, for an error to carry.

    Attributes:
        neighbours: Other arms to keep off; None if there are none.
        is_moving: Whether a motion is under way, settling included.
        recovery: Joints outside their limits.
    """

    def __init__(
        self,
        channel: Channel,
        *,
        dt: float,
        stop_limits: MotionLimits,
        tolerances: Tolerances,
        conclude: Callable[[Future[Any], BaseException | None], None],
        recent: Callable[[], tuple[JointState, ...]],
    ) -> None:
        self._channel, self._dt, self.stop_limits = channel, dt, stop_limits
        self._joints = channel.joints
        self._tolerances, self._conclude, self._recent = tolerances, conclude, recent
        self.neighbours: Neighbours | None = None
        self._motion: _Motion | None = None
        self.is_moving = False
        self._k = 0  # the tick that ``reference`` was commanded in
        self.reference = Setpoint.at_rest(np.zeros(len(channel.joints)))
        self.recovery = LimitRecovery(channel.joints)
        self._following = FollowingCheck(tolerances, dt)
        self._unanswered: frozenset[str] = frozenset()
        self._in_play: Mapping[str, float] = {}

    @property
    def is_stopping(self) -> bool:
        """Whether the motion under way is being brought to rest early."""
        return self._motion is not None and self._motion.ending is not None

    @property
    def lost(self) -> MotionError | None:
        """Why the motion is ending where joints did not follow; None if it does not end so."""
        motion = self._motion
        return None if motion is None or motion.lost is None else motion.ending

    def is_playing(self, future: Future[Any]) -> bool:
        return self._motion is not None and self._motion.source.future is future

    @property
    def command(self) -> Array:
        """The command of this tick, shape (n,), [rad].

        A joint outside its limits stays where it is unless a motion brings it in.
        """
        motion = self._motion
        if not self.recovery.is_needed or (motion is not None and motion.ending is None):
            return self.reference.q
        return self.recovery.left_alone(self.reference.q)

    @property
    def order(self) -> tuple[Array, Array | None, bool, float]:
        """What the driver is told beside the command.

        Its velocity, shape (n,), [rad/s], NaN for a joint that did not follow; the acceleration
        expected from now on, shape (n,), [rad/s^2], None if it is not known; whether it follows
        targets instead of a planned motion; and by which share that may be faster for a moment.
        """
        motion, now = self._motion, self.reference
        if motion is None:
            return now.qd, now.qdd, False, 0.0
        qd = now.qd if motion.lost is None else np.where(motion.lost, np.nan, now.qd)
        if isinstance(motion.source, PlannedMotion):
            return qd, motion.source.acceleration, False, motion.source.room
        if isinstance(motion.source, Following):
            return qd, motion.source.expected_acceleration.qdd, True, 0.0
        return qd, None, False, 0.0

    def rest_at(self, q: Array) -> None:
        self.reference = Setpoint.at_rest(q)

    def update(self, q: Array, reading: JointReading) -> None:
        """Note the measured angles, shape (n,), [rad], and what else was read."""
        self._unanswered, self._in_play = reading.unanswered, reading.in_play
        recovery = self.recovery
        if reading.out_of_range or recovery.is_needed:
            recovery.update(q, reading.out_of_range)
            if recovery.is_needed and self._motion is None:
                self.reference = Setpoint.at_rest(recovery.inside(self.reference.q))

    def yield_to_push(self, alarms: Mapping[str, str], let_go: Collection[str], q: Array) -> bool:
        """Let a resting joint with an alarm stay where it was pushed; whether there is one.

        One that has ``let_go`` is followed exactly, so that its servo holds it there later.
        """
        if self._motion is not None:
            return False
        names, off = self._joints, np.abs(q - self.reference.q)
        pushed = np.isin(names, list(alarms)) & (off > _PUSHED)
        pushed |= np.isin(names, list(let_go)) & (off > 0.0)
        pushed &= ~self.recovery.mask
        if pushed.any():
            self.reference = Setpoint.at_rest(np.where(pushed, q, self.reference.q))
        return bool(pushed.any())

    # Beginning and ending

    def begin(self, source: MotionSource, k: int) -> None:
        """Play ``source`` from tick ``k`` on; refused if it begins elsewhere, or another plays."""
        if self._motion is not None:
            raise MotionError(
                f"another motion of the {self._channel.value} is under way;"
                " stop it or wait for its end"
            )
        if not source.can_wait:
            self.recovery.refuse()
        self.recovery.refuse_far()
        first = source.start
        refuse_jump(self._joints, first.q - self.reference.q, "deg")
        refuse_jump(self._joints, first.qd - self.reference.qd, "deg/s")
        self._get_ready(_Motion(source=source, start=k), k - 1)

    def turn(self, following: Following, k: int) -> None:
        """Let ``following`` take over from the present reference; ``MotionError`` during a stop."""
        previous = self._motion
        if previous is not None and previous.ending is not None:
            raise MotionError(
                f"the {self._channel.value} is being stopped; ask again when it is at rest"
            )
        self.recovery.refuse_far()
        following.take_over(self.reference, previous.source if previous else None, self.stop_limits)
        start = k if previous is None else self._k
        self._get_ready(_Motion(source=following, start=start), start)
        if previous is not None:
            self._conclude(previous.source.future, Interrupted(SUPERSEDED))

    def stop(self, by: str, waiting: Future[None] | None = None) -> None:
        """Slow down to rest, along the motion's own path where possible.

        A stop that is already under way keeps its first reason. ``waiting`` completes at rest.
        """
        motion = self._motion
        if motion is None:
            if waiting is not None:
                self._conclude(waiting, None)
            return
        if waiting is not None:
            motion.waiting.append(waiting)
        if motion.ending is None:
            self._slow_down(motion, Interrupted(by))

    def halt(self, error: MotionError) -> None:
        """End the motion where the joints stand, because no command went out for too long."""
        motion = self._motion
        if motion is not None and motion.last is None:
            self.reference = Setpoint.at_rest(self.reference.q)
            self._stop_alone(motion)
            motion.ending, motion.waits_until = motion.ending or error, None

    def resume(self, error: MotionError) -> None:
        """Go on from rest, because the joints came to rest while no command went out.

        A motion that cannot go on from the middle ends with ``error``.
        """
        motion = self._motion
        if motion is None or motion.last is not None or not self.reference.qd.any():
            return
        source = motion.source
        resumed: MotionSource | None = None
        if isinstance(source, Following):
            source.take_over(Setpoint.at_rest(self.reference.q), None, self.stop_limits)
            resumed = source
        elif isinstance(source, PlannedMotion) and motion.ending is None:
            resumed = source.resumed()
        if resumed is None:
            self.halt(error)
        else:
            self.reference = Setpoint.at_rest(self.reference.q)
            motion.source, motion.start = resumed, self._k

    def fail(self, error: BaseException) -> None:
        motion, self._motion, self.is_moving = self._motion, None, False
        if motion is not None:
            for future in (motion.source.future, *motion.waiting):
                self._conclude(future, error)

    # Ticking

    def step(self, k: int) -> None:
        """Move ``reference`` to where the motion wants it in tick ``k``."""
        motion = self._motion
        if motion is None:
            return
        if motion.waits_until is not None and not self.recovery.is_needed:
            motion.start, motion.waits_until = k, None
        if motion.last is None and motion.start is not None:
            try:
                setpoint = motion.source.sample(k - motion.start)
                if self.neighbours is not None:
                    self._refuse_near(motion, setpoint, self.neighbours)
                self.reference = setpoint
            except MotionError as error:
                self._slow_down(motion, error)
                self.reference = motion.source.sample(k - self._k)
            motion.last = k if motion.source.is_over else None
        self._k = k
        self._following.want(self.reference.q)

    def run_on(self, gap: float) -> None:
        """Expect the joints farther on, because no setpoint was sent for ``gap`` [s]."""
        self._following.run_on(self.reference.q, self.reference.qd, gap)

    def check(self, q: Array, qd: Array, alarms: Mapping[str, str] = _NO_ALARMS) -> None:
        """Compare measured joints, ``q`` [rad] and ``qd`` [rad/s], shapes (n,), with the reference.

        May end the motion. ``alarms`` says what is wrong with a joint, by name.
        """
        motion = self._motion
        if motion is None:
            return
        if motion.ending is None:
            if alarms and self._obey(motion, alarms, q):
                return
            held_up, in_play, silent = 0, self._in_play, self._unanswered
            if isinstance(motion.source, PlannedMotion):  # the others lag too much to tell
                strays = [in_play.get(joint, 0.0) for joint in self._joints] if in_play else None
                silent_too = bool(silent) and silent >= {*self._joints}
                held_up = self._following.held_up(q, strays, silent=silent_too)
            waits = motion.waits_until is not None
            if (waits or held_up or not self._following.is_near(q)) and self._is_over(
                motion, q, held_up
            ):
                return
        if motion.last is not None:
            self._settle(motion, motion.last, q, qd)

    # How

    def _is_over(self, motion: _Motion, q: Array, held: int) -> bool:
        """End the motion if a joint does not follow; whether there is no more to check."""
        off, held_up = self._following.off(q), (held >> np.arange(len(q)) & 1).astype(np.bool_)
        if held_up.any() and self._following.silence and self._rest_a_while(motion):
            return True
        if motion.waits_until is not None:
            mask = self.recovery.mask
            if self._k > motion.waits_until:
                joint, away = self.recovery.farthest()
                error = self._missed(
                    joint,
                    away,
                    "was outside its calibrated range and did not come in:"
                    f" {to_deg(away):.1f} deg are missing; check what blocks it, or move it inside"
                    " by hand",
                )
                self._give_way(motion, mask, q, error)
                return True
            off[mask], held_up[mask] = 0.0, False
        lost = held_up | (off > self._tolerances.following_error)
        if lost.any():
            self._give_way(motion, lost, q, self._lost(np.where(lost, off, -np.inf), held_up))
        return bool(lost.any())

    def _get_ready(self, motion: _Motion, k: int) -> None:
        """Prepare what ``motion`` needs from tick ``k`` on."""
        if self._motion is None:
            self._following.begin(self.reference.q)
            if self.neighbours is not None:  # until it asks for more, it stands here
                self.neighbours.commit(self.reference.q[None], self._dt)
        if self.recovery.is_needed:
            motion.start, motion.waits_until = None, k + round(RECOVERY_TIME / self._dt)
        self._motion, self.is_moving, self._k = motion, True, k

    def _refuse_near(self, motion: _Motion, setpoint: Setpoint, neighbours: Neighbours) -> None:
        """Refuse a setpoint from which the joints could not stop without coming near other arms."""
        source = motion.source
        if motion.ending is not None:
            return
        if isinstance(source, (PlannedMotion, Stream)):
            admitted = neighbours.admits(*source.stop_ahead())
        elif isinstance(source, OpenEndedMotion) and source.keeps_apart:
            return
        else:
            stop = source.brake(setpoint, self.stop_limits)
            admitted = neighbours.admits(stop.q, stop.dt)
        if not admitted:
            raise MotionError(
                f"the arm stopped with {neighbours.against}; move one of them away, then plan again"
            )

    def _slow_down(self, motion: _Motion, ending: MotionError) -> None:
        motion.ending, motion.waits_until = ending, None
        if motion.last is not None:
            return  # the reference is at rest; what remains is that the joints follow
        stop = motion.source.brake(self.reference, self.stop_limits)
        if self.neighbours is not None:
            self.neighbours.commit(stop.q, stop.dt)
        motion.source, motion.start = PlannedMotion(stop, motion.source.future), self._k

    def _obey(self, motion: _Motion, alarms: Mapping[str, str], q: Array) -> bool:
        joints = self._joints
        troubled = [joint for joint in joints if joint in alarms]
        if troubled:
            error = ServoAlarm(troubled[0], alarms[troubled[0]], recent=self._recent())
            self._give_way(motion, np.isin(joints, troubled), q, error)
        return bool(troubled)

    def _rest_a_while(self, motion: _Motion) -> bool:
        """Slow down, rest and go on, because joints have missed goals; False if that cannot be."""
        source = motion.source
        relied_on = self.neighbours is not None and self.neighbours.can_meet
        if relied_on or not isinstance(source, PlannedMotion):
            return False  # other arms rely on when this one will be where
        if motion.last is None:
            paused = source.paused(self.stop_limits, _REST)
            if paused is None:
                return False
            motion.source, motion.start = paused, self._k
        _log.warning("the %s missed its goals; it rests and goes on", self._channel.value)
        self._following.forgive()
        return True

    def _lost(self, off: Array, held_up: NDArray[np.bool_]) -> FollowingError:
        i, channel = int(np.argmax(off)), self._channel
        happened, check = self._following.words(i, held_up=bool(held_up[i]))
        return self._missed(
            self._joints[i],
            float(off[i]),
            f"{happened} {to_deg(float(off[i])):.1f} deg from where it should be; the"
            f" {channel.value} stopped and holds. Check {check}, then move again",
        )

    def _missed(self, joint: str, off: float, happened: str) -> FollowingError:
        return FollowingError(f"{joint} {happened}", joint=joint, error=off, recent=self._recent())

    def _give_way(
        self, motion: _Motion, lost: NDArray[np.bool_], q: Array, error: MotionError
    ) -> None:
        """Stop because of some joints, and leave those where they are.

        Otherwise their servos would press with full force against what blocks them. A joint that
        did not answer now stops like the others, because its position is not known.
        """
        lost = lost & ~np.isin(self._joints, list(self._unanswered))
        now = self.reference
        self.reference = Setpoint(
            q=np.where(lost, q, now.q),
            qd=np.where(lost, 0.0, now.qd),
            qdd=np.where(lost, 0.0, now.qdd),
        )
        motion.ending, motion.last, motion.waits_until, motion.lost = error, None, None, lost
        self._stop_alone(motion)

    def _stop_alone(self, motion: _Motion) -> None:
        """Let each joint stop by itself, from the reference on."""
        now = self.reference
        stop = online.stop(now.q, now.qd, now.qdd, self.stop_limits, self._dt)
        motion.source, motion.start = PlannedMotion(stop, motion.source.future), self._k

    def _settle(self, motion: _Motion, last: int, q: Array, qd: Array) -> None:
        limits, passed = self._tolerances, (self._k - last) * self._dt
        is_late = passed > 0.5 * limits.settle_timeout
        near = max(limits.settle_position, limits.late_position if is_late else 0.0)
        off, speed = np.abs(q - self.reference.q), np.abs(qd)
        # A motion that was cut short only has to be at rest, wherever it is.
        arrived = motion.ending is not None or bool(np.max(off) <= near)
        still = arrived and bool(np.max(speed) <= limits.settle_velocity)
        motion.still = motion.still + 1 if still else 0
        if motion.still >= limits.settle_ticks:
            self._finish(motion, None)
        elif passed > limits.settle_timeout:
            i = int(np.argmax(speed if arrived else off))
            error = self._missed(
                self._joints[i],
                float(off[i]),
                f"did not settle: after {limits.settle_timeout:g} s it is"
                f" {to_deg(float(off[i])):.2f} deg from its goal"
                f" ({to_deg(limits.settle_position):.2g} deg allowed) and moves at"
                f" {to_deg(float(speed[i])):.1f} deg/s. Check that nothing touches the arm and that"
                " its load is not too heavy, then move again",
            )
            self._finish(motion, error)

    def _finish(self, motion: _Motion, error: FollowingError | None) -> None:
        self._motion, self.is_moving = None, False
        self._conclude(motion.source.future, motion.ending or error)
        for waiting in motion.waiting:
            self._conclude(waiting, error)
