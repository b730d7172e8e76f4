"""The interfaces that an ``Arm`` needs from an executor, and from its cell."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import AbstractContextManager
from typing import Any, Protocol

from so101_motion.common.clock import Clock
from so101_motion.common.compliance import Compliance, Wall
from so101_motion.common.state import JointState
from so101_motion.control.following import Following
from so101_motion.control.joint_group import Channel
from so101_motion.control.motion_source import S
from so101_motion.planning.collision.course import Neighbours, OtherArm
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Trajectory


class ArmExecutor(Protocol):
    """Moves five joints and reports where they are. ``Executor`` describes each method in full."""

    @property
    def dt(self) -> float:
        """Period of the setpoints of its trajectories [s]."""

    @property
    def state(self) -> JointState: ...

    @property
    def is_resting(self) -> bool:
        """Whether the arm surely rests and is not guided by hand, so it need not be stopped."""

    def execute(self, trajectory: Trajectory, *, channel: Channel = ...) -> Future[None]: ...
    def turn(self, following: Following, *, channel: Channel = ...) -> Future[None]: ...
    def stop_limits(self, channel: Channel) -> MotionLimits: ...
    def play(self, source: S) -> S: ...
    def stop(self, channel: Channel | None = None, *, by: str = ...) -> Future[None]: ...
    def interrupt(self, motion: Future[Any], by: str) -> Future[None]: ...
    def hold(self) -> Future[None]: ...
    def guide(self, compliance: Compliance, wall: Wall | None = None) -> Future[None]: ...
    def release(self) -> Future[None]: ...


class OtherArms(Neighbours, Protocol):
    """The other arms of a cell, as one arm plans and begins; see ``CellMember``."""

    clock: Clock

    @property
    def minded(self) -> frozenset[str]: ...

    def others(self) -> tuple[OtherArm, ...]: ...
    def touching(self) -> str: ...
    def entered(
        self, trajectory: Trajectory, pause_until: Callable[[float], None]
    ) -> AbstractContextManager[Trajectory]: ...
