"""The arm of a running machine as an ``ArmExecutor``: what was planned here is what moves there.

A module that takes time-stamped points (ours does) is streamed the trajectory's own setpoints, all
of them at once, so no network delay can make it run dry; it plays them by its own clock, and the
way and the speed are those of the plan. A module without such a call gets the corners of the way,
one after the other, with the caps of the plan: it stops at each and times each leg itself. Sending
it all waypoints in one call would be shorter, but there are modules that hasten to the last one and
cut every corner, and the way was planned around things.

Stop does not wait for anything: it goes out at once beside what is under way.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from concurrent.futures import Future
from datetime import timedelta
from typing import Any

import numpy as np
from grpclib import GRPCError
from viam.components.arm import Arm, MoveOptions

from so101_motion.assembly import TICK
from so101_motion.channel import Channel
from so101_motion.compliance import Compliance
from so101_motion.errors import MotionError
from so101_motion.geometry import Array
from so101_motion.jog import Jog
from so101_motion.machine.link import Link, is_unimplemented
from so101_motion.machine.runner import Runner
from so101_motion.models import convert
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.trajectory import Trajectory
from so101_motion.pursuit import Pursuit
from so101_motion.state import ARM_JOINTS, JointState
from so101_motion.stream import Stream
from so101_motion.units import to_deg, to_rad

BATCH = 100
"""Points in a message; chosen: 5 kB each, far below what a message may hold."""

STOPPING = 5.0
"""How long a machine may take to come to rest [s]; chosen, ten times what an arm needs."""

OFF_WAY = to_rad(1.0)
"""How far the straight legs between corners may be off the planned way [rad]; chosen."""

ARRIVED = to_rad(5.0)
"""How far a joint may be from its goal when the arm has come to rest [rad]; chosen: a hanging arm
sags by a few degrees. Counts where a module does not itself say that the arm arrived."""

_LOOK = 0.03
"""How often to look whether the arm rests [s]; chosen."""


class MachineExecutor:
    """Has a machine move its arm.

    Args:
        link: To the machine.
        find: The arm's client; raises ``MachineUnavailable`` while there is none.
        state: The newest snapshot.
        look: Brings it up to date.
    """

    dt = TICK

    def __init__(
        self,
        link: Link,
        find: Callable[[], Arm],
        state: Callable[[], JointState],
        look: Callable[[], Awaitable[None]],
    ) -> None:
        self._link, self._find, self._state, self._look = link, find, state, look
        self._runner = Runner(link, self._brake, look)
        self.takes_streams = True

    @property
    def state(self) -> JointState:
        """The newest snapshot; never waits."""
        return self._state()

    def execute(self, trajectory: Trajectory, *, channel: Channel = Channel.ARM) -> Future[None]:
        """See ``Executor.execute``."""
        return self._runner.begin(lambda: self._execute(trajectory))

    def retarget(
        self, q_goal: Array, limits: MotionLimits, *, channel: Channel = Channel.ARM
    ) -> Future[None]:
        """See ``Executor.retarget``; the machine makes the way smooth."""

        async def turn() -> None:
            with self._link.asking("turning to a goal"):
                await self._find().move_through_joint_positions(
                    [convert.to_joint_positions(q_goal)],
                    _options(limits),
                    # Does not wait: giving up a call that does would brake before the next goal.
                    extra={"interpolate": False, "waitAtEnd": False},
                )
            await self._rest()
            self._check_arrival(q_goal)

        return self._runner.begin(turn)

    def open_stream(self, limits: MotionLimits) -> Stream:
        """Not offered.

        Raises:
            MotionError: Always; says what to do instead.
        """
        raise MotionError(
            "points cannot be streamed to the arm of a machine one by one; plan a motion, or send"
            " goals with start_retarget"
        )

    def play(self, led: Jog | Pursuit, *, channel: Channel = Channel.ARM) -> None:
        """Not offered.

        Raises:
            MotionError: Always; says what to do instead.
        """
        raise MotionError(
            "the arm of a machine cannot be led by hand over the network; plan a motion, or send"
            " goals with start_retarget"
        )

    def stop(self, channel: Channel | None = None, *, by: str = "stop") -> Future[None]:
        """See ``Executor.stop``."""
        return self._runner.stop(by)

    def interrupt(self, motion: Future[Any], by: str) -> Future[None]:
        """See ``Executor.interrupt``."""
        return self._runner.interrupt(motion, by)

    def hold(self) -> Future[None]:
        """Drive the joints where they are: out of manual mode, or out of a fault."""
        return self._link.run(self._then_look(self._hold()))

    def guide(self, how: Compliance) -> Future[None]:
        """Let the arm yield to a hand, as its own configuration says."""

        async def guide() -> None:
            with self._link.asking("hand guiding"):
                await self._find().set_manual_mode(True, timeout=STOPPING)

        return self._link.run(self._then_look(guide()))

    def release(self) -> Future[None]:
        """Let go of the joints, so that they can be moved by hand."""
        return self._link.run(self._then_look(self._set_torque(False)))

    def close(self) -> None:
        """End our own motion, if one is under way."""
        self._runner.close()

    # The loop's thread

    async def _brake(self) -> None:
        with self._link.asking("stop"):
            await self._find().stop(timeout=STOPPING)

    async def _then_look(self, work: Coroutine[Any, Any, None]) -> None:
        await work
        await self._look()

    async def _hold(self) -> None:
        try:
            await self._set_torque(True)
        except MotionError:  # a simulated arm has no torque; what it has is manual mode
            with self._link.asking("holding the joints"):
                await self._find().set_manual_mode(False, timeout=STOPPING)

    async def _set_torque(self, on: bool) -> None:
        what = "holding the joints" if on else "letting go of the joints"
        with self._link.asking(what):
            await self._find().do_command({"command": "set_torque", "enable": on}, timeout=STOPPING)

    async def _execute(self, trajectory: Trajectory) -> None:
        arm = self._find()
        if self.takes_streams:
            try:
                with self._link.asking("the motion"):
                    await _stream(arm, trajectory)
                return
            except MotionError as refusal:
                cause = refusal.__cause__
                if not (isinstance(cause, GRPCError) and is_unimplemented(cause)):
                    raise
                self.takes_streams = False
        with self._link.asking("the motion"):
            await _corner_by_corner(arm, trajectory)
        await self._look()
        self._check_arrival(trajectory.q[-1])

    async def _rest(self) -> None:
        """Wait until the arm rests."""
        while True:
            await self._look()
            if not self.state.arm_moving:
                return
            await asyncio.sleep(_LOOK)

    def _check_arrival(self, q_goal: Array) -> None:
        off = np.abs(self.state.q - q_goal)
        i = int(np.argmax(off))
        if off[i] > ARRIVED:
            raise MotionError(
                f"the arm of the machine came to rest, but {ARM_JOINTS[i]} is"
                f" {to_deg(float(off[i])):.1f} deg from its goal; see what held or stopped it"
            )


async def _stream(arm: Arm, trajectory: Trajectory) -> None:
    """Send all setpoints; returns when the arm has arrived."""
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


async def _corner_by_corner(arm: Arm, trajectory: Trajectory) -> None:
    """Send the corners of the way one after the other; returns when the arm has arrived."""
    options = MoveOptions(
        max_vel_degs_per_sec_joints=to_deg(_peaks(trajectory.qd)).tolist(),
        max_acc_degs_per_sec2_joints=to_deg(_peaks(trajectory.qdd)).tolist(),
    )
    for q in corners(trajectory.q, OFF_WAY)[1:]:
        await arm.move_through_joint_positions([convert.to_joint_positions(q)], options)


def _peaks(values: Array) -> Array:
    """The largest of each joint, shape (5,); a joint that rests gets the others' smallest."""
    peaks = np.max(np.abs(values), axis=0)
    moving = peaks > 1e-3 * np.max(peaks, initial=1e-9)
    return np.asarray(np.where(moving, peaks, np.min(peaks[moving], initial=np.max(peaks))))


def corners(q: Array, off_way: float) -> Array:
    """As few of the points ``q``, shape (n, 5), [rad], as it takes to stay near all of them.

    Both ends are among them. The straight legs between them are nowhere further than ``off_way``
    [rad], in any joint, from the points left out.

    Source: Douglas, Peucker, "Algorithms for the reduction of the number of points required to
    represent a digitized line or its caricature", 1973, with the largest joint as the distance.
    """
    kept, spans = {0, len(q) - 1}, [(0, len(q) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        off = np.max(np.abs(q[first : last + 1] - _on_leg(q[first : last + 1])), axis=1)
        worst = first + int(np.argmax(off))
        if off[worst - first] > off_way:
            kept.add(worst)
            spans += [(first, worst), (worst, last)]
    return np.asarray(q[sorted(kept)])


def _on_leg(q: Array) -> Array:
    """The nearest point to each of ``q`` on the straight leg from the first to the last."""
    leg = q[-1] - q[0]
    length = float(leg @ leg)
    u = np.clip((q - q[0]) @ leg / length, 0.0, 1.0) if length > 0.0 else np.zeros(len(q))
    return np.asarray(q[0] + u[:, None] * leg)


def _options(limits: MotionLimits) -> MoveOptions:
    return MoveOptions(
        max_vel_degs_per_sec_joints=to_deg(limits.velocity).tolist(),
        max_acc_degs_per_sec2_joints=to_deg(limits.acceleration).tolist(),
    )
