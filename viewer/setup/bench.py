"""What is worked on: the arm on a port of this computer, or the one of a running machine.

Both have the same face. ``Calibrator`` fits ``Calibrates`` as it is; for a machine there is
``machine.py``, which asks the calibration sensor.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Protocol

from so101_motion.calib.setup_view import SetupView, Verification
from so101_motion.calibrator import Ended, Situation
from so101_motion.rig_like import RigLike


class SetsUpMotors(Protocol):
    """Gives motors their ids. Everything but ``view`` takes a while: call it from a worker."""

    @property
    def view(self) -> SetupView:
        """How far everything is; never waits."""

    def discover(self, joint: str) -> object:
        """Find the one motor that is connected; see ``MotorSetup.discover``."""

    def assign(self, joint: str) -> object:
        """Give the one motor that is connected its id; see ``MotorSetup.assign``."""

    def skip(self, joint: str) -> object:
        """Leave a joint's motor as it is."""

    def verify(self) -> Verification:
        """Look whether the six of the finished chain are as they must be."""

    def recall(self, joints: Collection[str]) -> None:
        """Take the motors of these joints for set up, because an earlier setup said so."""

    def reset(self) -> None:
        """Forget how far the setup was."""


class Calibrates(Protocol):
    """Calibrates and sets motors up. Only ``situation`` never waits: call the rest from a worker.

    See ``Calibrator`` for what each method promises.
    """

    @property
    def motor_setup(self) -> SetsUpMotors:
        """The setup of the motors."""

    @property
    def situation(self) -> Situation:
        """Everything there is to know now."""

    def start(self) -> object:
        """Let go of the joints."""

    def set_homing(self) -> object:
        """Take the present pose for the middle of each travel."""

    def start_recording(self) -> object:
        """From now on, keep where the joints have been."""

    def stop_recording(self, *, accept: Collection[str] = ()) -> object:
        """End the recording if all joints have been where they must go."""

    def save(self) -> Ended:
        """Let the motors and the file hold the new calibration."""

    def abort(self) -> Ended:
        """Put everything back as it was."""

    def reset(self) -> Ended:
        """``abort``, under the name it has after an error."""

    def hold(self) -> object:
        """Have the joints held where they stand."""

    def restore(self) -> Ended:
        """Let the file and the motors hold what they held before the last calibration."""

    def close(self) -> None:
        """Abort what is under way and let go."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bench:
    """An arm to be set up.

    Attributes:
        where: On which port, or at which machine.
        calibrator: Does the work; closed with the bench.
        rig: Moves the arm, for the final test; None where nothing can. Closed by its owner.
        is_remote: Whether it is the arm of a machine, so that its cable is not ours to look at.
    """

    where: str
    calibrator: Calibrates
    rig: RigLike | None = None
    is_remote: bool = False
