"""Open an arm by one word: simulated, on a serial port, or of a running Viam machine."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.arm.planning_worker import planner_started
from so101_motion.common.attributes import checked_kind, checked_number
from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.common.geometry import SE3, frame_along, given_array
from so101_motion.common.public import explained
from so101_motion.planning.goals import GoalMetric, PoseGoal

if TYPE_CHECKING:
    from so101_motion.rig.rig import Rig
    from so101_motion.viam.client import MachineRig

_MACHINE = "viam://"
_KNOWN = re.compile(r"sim|viam://.*|COM\d+|(?!viam:|https?:).*/.*", re.DOTALL)


def open(arm: str | Path, *, calibration: str | Path | None = None) -> Rig | MachineRig:
    """Open an arm with its gripper; opening moves nothing. Use it in a ``with`` block, or close it.

    Args:
        arm: ``"sim"`` for a simulated one, a serial port, or ``"viam://HOST:PORT"`` for the only
            arm of a running machine (``MachineRig.connect`` takes keys and names).
        calibration: Of an arm on a port: a file, or the name that LeRobot knows the arm by
            (``--robot.id``). By default the saved file that agrees with the servos, else their own.

    Raises:
        ConfigError: There is no such calibration, or it is given for an arm on no port.
        CalibrationError: It cannot be used, or the servos hold another.
        BusError: The port cannot be opened, or a servo does not answer.
        MachineUnavailable: The machine cannot be reached.
    """
    arm = str(arm) if isinstance(arm, Path) else arm
    if not isinstance(arm, str) or not (_KNOWN.fullmatch(arm) or (arm and Path(arm).exists())):
        near = 'did you mean "sim"? ' if "sim" in str(arm).lower() else ""
        reason = f'{near}must be "sim", a serial port such as "/dev/ttyACM0", or "viam://HOST:PORT"'
        raise ConfigError("arm", arm, reason)
    if calibration is not None and (arm == "sim" or arm.startswith(_MACHINE)):
        raise ConfigError("calibration", str(calibration), "is for an arm on a serial port")
    what = "a file, or the name that LeRobot knows the arm by"
    checked_kind("calibration", calibration, str | Path | None, what)
    try:
        with planner_started():
            if arm.startswith(_MACHINE):
                from so101_motion.viam.client import MachineRig

                return MachineRig.connect(arm.removeprefix(_MACHINE))
            if arm == "sim":
                from so101_motion.rig.simulated_rig import open_simulated

                return open_simulated()
            from so101_motion.rig.hardware_rig import open_so101

            return open_so101(arm, calibration)
    except So101Error as error:
        raise error.with_traceback(None) from None  # without the frames of all the layers below


@explained("it takes {}; of an array p: point(*p)")
def point(
    x: float, y: float, z: float, *, along: ArrayLike | None = None, frame: str = "tool"
) -> PoseGoal:
    """The goal of bringing the tool to a point [m] in the arm's base frame.

    Args:
        x: Ahead.
        y: To the left.
        z: Up.
        along: The direction in which the tool points there, shape (3,), any length, such as
            (0, 0, -1) from above; None for any.
        frame: ``"tool"``, between the jaws, or ``"jaw_tip"``, 98 mm further along; ``"tcp"`` or
            another frame of a tool once ``Arm.set_tool`` has fixed one.
    """
    for key, value in (("x", x), ("y", y), ("z", z)):
        checked_number(key, value, unit="m")
    at = PoseGoal.at_point([x, y, z], frame=frame)
    if along is None:
        return at
    axis = given_array("along", along, (3,), "numbers, a direction such as 0, 0, -1")
    if not 0.0 < np.abs(axis).max() < math.inf:
        raise ConfigError("along", axis.tolist(), "must be a direction, such as (0, 0, -1)")
    to = SE3(frame_along(axis), at.T_base_tool.p)
    return PoseGoal(T_base_tool=to, metric=GoalMetric.POSITION_AND_APPROACH, frame=frame)
