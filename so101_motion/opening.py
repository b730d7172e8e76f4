"""Open an arm by one word: simulated, on a serial port, or of a running Viam machine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from so101_motion.arm.planning_worker import planner_started
from so101_motion.common.errors import ConfigError
from so101_motion.planning.goals import PoseGoal

if TYPE_CHECKING:
    from so101_motion.rig.rig import Rig
    from so101_motion.viam.client import MachineRig

_MACHINE = "viam://"


def open(arm: str, *, calibration: str | Path | None = None) -> Rig | MachineRig:
    """Open an arm with its gripper; opening moves nothing. Use it in a ``with`` block, or close it.

    Args:
        arm: ``"sim"`` for a simulated one, a serial port, or ``"viam://HOST:PORT"`` for the only
            arm of a running machine (``MachineRig.connect`` takes keys and names).
        calibration: Of an arm on a port: a file, or the name that LeRobot knows the arm by
            (``--robot.id``). By default the saved file that agrees with the servos, else their own.

    Raises:
        ConfigError: There is no such calibration, or it is given for an arm on no port.
        BusError: The port cannot be opened, or a servo does not answer.
        MachineUnavailable: The machine cannot be reached.
    """
    if calibration is not None and (arm == "sim" or arm.startswith(_MACHINE)):
        raise ConfigError("calibration", str(calibration), "is for an arm on a serial port")
    with planner_started():
        if arm.startswith(_MACHINE):
            from so101_motion.viam.client import MachineRig

            return MachineRig.connect(arm.removeprefix(_MACHINE))
        if arm == "sim":
            from so101_motion.rig.simulated_rig import open_simulated

            return open_simulated()
        from so101_motion.rig.hardware_rig import open_so101

        return open_so101(arm, calibration)


def point(x: float, y: float, z: float) -> PoseGoal:
    """The goal of bringing the tool to a point [m] in the arm's base frame, in any orientation."""
    return PoseGoal.at_point([x, y, z])
