"""Run motions on a machine, one at a time, such as a trajectory that was planned here.

A motion is a call that lasts as long as it. Cancelling the call ends the motion: our module stops
the arm when its caller goes away, and Stop is sent as well to be sure; it never waits for calls
under way. A new motion takes over from the old one without a stop between them.

A module that takes time-stamped points (ours does) gets all setpoints of the trajectory at once, so
that no network delay can interrupt it. Another one, and an arm with a joint outside its range, gets
the corners of the path one after the other, with the caps of the plan: it stops at each and times
each leg itself. All waypoints in one call would be shorter, but some modules go straight to the
last one, and the path was planned around obstacles.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Mapping
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import timedelta
from typing import TYPE_CHECKING, Any

import numpy as np
from grpclib import GRPCError, Status
from viam.components.arm import Arm

from so101_motion.common.compliance import Compliance, Wall
from so101_motion.common.errors import SUPERSEDED, Interrupted, MotionError, So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS, JointState
from so101_motion.common.units import to_deg, to_rad
from so101_motion.control.following import Following
from so101_motion.control.joint_group import Channel
from so101_motion.control.motion_source import S
from so101_motion.control.request_queue import running_future
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Trajectory
from so101_motion.rig.rig import HARD_STOP, TICK
from so101_motion.tasks.guided.path import corners_of
from so101_motion.viam.conversion import convert

if TYPE_CHECKING:
    from so101_motion.viam.client.rig import MachineRig

BATCH = 100  # points in a message; chosen: 5 kB each, far below what a message may hold

STOPPING = 5.0
"""How long a machine may take to come to rest [s]; chosen, ten times what an arm needs."""

OFF_PATH = to_rad(1.0)
"""How far the straight legs between corners may be off the planned path [rad]; chosen."""

ARRIVED = to_rad(5.0)
"""How far a joint may be from its goal when the arm has come to rest [rad]; chosen: a hanging arm
sags by a few degrees. Used if a module does not itself report that the arm has arrived."""

_LOOK = 0.03  # how often to look whether the arm rests [s]; chosen


Work = Callable[[], Awaitable[None]]


@dataclass(slots=True, kw_only=True)
class _Job:
    work: Work
    future: Future[None] = field(default_factory=running_future)
    task: asyncio.Task[None] | None = None
    ending: str | None = None
    brakes: bool = True

    def end(self, by: str, *, brakes: bool = True) -> None:
        if self.ending is None and self.task is not None:
            self.ending, self.brakes = by, brakes
            self.task.cancel()


class MotionRunner(ABC):
    """Runs one motion at a time of a component on a machine. Any thread may call."""

    def __init__(self, rig: MachineRig) -> None:
        self._rig, self._link = rig, rig.link
        self._job: _Job | None = None

    @abstractmethod
    async def _brake(self) -> None:
        """Stop the machine; returns at rest."""

    def begin(self, work: Work) -> Future[None]:
        """Run ``work``, which raises our errors; it replaces the motion under way."""
        job = _Job(work=work)
        self._link.post(lambda: self._start(job))
        return job.future

    def interrupt(self, motion: Future[Any], by: str) -> Future[None]:
        """End the motion whose future is ``motion``; done when it is over."""
        over = running_future()
        motion.add_done_callback(lambda _: over.set_result(None))

        def end() -> None:
            if self._job is not None and self._job.future is motion:
                self._job.end(by)

        self._link.post(end)
        return over

    def bring_to_rest(self, by: str) -> Future[None]:
        """Stop the machine, also a motion that another client began; done at rest."""
        return self._link.run(self._stop(by))

    def end(self) -> None:
        """End our own motion, if one is under way, and wait until it is over."""
        self._link.run(self._end()).result()

    # The loop's thread

    async def _end(self) -> None:
        job = self._job
        if job is not None and job.task is not None:
            job.end("shutdown")
            await asyncio.wait([job.task])

    def _start(self, job: _Job) -> None:
        if self._job is not None:
            self._job.end(SUPERSEDED, brakes=False)
        self._job = job
        job.task = asyncio.get_running_loop().create_task(self._run(job))

    async def _stop(self, by: str) -> None:
        job = self._job
        if job is not None:
            job.end(by, brakes=False)
        await self._brake()
        if job is not None and job.task is not None:
            await asyncio.wait([job.task])
        await self._rig.look()

    async def _run(self, job: _Job) -> None:
        problem: BaseException | None = None
        try:
            await job.work()
        except asyncio.CancelledError:
            problem = Interrupted(job.ending or "shutdown")
            if job.brakes:
                with suppress(So101Error):  # lost: the machine stops when its caller goes away
                    await self._brake()
        except Exception as error:
            problem = error
        finally:
            if self._job is job:
                self._job = None
            with suppress(So101Error):
                await self._rig.look()
            if problem is None:
                job.future.set_result(None)
            else:
                job.future.set_exception(problem)


class MachineExecutor(MotionRunner):
    """Makes a machine move its arm."""

    dt = TICK
    is_resting = False  # other clients may move it at any time

    takes_streams = True

    @property
    def state(self) -> JointState:
        return self._rig.state

    def execute(self, trajectory: Trajectory, *, channel: Channel = Channel.ARM) -> Future[None]:
        return self.begin(lambda: self._execute(trajectory))

    def stop_limits(self, channel: Channel) -> MotionLimits:
        """The limits of our own arms."""
        return HARD_STOP

    def turn(self, following: Following, *, channel: Channel = Channel.ARM) -> Future[None]:
        """The machine itself smooths the motion and guards it."""
        q_goal, limits = following.target, following.limits
        assert q_goal is not None, "it is made with a target"

        async def turn() -> None:
            with self._link.asking("turning to a goal"):
                await self._rig.find_arm().move_through_joint_positions(
                    [convert.to_joint_positions(q_goal)],
                    convert.to_move_options(limits.velocity, limits.acceleration),
                    # Does not wait: cancelling a call that waits would brake before the next goal.
                    extra={"interpolate": False, "waitAtEnd": False},
                )
            await self._rig.look()
            while self.state.arm_moving:
                await asyncio.sleep(_LOOK)
                await self._rig.look()
            self._check_arrival(q_goal)

        return self.begin(turn)

    def request(self, command: Mapping[str, Any]) -> Future[None]:
        """Send a DoCommand with which the arm moves until it is answered; done on arrival."""

        async def move() -> None:
            with self._link.asking(str(command.get("command"))):
                await self._rig.find_arm().do_command(command)

        return self.begin(move)

    def play(self, source: S) -> S:
        raise MotionError(
            "the arm of a machine cannot be jogged, streamed to or made to follow targets over the"
            " network; plan a motion, or send goals with retarget"
        )

    def stop(self, channel: Channel | None = None, *, by: str = "stop") -> Future[None]:
        return self.bring_to_rest(by)

    def hold(self) -> Future[None]:
        """Drive the joints where they are: out of manual mode, or out of a fault."""
        return self._link.run(self._then_look(self._hold()))

    def guide(self, compliance: Compliance, wall: Wall | None = None) -> Future[None]:
        """Start manual mode, with the settings and the walls of the machine itself."""

        async def guide() -> None:
            with self._link.asking("hand guiding"):
                await self._rig.find_arm().set_manual_mode(True, timeout=STOPPING)

        return self._link.run(self._then_look(guide()))

    def release(self) -> Future[None]:
        """Switch torque off, so that the joints can be moved by hand."""
        return self._link.run(self._then_look(self._set_torque(False)))

    # The loop's thread

    async def _brake(self) -> None:
        with self._link.asking("stop"):
            await self._rig.find_arm().stop(timeout=STOPPING)

    async def _then_look(self, work: Coroutine[Any, Any, None]) -> None:
        await work
        await self._rig.look()

    async def _hold(self) -> None:
        try:
            await self._set_torque(True)
        except MotionError:  # a simulated arm has no torque; what it has is manual mode
            with self._link.asking("holding the joints"):
                await self._rig.find_arm().set_manual_mode(False, timeout=STOPPING)

    async def _set_torque(self, on: bool) -> None:
        request: dict[str, Any] = {"command": "set_torque", "enable": on}
        with self._link.asking("holding the joints" if on else "releasing the joints"):
            await self._rig.find_arm().do_command(request, timeout=STOPPING)

    async def _execute(self, trajectory: Trajectory) -> None:
        arm = self._rig.find_arm()
        if self.takes_streams and not self.state.reading.out_of_range:
            try:
                with self._link.asking("the motion"):
                    await _stream(arm, trajectory)
                return
            except MotionError as refusal:
                cause = refusal.__cause__
                if not (isinstance(cause, GRPCError) and cause.status is Status.UNIMPLEMENTED):
                    raise
                self.takes_streams = False
        with self._link.asking("the motion"):
            options = convert.to_move_options(_peaks(trajectory.qd), _peaks(trajectory.qdd))
            for q in trajectory.q[corners_of(trajectory.q, OFF_PATH)[1:]]:
                await arm.move_through_joint_positions([convert.to_joint_positions(q)], options)
        await self._rig.look()
        self._check_arrival(trajectory.q[-1])

    def _check_arrival(self, q_goal: Array) -> None:
        off = np.abs(self.state.q - q_goal)
        i = int(np.argmax(off))
        if off[i] > ARRIVED:
            raise MotionError(
                f"the arm of the machine came to rest, but {ARM_JOINTS[i]} is"
                f" {to_deg(float(off[i])):.1f} deg from its goal; check what blocked or stopped it"
            )


async def _stream(arm: Arm, trajectory: Trajectory) -> None:
    q_deg = to_deg(trajectory.q)

    async def batches() -> AsyncIterator[list[Arm.TrajectoryPoint]]:
        for first in range(0, len(trajectory), BATCH):
            yield [
                Arm.TrajectoryPoint(
                    time=timedelta(seconds=k * trajectory.dt), positions=q_deg[k].tolist()
                )
                for k in range(first, min(first + BATCH, len(trajectory)))
            ]

    # The SDK declares its async generator as a coroutine that returns one.
    updates: Any = arm.move_through_joint_positions_streamed(batches())
    async for _ in updates:
        pass


def _peaks(values: Array) -> Array:
    """The largest value of each joint, shape (5,); a joint that rests gets the others' smallest."""
    peaks = np.max(np.abs(values), axis=0)
    moving = peaks > 1e-3 * np.max(peaks, initial=1e-9)
    return np.asarray(np.where(moving, peaks, np.min(peaks[moving], initial=np.max(peaks))))
