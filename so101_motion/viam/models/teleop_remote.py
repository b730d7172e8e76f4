"""Use arms of other modules and machines in a teleoperation, through Viam.

In every period the leader's joints are read and the follower is sent a goal, with the call that
Viam's own teleoperation uses and the present caps as move options; the arm itself makes the motion
smooth. A remote arm of this package counts its stops, and refuses a goal that misses one, so Stop
ends the session wherever it is pressed. An arm of another module stops only until the next goal
comes. A request without an answer within ``PATIENCE`` is given up and sent again.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import h2.exceptions
import numpy as np
from grpclib import GRPCError, Status
from grpclib.exceptions import ProtocolError, StreamTerminatedError
from viam.components.arm import Arm, JointPositions
from viam.components.gripper import Gripper

from so101_motion.common.clock import Clock
from so101_motion.common.errors import Interrupted, MotionError, So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_deg
from so101_motion.control.following import Approach
from so101_motion.tasks.teleop.pilot import Pilot
from so101_motion.tasks.teleop.predictor import Predictor
from so101_motion.tasks.teleop.sides import Follower, Leader, SideState
from so101_motion.viam.conversion import convert

_log = logging.getLogger(__name__)

PATIENCE = 0.25  # how long to wait for an answer [s]; chosen for a bad network
SETTING_UP = 5.0  # how long a request may take that is not part of the motion [s]; chosen

HORIZON = 0.1
"""How far ahead the leader's motion is predicted for a remote follower [s]; chosen: such an arm
slows down towards every goal, and the goals arrive late."""

LOST_AFTER = 0.09
"""The follower holds when a remote leader has not answered for this long [s]; with one more period
that is within 0.1 s."""

_TROUBLE = (
    GRPCError, OSError, TimeoutError, So101Error, StreamTerminatedError, ProtocolError,
    h2.exceptions.ProtocolError,
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class RemoteArm:
    """An arm of another module or machine, read ``rate`` times a second [1/s]."""

    arm: Arm
    gripper: Gripper | None
    loop: asyncio.AbstractEventLoop
    clock: Clock
    rate: float

    async def ask(self) -> tuple[float, Array, Array]:
        """Read joint angles and aperture; returns the time [s], values, and which are valid."""
        begin = self.clock.now()
        x, heard = np.zeros(6), np.ones(6, dtype=bool)
        asked: list[Any] = [self.arm.get_joint_positions(timeout=PATIENCE)]
        if self.gripper is not None:
            asked.append(self.gripper.do_command({"command": "get_position"}, timeout=PATIENCE))
        answers = await asyncio.gather(*asked)
        x[:5] = convert.from_joint_values(answers[0].values)
        percent = answers[1].get("position_percentage") if len(answers) > 1 else None
        heard[5] = isinstance(percent, (int, float))
        x[5] = 0.01 * percent if isinstance(percent, (int, float)) else 0.0
        return 0.5 * (begin + self.clock.now()), x, heard

    def run(self, call: Coroutine[Any, Any, Any]) -> Any:
        """Run ``call`` from another thread than the loop's; return its result."""
        return asyncio.run_coroutine_threadsafe(call, self.loop).result(SETTING_UP)

    def begin(self, job: Callable[[], Coroutine[Any, Any, None]]) -> Future[None]:
        """Run ``job`` once a period until the future is cancelled."""
        return asyncio.run_coroutine_threadsafe(self._repeat(job), self.loop)

    async def _repeat(self, job: Callable[[], Coroutine[Any, Any, None]]) -> None:
        due = self.loop.time()
        while True:
            try:
                await job()
            except Exception:  # the next period may do better; without it nobody would look again
                _log.exception("a period of the teleoperation failed; it goes on")
            due = max(due + 1.0 / self.rate, self.loop.time())
            await asyncio.sleep(due - self.loop.time())

    async def stops(self) -> float | None:
        """How often it has been stopped; None if its module does not count that."""
        try:
            count = (await self.arm.get_status(timeout=SETTING_UP)).get("stops")
        except _TROUBLE:  # many modules report no status
            return None
        return count if isinstance(count, (int, float)) else None

    async def set_torque(self, on: bool) -> bool:
        """Hold or release its joints; return whether the request succeeded."""
        try:
            await self.arm.do_command({"command": "set_torque", "enable": on}, timeout=SETTING_UP)
        except _TROUBLE as error:
            _log.warning("%s could not be %s: %s", self.arm.name, "held" if on else "let go", error)
            return False
        return True


class RemoteLeader(Leader):
    """A remote arm as leader; ``lets_go``: limp while it leads, held again afterwards."""

    def __init__(self, arm: RemoteArm, *, lets_go: bool = True) -> None:
        self._arm, self._lets_go = arm, lets_go
        self._is_limp = self._is_to_hold = False
        self._x = np.zeros(6)
        self._asking: Future[None] | None = None

    def attach(self, predictor: Predictor) -> None:
        if self._lets_go:
            self._is_to_hold = True  # even if the answer is lost
            self._is_limp = bool(self._arm.run(self._arm.set_torque(False)))

        async def ask() -> None:
            try:
                t, self._x, heard = await self._arm.ask()
            except _TROUBLE as error:
                _log.debug("the leader does not answer: %s", error)
            else:
                predictor.take(t, self._x, heard)

        self._asking = self._arm.begin(ask)

    def detach(self) -> None:
        if self._asking is not None:
            self._asking.cancel()
        if self._is_to_hold:
            self._arm.run(self._arm.set_torque(True))
            self._is_limp = self._is_to_hold = False

    @property
    def state(self) -> SideState:
        """It is limp if the request to release its joints succeeded."""
        return SideState(x=self._x, x_goal=self._x, is_limp=self._is_limp)


class RemoteFollower(Follower):
    """A remote arm as follower."""

    def __init__(self, arm: RemoteArm) -> None:
        self._arm = arm
        self._going: Future[None] | None = None
        self._x = np.zeros(6)
        self._x_goal: Array | None = None
        self._seen = -np.inf
        self._engaged = self._moves = False
        self._problem: MotionError | None = None
        self._jaw: asyncio.Task[None] | None = None
        self._percent = 0.0
        self._stops: float | None = None

    def attach(self, pilot: Pilot, look: Callable[[], None]) -> None:
        self._stops = self._arm.run(self._arm.stops())
        self._approach = Approach(pilot.pace.full, pilot.pace.approach)

        async def go() -> None:
            try:
                self._seen, self._x, _ = await self._arm.ask()
                if self._engaged:
                    await self._go(pilot)
            except _TROUBLE as error:
                self._lose(error)
            look()

        self._going = self._arm.begin(go)

    def engage(self) -> None:
        self._x_goal, self._problem = None, None
        self._engaged = True

    def detach(self) -> None:
        self._engaged = False
        if self._going is not None:
            self._going.cancel()
        try:
            self._arm.run(self._stop())
        except _TROUBLE as error:
            raise MotionError(f"the follower could not be stopped: {error}") from error

    def ending(self) -> BaseException | None:
        problem, self._problem = self._problem, None
        return problem

    @property
    def state(self) -> SideState:
        return SideState(
            x=self._x,
            x_goal=self._x if self._x_goal is None else self._x_goal,
            is_there=self._arm.clock.now() - self._seen < PATIENCE,
            is_engaged=self._engaged,
        )

    # In the event loop

    async def _stop(self) -> None:
        """Stop arm and jaw, both even if one does not answer."""
        stops = [self._arm.arm.stop(timeout=SETTING_UP)]
        if self._arm.gripper is not None:
            stops.append(self._stop_jaw(self._arm.gripper, SETTING_UP))
        for outcome in await asyncio.gather(*stops, return_exceptions=True):
            if isinstance(outcome, BaseException):
                raise outcome

    async def _stop_jaw(self, gripper: Gripper, patience: float) -> None:
        jaw, self._jaw = self._jaw, None
        if jaw is None:
            return  # it has not been sent anywhere
        jaw.cancel()  # or its goal could arrive after the stop
        await asyncio.wait([jaw])
        await gripper.stop(timeout=patience)

    async def _go(self, pilot: Pilot) -> None:
        aim = pilot.arm(self._x[:5])
        if aim is None:
            if not pilot.gate.pauses_mirroring:
                self._approach.begin()
            if self._moves:
                self._moves = False
                if self._stops is not None:
                    self._stops += 1.0  # also if the answer comes too late
                await self._arm.arm.stop(timeout=PATIENCE)
                if self._arm.gripper is not None:
                    await self._stop_jaw(self._arm.gripper, PATIENCE)
            return
        self._moves = True
        q = aim.q
        caps = self._approach.caps(self._arm.clock.now(), q - self._x[:5])
        self._x_goal = np.append(q, self._x[5])
        count = {} if self._stops is None else {"stops": self._stops}
        await self._arm.arm.move_through_joint_positions(
            [JointPositions(values=to_deg(q).tolist())],
            convert.to_move_options(caps.velocity, caps.acceleration),
            extra={"interpolate": False, "waitAtEnd": False, **count},
            timeout=PATIENCE,
        )
        self._go_on_with_jaw(pilot)

    def _go_on_with_jaw(self, pilot: Pilot) -> None:
        gripper, wanted = self._arm.gripper, pilot.jaw()
        if gripper is None or wanted is None or (self._jaw is not None and not self._jaw.done()):
            return
        percent = 100.0 * wanted[0]
        if self._jaw is None or abs(percent - self._percent) > _JAW_STEP:
            self._percent = percent

            async def set_jaw() -> None:
                request: dict[str, Any] = {"command": "set_position", "percentage": percent}
                try:
                    await gripper.do_command({**request, "wait": False}, timeout=PATIENCE)
                except _TROUBLE as error:
                    _log.warning("the follower's jaw did not move: %s", error)

            self._jaw = asyncio.ensure_future(set_jaw())

    def _lose(self, error: Exception) -> None:
        if not self._engaged:
            return
        self._engaged = False
        if isinstance(error, GRPCError) and error.status is Status.CANCELLED:
            self._problem = Interrupted("stop")
        elif isinstance(error, TimeoutError) or (
            isinstance(error, GRPCError) and error.status is Status.DEADLINE_EXCEEDED
        ):
            self._problem = MotionError(
                f"the follower did not answer within {PATIENCE:g} s, so it holds"
            )
        else:
            self._problem = MotionError(f"the follower refused a request, so it holds: {error}")


_JAW_STEP = 0.5  # [%]; a smaller change is not worth a request
