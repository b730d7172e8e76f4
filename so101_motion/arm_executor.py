"""What an ``Arm`` needs of whoever moves its joints.

``Executor`` does it with servos on a port; ``machine.MachineExecutor`` has a running machine do it.
"""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any, Protocol

from so101_motion.channel import Channel
from so101_motion.compliance import Compliance
from so101_motion.geometry import Array
from so101_motion.jog import Jog
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.trajectory import Trajectory
from so101_motion.pursuit import Pursuit
from so101_motion.state import JointState
from so101_motion.stream import Stream


class ArmExecutor(Protocol):
    """Moves five joints and says where they are. See ``Executor`` for what each method promises."""

    @property
    def dt(self) -> float:
        """Period of the setpoints of its trajectories [s]."""

    @property
    def state(self) -> JointState:
        """The newest snapshot; never waits."""

    def execute(self, trajectory: Trajectory, *, channel: Channel = ...) -> Future[None]:
        """Play ``trajectory``; done on arrival."""

    def retarget(
        self, q_goal: Array, limits: MotionLimits, *, channel: Channel = ...
    ) -> Future[None]:
        """Turn to ``q_goal``, shape (n,), [rad], from the present motion without stopping."""

    def open_stream(self, limits: MotionLimits) -> Stream:
        """Take time-stamped points for the arm while it moves."""

    def play(self, led: Jog | Pursuit, *, channel: Channel = ...) -> None:
        """Let the joints be led."""

    def stop(self, channel: Channel | None = None, *, by: str = ...) -> Future[None]:
        """Slow down to rest; done at rest."""

    def interrupt(self, motion: Future[Any], by: str) -> Future[None]:
        """End the motion whose future is ``motion``; no effect when it is over."""

    def hold(self) -> Future[None]:
        """Drive the joints where they are."""

    def guide(self, how: Compliance) -> Future[None]:
        """Let the arm yield to a hand."""

    def release(self) -> Future[None]:
        """Let go of the joints."""
