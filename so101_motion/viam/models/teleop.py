"""``devrel:so101:teleop``: one arm follows another that is guided by hand.

Arms of this process are read and moved directly, at the rate of their bus, other arms through Viam;
they are looked up with every start, so they may be rebuilt in between.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from viam.resource.types import Model
from viam.services.generic import Generic

from so101_motion.calib.record import store
from so101_motion.common.attributes import Attributes
from so101_motion.common.clock import Clock, MonotonicClock
from so101_motion.common.errors import ConfigError, NotReady, PortUnavailable, SurroundingsUnknown
from so101_motion.rig.rig import TICK
from so101_motion.tasks.teleop import LocalArm, LocalFollower, LocalLeader, Recorder, Teleop, pilot
from so101_motion.tasks.teleop.config import TeleopConfig
from so101_motion.tasks.teleop.pilot import Phase
from so101_motion.tasks.teleop.recording import FPS
from so101_motion.tasks.teleop.sides import Follower, Leader, middles_of
from so101_motion.viam.conversion import convert
from so101_motion.viam.models.arm_resource import ArmResource
from so101_motion.viam.models.configured import Configured, Dependencies, dependency
from so101_motion.viam.models.gripper_resource import GripperResource
from so101_motion.viam.models.teleop_remote import (
    HORIZON,
    LOST_AFTER,
    RemoteArm,
    RemoteFollower,
    RemoteLeader,
)
from so101_motion.viam.requests.await_motion import run_to_end
from so101_motion.viam.requests.commands import Command, Taking

RECORDINGS = "recordings"
"""The folder in the module's data directory that recordings are written to."""

_AGAIN = 1.0
"""Pause until a machine that could not be read is read again, before it starts by itself [s];
chosen."""


class So101Teleop(Configured, Generic):
    """Makes one arm follow another."""

    MODEL: ClassVar = Model.from_string("devrel:so101:teleop")
    CONFIG = TeleopConfig

    def __init__(self, name: str, config: TeleopConfig, dependencies: Dependencies) -> None:
        super().__init__(name)
        self._config, self._dependencies = config, dependencies
        self._session: Teleop | None = None
        self._record: Path | None = None
        self._rate = config.rate
        self._starting: asyncio.Task[None] | None = None
        self._informing: asyncio.Task[None] | None = None  # the follower's guard
        self._one_at_a_time = asyncio.Lock()
        self._commands: dict[str, Command] = {
            "start": Taking(self._start, ("record", "fps", "replace")),
            "stop": self._stop,
            "status": self._status,
        }

    @classmethod
    def needed(cls, wanted: TeleopConfig) -> Sequence[str]:
        return list(wanted.dependencies)

    @classmethod
    def build(cls, name: str, wanted: TeleopConfig, dependencies: Dependencies) -> So101Teleop:
        service = cls(name, wanted, dependencies)
        if wanted.auto_start:
            service._starting = asyncio.ensure_future(service._start_alone())
        return service

    async def get_status(self, **kwargs: Any) -> Mapping[str, Any]:
        return convert.to_result(await self._status())

    async def close(self) -> None:
        if self._starting is not None:
            self._starting.cancel()
        async with self._one_at_a_time:
            await self._leave()

    # Requests

    async def _start(self, given: Attributes) -> dict[str, Any]:
        record, replace = given.text("record", ""), given.flag("replace", False)
        fps = given.number("fps", FPS, lower=0.1, upper=1000.0, unit="1/s")
        async with self._one_at_a_time:
            if self._session is None or not self._session.status.is_running:
                await self._leave()
                await self._begin(record, fps, replace=replace)
        return {"running": True, "recording": str(self._record) if self._record else None}

    async def _stop(self) -> dict[str, Any]:
        if self._starting is not None:
            self._starting.cancel()
        async with self._one_at_a_time:
            if self._session is not None:
                await run_to_end(self._session.stop)
        return {"running": False}

    async def _status(self) -> dict[str, Any]:
        session = self._session
        if session is None:
            return {"running": False, "cycles": 0, "consecutive_errors": 0, "last_error": "",
                    "rate_hz": self._rate, "state": Phase.STOPPED.value}  # fmt: skip
        return {**session.status.to_json(), "rate_hz": self._rate}

    # Sessions

    async def _start_alone(self) -> None:
        said = False
        while True:
            try:
                await self._start(Attributes({}, ()))
            except (SurroundingsUnknown, NotReady, PortUnavailable) as error:
                # Other components, or the servos, may still be starting.
                if not said:
                    self.logger.warning("teleoperation waits for the machine: %s", error)
                said = True
                await asyncio.sleep(_AGAIN)
                continue
            except Exception as error:  # no caller waits for it
                self.logger.error("teleoperation could not be started: %s", error)
            return

    async def _begin(self, record: str, fps: float, *, replace: bool) -> None:
        leader, follower, clock, is_local = self._sides()
        guarded = None  # of a follower that this module guards
        if isinstance(follower, LocalFollower) and self._config.guarded:
            guarded = ArmResource.here[_short(self._config.follower_arm)].guarded_scene
            await guarded.read()
        file = _file_of(record, replace=replace) if record else None
        recorder = await run_to_end(lambda: self._recorder(file, fps, clock)) if file else None
        self._rate = 1.0 / TICK if is_local else self._config.rate
        session = Teleop(
            leader,
            follower,
            clock,
            mirror=self._config.mirror,
            pace=self._config.pace,
            horizon=pilot.HORIZON if isinstance(follower, LocalFollower) else HORIZON,
            lost_after=pilot.LOST_AFTER
            if isinstance(leader, LocalLeader)
            else max(LOST_AFTER, 2.5 / self._rate),
        )
        try:
            await run_to_end(lambda: session.start(recorder))
        except BaseException:
            if recorder is not None and file is not None:
                await run_to_end(recorder.close)
                _unfinished(file).unlink(missing_ok=True)
            await run_to_end(session.close)
            raise
        if file is not None:  # only now: a start that fails replaces nothing
            _unfinished(file).replace(file)
        self._session, self._record = session, file
        if guarded is not None:
            informing = guarded.keep_known(lambda: session.status.is_running)
            self._informing = asyncio.ensure_future(informing)
        if not self._config.lets_go:
            self.logger.info("manage_leader_torque is false: the leader stays as stiff as it is")

    async def _leave(self) -> None:
        session, self._session = self._session, None
        self._record = None
        if self._informing is not None:
            self._informing.cancel()
        if session is not None:
            await run_to_end(session.close)

    def _sides(self) -> tuple[Leader, Follower, Clock, bool]:
        config = self._config
        arms, jaws = (config.leader_arm, config.follower_arm), config.grippers or (None, None)
        here = [ArmResource.here.get(_short(arm)) for arm in arms]
        clocks: list[Clock] = [arm.rig.clock for arm in here if arm is not None]
        clock = clocks[-1] if clocks else MonotonicClock()  # of both sides, and of the session
        leading, following = (
            self._side(arm, jaw, clock) for arm, jaw in zip(arms, jaws, strict=True)
        )
        if (
            isinstance(leading, LocalArm)
            and isinstance(following, LocalArm)
            and leading.station.executor is following.station.executor
        ):
            reason = "is on the leader's port; give another arm"
            raise ConfigError("follower_arm", config.follower_arm, reason)
        follower: Follower
        leader: Leader = (
            LocalLeader(leading, lets_go=config.lets_go)
            if isinstance(leading, LocalArm)
            else RemoteLeader(leading, lets_go=config.lets_go)
        )
        if isinstance(following, LocalArm):
            follower = LocalFollower(following, guarded=config.guarded)
        elif config.guarded and config.asks_for_guard:
            reason = "needs a follower of this module, which this one is not; leave it out"
            raise ConfigError("collision_guard", True, reason)
        else:
            follower = RemoteFollower(following)
        if len(set(map(id, clocks))) == 2 and not all(
            isinstance(clock, MonotonicClock) for clock in clocks
        ):
            reason = "has another clock than the leader; set simulate_time to true for both"
            raise ConfigError("follower_arm", config.follower_arm, reason)
        return leader, follower, clock, len(clocks) == 2

    def _side(self, arm: str, jaw: str | None, clock: Clock) -> LocalArm | RemoteArm:
        here = ArmResource.here.get(_short(arm))
        if here is None:
            return RemoteArm(
                arm=self._client(arm, "arm"),
                gripper=self._client(jaw, "gripper") if jaw else None,
                loop=asyncio.get_running_loop(),
                clock=clock,
                rate=self._config.rate,
            )
        gripper = GripperResource.here.get(_short(jaw)) if jaw else None
        if jaw and gripper is None:
            reason = f"is not a gripper of this module, but {arm} is its arm"
            raise ConfigError("grippers", jaw, reason)
        return LocalArm(station=here.rig, jaw=gripper.rig if gripper is not None else None)

    def _client(self, name: str, subtype: str) -> Any:
        client = dependency(self._dependencies, subtype, name)
        if client is None:
            raise ConfigError(f"{subtype}s", name, f"is not a {subtype} of this machine")
        return client

    def _recorder(self, file: Path, fps: float, clock: Clock) -> Recorder:
        here = ArmResource.here.get(_short(self._config.follower_arm))
        middles = middles_of(here.rig) if here is not None else None
        epoch = time.time() - clock.now()
        return Recorder(_unfinished(file), epoch=epoch, middles=middles, fps=fps)


def _file_of(record: str, *, replace: bool) -> Path:
    """The file of a recording; refused if it is there already, unless it may be replaced."""
    if Path(record).name != record:
        raise ConfigError("record", record, "must be a file name without folders")
    file = store.resolve(f"{RECORDINGS}/{record}")
    if not replace and file.exists():
        reason = 'is there already; choose another name, or send "replace": true'
        raise ConfigError("record", record, reason)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError("record", record, f"cannot be written: {error.strerror}") from error
    return file


def _unfinished(file: Path) -> Path:
    """Where a recording is written until its session has started."""
    return file.with_name(f"unfinished-{file.name}")


def _short(name: str | None) -> str:
    return (name or "").rpartition("/")[2].rpartition(":")[2]
