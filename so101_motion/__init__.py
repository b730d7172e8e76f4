"""Motion for the SO-101 arm: planned, timed to the limits, stoppable at any instant.

The names that programs need are here; import everything else from its module. Importing this
package is cheap: Pinocchio and ruckig are loaded when they are first needed.

    with so101.open("sim") as rig:
        rig.arm.move(so101.point(0.25, 0.12, 0.15))
        rig.gripper.grab()
"""

import sys
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from so101_motion.arm.cell import Cell as Cell
    from so101_motion.arm.gripper import JawFollowing as JawFollowing
    from so101_motion.arm.planning_worker import PlanningWorker as PlanningWorker
    from so101_motion.common import errors as errors
    from so101_motion.common.errors import So101Error as So101Error
    from so101_motion.common.geometry import SE3 as SE3
    from so101_motion.common.state import JointState as JointState
    from so101_motion.control.following import Following as Following
    from so101_motion.files.saved_poses import SavedPoses as SavedPoses
    from so101_motion.opening import open as open
    from so101_motion.opening import point as point
    from so101_motion.planning.collision.collision import CollisionModel as CollisionModel
    from so101_motion.planning.collision.scene import Attached as Attached
    from so101_motion.planning.collision.scene import Box as Box
    from so101_motion.planning.collision.scene import Capsule as Capsule
    from so101_motion.planning.collision.scene import Cylinder as Cylinder
    from so101_motion.planning.collision.scene import Mesh as Mesh
    from so101_motion.planning.collision.scene import Obstacle as Obstacle
    from so101_motion.planning.collision.scene import PointCloud as PointCloud
    from so101_motion.planning.collision.scene import Scene as Scene
    from so101_motion.planning.collision.scene import Sphere as Sphere
    from so101_motion.planning.goals import ApproachGoal as ApproachGoal
    from so101_motion.planning.goals import ArcTo as ArcTo
    from so101_motion.planning.goals import GoalMetric as GoalMetric
    from so101_motion.planning.goals import JointGoal as JointGoal
    from so101_motion.planning.goals import LeaveContactGoal as LeaveContactGoal
    from so101_motion.planning.goals import LineGoal as LineGoal
    from so101_motion.planning.goals import LineTo as LineTo
    from so101_motion.planning.goals import PathGoal as PathGoal
    from so101_motion.planning.goals import PoseCloud as PoseCloud
    from so101_motion.planning.goals import PoseGoal as PoseGoal
    from so101_motion.planning.goals import ToolPathGoal as ToolPathGoal
    from so101_motion.planning.kinematics.model import RobotModel as RobotModel
    from so101_motion.planning.request import Plan as Plan
    from so101_motion.planning.request import PlanRequest as PlanRequest
    from so101_motion.planning.timing.limits import MotionLimits as MotionLimits
    from so101_motion.planning.timing.torque import Payload as Payload
    from so101_motion.rig.hardware_rig import open_hardware as open_hardware
    from so101_motion.rig.port_settings import ServoSettings as ServoSettings
    from so101_motion.rig.rig import Rig as Rig
    from so101_motion.rig.simulated_rig import open_simulated as open_simulated
    from so101_motion.tasks.teleop.sides import middles_of as middles_of

__version__ = "0.1.0"

_HOMES = {  # what each module has of ours; it is imported when a name of it is first asked for
    "arm.cell": "Cell",
    "arm.gripper": "JawFollowing",
    "arm.planning_worker": "PlanningWorker",
    "common.errors": "So101Error",
    "common.geometry": "SE3",
    "common.state": "JointState",
    "control.following": "Following",
    "files.saved_poses": "SavedPoses",
    "opening": "open point",
    "planning.collision.collision": "CollisionModel",
    "planning.collision.scene": (
        "Attached Box Capsule Cylinder Mesh Obstacle PointCloud Scene Sphere"
    ),
    "planning.goals": (
        "ApproachGoal ArcTo GoalMetric JointGoal LeaveContactGoal LineGoal LineTo PathGoal"
        " PoseCloud PoseGoal ToolPathGoal"
    ),
    "planning.kinematics.model": "RobotModel",
    "planning.request": "Plan PlanRequest",
    "planning.timing.limits": "MotionLimits",
    "planning.timing.torque": "Payload",
    "rig.hardware_rig": "open_hardware",
    "rig.rig": "Rig",
    "rig.servo_driver": "ServoSettings",
    "rig.simulated_rig": "open_simulated",
    "tasks.teleop.sides": "middles_of",
}
_HOME = {name: home for home, names in _HOMES.items() for name in names.split()}

__all__ = ["__version__", "errors", *_HOME]


def __getattr__(name: str) -> object:
    if name == "errors":
        return import_module("so101_motion.common.errors")
    if name in _HOME:
        return getattr(import_module(f"so101_motion.{_HOME[name]}"), name)
    text = f"module 'so101_motion' has no attribute {name!r}"
    if not name.startswith("_") and hasattr(import_module("so101_motion.common.errors"), name):
        text += f"; it is so101_motion.errors.{name}"
    raise AttributeError(text, name=name, obj=sys.modules[__name__])


def __dir__() -> list[str]:
    return sorted(__all__)
