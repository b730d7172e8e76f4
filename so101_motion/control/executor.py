"""Run the I/O thread: the only thread that talks to the servos of a port.

It sleeps until the next tick is due or somebody wakes it. While something moves, ticks come at ``t0
+ k * dt`` against absolute deadlines, so what was planned and verified is, sample for sample, what
is written. A tick that would be more than half a period late is left out and counted; two goals are
never sent to catch up. After a pause of more than two ticks the motion goes on with the very next
setpoint, so nothing jumps; after one in which the joints came to rest it speeds up again as it once
began, and after a long one it is given up.

Futures of motions cannot be cancelled: a motion ends by being stopped. They complete on this
thread, after the snapshot that shows their effect and outside every lock; a callback must be brief
and must not wait for the executor.

A driver that raises puts the arm into FAULT: everything under way ends with that error, the thread
goes on reading (a driver may reconnect), and ``hold`` leads back. While the bus is lent
(``JointController.lend``) all other requests are refused.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Any, TypeVar

from so101_motion.common.clock import Clock, Metronome
from so101_motion.common.compliance import Compliance, Wall
from so101_motion.common.errors import ArmClosed
from so101_motion.common.modes import Mode
from so101_motion.common.state import JointState
from so101_motion.control.following import Following
from so101_motion.control.joint_controller import JointController
from so101_motion.control.joint_group import Channel, JointDriver, Tolerances
from so101_motion.control.motion_source import PlannedMotion, S
from so101_motion.control.request_queue import Request, RequestQueue, running_future
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Trajectory

__all__ = ["Channel", "Executor", "JointDriver", "Tolerances"]

T = TypeVar("T")

_log = logging.getLogger(__name__)

_IDLE_PERIOD, _QUIET_PERIOD = 0.05, 0.2
"""How often a resting arm is looked at: after something has happened at it, and otherwise [s].
Chosen: fresh enough for a picture of joints that a hand moves; near no load."""


class Executor:
    """Moves the joints of one port and reports their state. Any thread may call any method.

    Use it in a ``with`` block or call ``start`` and ``close``.

    Args:
        driver: The joints; only the executor may use it from now on.
        clock: What time it is.
        dt: Period of the setpoints [s]; every trajectory must have the same.
        stop_limits: Caps of a stop for the five arm joints, whatever the motion's own.
        jaw_stop_limits: The same for the jaw, one entry; by default the smallest of the arm's.
        tolerances: Those of the arm's motions; by default those of the simulated arm.
        jaw_tolerances: The same for the jaw; by default as for the arm.
        name: Name of the thread.

    Attributes:
        requests: Requests of other threads, served between two ticks.
    """

    def __init__(
        self,
        driver: JointDriver,
        clock: Clock,
        *,
        dt: float,
        stop_limits: MotionLimits,
        jaw_stop_limits: MotionLimits | None = None,
        tolerances: Tolerances | None = None,
        jaw_tolerances: Tolerances | None = None,
        name: str = "so101-io",
    ) -> None:
        self.dt = dt
        self._clock = clock
        self._control = JointController(
            driver,
            dt=dt,
            stop_limits=stop_limits,
            jaw_stop_limits=jaw_stop_limits,
            tolerances=tolerances or Tolerances(),
            jaw_tolerances=jaw_tolerances,
        )
        self._beat = Metronome(dt)
        self._wake = threading.Event()
        self._ready: Future[None] = Future()
        self._holding = True
        self._awaits_until = -math.inf  # a motion [s]
        self._thread = threading.Thread(target=self._live, name=name, daemon=True)
        self.requests = RequestQueue(self._wake)
        self._lock = threading.Lock()  # guards what follows, for moments only
        self._listeners: tuple[Callable[[JointState], None], ...] = ()

    def start(self) -> None:
        """Read the joints, hold them there, start the thread; raises what the driver raised."""
        self.requests.open()
        self._thread.start()
        self._ready.result()

    def start_limp(self) -> None:
        """Like ``start``, but leave the joints as they are."""
        self._holding = False
        self.start()

    def close(self) -> None:
        """Slow down to rest, end the thread, close the driver; may be called again.

        What is under way ends with ``Interrupted("shutdown")``. The servos go on holding.
        """
        first = self.requests.close(self._stop_of(tuple(Channel), "shutdown"))
        if self._thread.ident is not None:
            self._clock.join(self._thread)
        elif first:
            self._control.close()

    def __enter__(self) -> Executor:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def state(self) -> JointState:
        """The newest snapshot, also after ``close``; ``RuntimeError`` before ``start``."""
        state = self._control.state
        if state is None:
            raise RuntimeError("start the executor first")
        return state

    @property
    def live_state(self) -> JointState:
        """``state`` while somebody looks at the joints; ``ArmClosed`` after ``close``."""
        if self.requests.has_ended:
            raise ArmClosed
        return self.state

    @property
    def is_resting(self) -> bool:
        """Whether the arm neither moves nor is guided by hand, as of the newest snapshot."""
        return not self.state.arm_moving and self.state.mode is not Mode.GUIDING

    def execute(self, trajectory: Trajectory, *, channel: Channel = Channel.ARM) -> Future[None]:
        """Play ``trajectory``; its first setpoint goes out at once when nothing moves.

        The future completes when the joints have settled at its end. It raises ``NotHolding`` when
        the joints are limp or in a fault, ``MotionError`` when another motion of the channel is
        under way or the trajectory begins elsewhere, ``Interrupted`` when the motion was ended
        early, ``FollowingError`` when a joint did not follow, and what the driver raised.

        Raises:
            ValueError: The trajectory has another period or another number of joints.
        """
        if trajectory.n != len(channel.joints):
            raise ValueError(f"a trajectory of {trajectory.n} joints for the {channel.value}")
        if abs(trajectory.dt - self.dt) > 1e-9:
            raise ValueError(f"the trajectory's period is {trajectory.dt} s, not {self.dt} s")
        motion = PlannedMotion(trajectory)
        begin = partial(self._control.play, motion, channel)
        return self.requests.ask(begin, motion.future, channel)

    def await_motion(self, until: float) -> None:
        """Do not look at joints that rest until a request comes, or until ``until`` [s].

        A look takes some milliseconds, for which a motion that comes meanwhile would have to wait.
        """
        self._awaits_until = until

    def turn(self, following: Following, *, channel: Channel = Channel.ARM) -> Future[None]:
        """Let ``following`` take over from the present motion without stopping; returns its future.

        The present motion ends with ``Interrupted("a newer motion")``. While the channel is being
        stopped the future raises ``MotionError``.
        """
        turn = partial(self._control.turn, following, channel)
        return self.requests.ask(turn, following.future, channel)

    def play(self, source: S) -> S:
        """Move the arm joints as ``source`` says, until its future is done; returns ``source``."""
        begin = partial(self._control.play, source, Channel.ARM)
        self.requests.ask(begin, source.future, Channel.ARM)
        return source

    def on_failure(self, listener: Callable[[Exception, tuple[JointState, ...]], None]) -> None:
        """Call ``listener`` for each failure of the arm, with the states of the second before.

        It is called on the I/O thread and must be brief.
        """
        self._control.recent.on_failure = listener

    def stop_limits(self, channel: Channel) -> MotionLimits:
        """The limits with which a stop of ``channel`` brakes, whatever the motion's own caps."""
        return self._control.stop_limits(channel)

    def set_stop_limits(self, limits: MotionLimits) -> None:
        self._control.set_stop_limits(limits)

    def stop(self, channel: Channel | None = None, *, by: str = "stop") -> Future[None]:
        """Slow down to rest from the next setpoint on, along the path that was being followed.

        Motions of ``channel`` (None for both) under way, and those asked for before, end with
        ``Interrupted(by)``. The future completes at rest; at once when nothing moves.
        """
        channels = tuple(Channel) if channel is None else (channel,)
        stop = self._stop_of(channels, by)
        self.requests.stop(stop, channels, by)
        return stop.future

    def interrupt(self, motion: Future[Any], by: str) -> Future[None]:
        """End the motion whose future is ``motion``, if it is not over; completes at rest."""
        future = running_future()
        if motion.done():
            future.set_result(None)
        else:
            end = partial(self._control.interrupt, motion, by, future)
            self.requests.ask(end, future)
        return future

    def listen(self, listener: Callable[[JointState], None]) -> Callable[[], None]:
        """Read the joints in every period, moving or not, and pass each snapshot to ``listener``.

        It is called on the I/O thread, also while the joints cannot be reached, and must be brief.
        The function returned ends this.
        """
        with self._lock:
            self._listeners = (*self._listeners, listener)
        self._wake.set()

        def end() -> None:
            with self._lock:
                self._listeners = tuple(each for each in self._listeners if each is not listener)

        return end

    def hold(self) -> Future[None]:
        """Drive the joints where they are: out of manual mode, or out of a fault."""
        return self.ask(JointController.hold)

    def guide(self, compliance: Compliance, wall: Wall | None = None) -> Future[None]:
        """Let the arm yield to a hand until it is asked to hold, to stop or to let go.

        The jaw holds on and may be moved meanwhile. Where ``wall``, called on the I/O thread, holds
        the joints back, they resist the hand.
        """
        guide = partial(self._control.guide, compliance, wall)
        return self.requests.ask(guide, channel=Channel.ARM)  # a stop that comes later ends it

    def release(self) -> Future[None]:
        """Switch torque off, so that the joints can be moved by hand; refused while they move."""
        return self.ask(JointController.release)

    def call(self, job: Callable[[JointDriver], T]) -> Future[T]:
        """Run ``job`` with the driver on the I/O thread; refused while something moves.

        The future holds what ``job`` returned or raised; a failed job is not a fault of the arm.
        """
        return self.ask(lambda control: control.call(job))

    def call_and_rehold(self, job: Callable[[JointDriver], T]) -> Future[T]:
        """Like ``call``, for a job after which the driver's angles mean something else.

        Joints that are held stay where they are, under their new angles.
        """
        return self.ask(lambda control: control.call_and_rehold(job))

    def ask(self, job: Callable[[JointController], T]) -> Future[T]:
        return self.requests.ask(partial(job, self._control))

    def _stop_of(self, channels: tuple[Channel, ...], by: str) -> Request:
        future = running_future()
        return Request(future, None, partial(self._control.stop, channels, by, future))

    # The I/O thread

    def _live(self) -> None:
        with self._clock.attend():
            try:
                self._control.start(self._clock.now(), holding=self._holding)
            except Exception as error:
                self._leave()
                self._ready.set_exception(error)
                return
            self._ready.set_result(None)
            moving = False
            while not (self.requests.closing and self.requests.is_over(moving=moving)):
                now = self._clock.now()
                until = self._not_before(now, moving)
                if until is None:
                    try:
                        self._control.k = self._beat.k
                        if self._wake.is_set():  # in mid-motion nobody has waited for it
                            self._wake.clear()
                        if not self.requests.is_empty:
                            self._serve()
                        self._control.tick(now, self._beat.late, self._beat.missed)
                    except Exception as error:  # whatever it is, the thread lives on and says so
                        self._control.fail(error)
                    moving = self._control.is_moving
                    until = self._end_turn(now, moving)
                # What is asked for in mid-motion is served in the next tick, not sooner.
                self._clock.wait(until, None if moving else self._wake)
            self._leave()

    def _serve(self) -> None:
        for request in self.requests.take():
            try:
                result = request.run()
            except Exception as error:
                self._control.outcomes.conclude(request.future, error)
            else:
                if request.is_job:
                    self._control.outcomes.conclude(request.future, result=result)

    def _not_before(self, now: float, moving: bool) -> float | None:
        """When requests are served and the joints move next [s]; None if that is due."""
        if not moving:
            if now < self._awaits_until and self.requests.is_empty:
                return self._awaits_until
            self._beat.restart(now)
        elif not self._beat.is_due(now):
            return self._beat.deadline
        return None

    def _end_turn(self, now: float, moving: bool) -> float:
        """Tell what has come of it; return when to run again [s]."""
        self._beat.advance()
        self._control.outcomes.settle()
        if (state := self._control.state) is not None:
            for listener in self._listeners:
                try:
                    listener(state)
                except Exception:
                    _log.exception("a listener failed; the joints are not affected")
        if moving or self._listeners or self._control.is_busy:
            return self._beat.deadline
        return now + (_QUIET_PERIOD if self._control.is_quiet(now) else _IDLE_PERIOD)

    def _leave(self) -> None:
        self.requests.leave()
        try:
            self._control.close()
        except Exception:
            _log.exception("the driver could not be closed cleanly")
