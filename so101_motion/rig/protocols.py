"""The interface of a rig that a viewer or a command line needs.

Two fit it: ``Rig``, whose joints are simulated or on a serial port of this computer, and
``MachineRig`` (``viam/client``), whose joints belong to a running machine. Both have the same
``Arm``, which plans here and plays what was planned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from so101_motion.arm.arm import Arm
from so101_motion.arm.gripper import Jaw
from so101_motion.common.clock import Clock
from so101_motion.common.encoder_zeros import EncoderZeros


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmConnection:
    """The state of the connection to an arm."""

    to: str  # name of the arm, to be put behind "the": ``"arm on /dev/ttyACM0"``
    problem: str | None = None  # why it cannot be reached; None while it can
    # when it was lost, on the rig's clock [s]; None while it can be reached
    lost_at: float | None = None
    is_simulated: bool = False  # whether there is no arm but in this computer
    # where its joints' zeros are; None if not known, or if it is simulated
    encoder_zeros: EncoderZeros | None = None

    @property
    def is_up(self) -> bool:
        return self.problem is None

    def words(self, now: float) -> str:
        """Its state as text, at ``now`` on the rig's clock [s]."""
        if self.problem is None:
            return "connected"
        if self.lost_at is None:
            return self.problem
        return f"lost {now - self.lost_at:.0f} s ago: {self.problem}"


class GripperLike(Jaw, Protocol):
    """A jaw that opens and closes; ``Gripper`` describes each method."""

    @property
    def q_jaw(self) -> float: ...

    @property
    def is_moving(self) -> bool: ...

    def angle_of(self, aperture: float) -> float:
        """The jaw angle [rad] that an aperture stands for."""

    def stop(self) -> None:
        """Slow to rest; returns when the jaw is at rest."""


class RigLike(Protocol):
    """An arm and its gripper.

    ``at_end`` is how ``close`` leaves it, one of ``session_end.ENDS``; ``on_left`` is told what
    came in between.
    """

    at_end: str
    on_left: Callable[[str], None]

    @property
    def arm(self) -> Arm: ...

    @property
    def gripper(self) -> GripperLike: ...

    @property
    def clock(self) -> Clock: ...

    @property
    def connection(self) -> ArmConnection:
        """Whether they can be reached; never waits."""

    def close(self) -> None:
        """End motions and close the rig. May be called twice."""
