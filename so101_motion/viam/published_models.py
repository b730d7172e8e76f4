"""The models that this module and the published one share, and how they differ.

The attributes of both are in ``attribute_table``; here is what a value means and what behaves
differently, a line each with its reason. ``migration`` reads it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from so101_motion.common.attributes import Attribute
from so101_motion.common.errors import ConfigError
from so101_motion.setup.discovery import ports_asked_for
from so101_motion.tasks.teleop import config as teleop
from so101_motion.viam import attribute_table as table
from so101_motion.viam.component_config import (
    CalibrationConfig,
    HardwareArmConfig,
    HardwareGripperConfig,
    MotionConfig,
    SimulatedArmConfig,
    SimulatedGripperConfig,
    arm_served,
    duration,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """A model of both modules: its attributes here, and the differences.

    Attributes:
        read: Checks attributes; raises ``ConfigError``.
        attributes: What it takes.
        differences: What behaves differently, given the attributes.
    """

    read: Callable[[Mapping[str, Any]], object]
    attributes: tuple[Attribute, ...]
    differences: Callable[[Mapping[str, Any]], tuple[str, ...]] = lambda _: ()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all attributes it takes."""
        return tuple(each.name for each in self.attributes)


def _seconds(value: Any) -> str:
    try:
        return f"{duration('timeout', value):g} s, for servos to answer at the start"
    except ConfigError:
        return "a duration"


def _planned_by(value: Any) -> str:
    if value in (None, ""):
        return "planned by this module"
    return f"planned by the service {value}; leave it out to have it planned here"


def _only_here(_: Mapping[str, Any]) -> tuple[str, ...]:
    return ("only this module has it",)


MEANINGS: Mapping[str, Callable[[Any], str]] = {
    "timeout": _seconds,
    "motion": _planned_by,
    "calibration_file": lambda _: "the same file; see below",
}
"""What the value of an attribute means here, where that needs words."""


def _arm_differences(given: Mapping[str, Any]) -> tuple[str, ...]:
    lines = [
        "waypoints are followed; there only the last one of a path was gone to",
        "stop, a cancelled call and a lost client bring the arm to rest at once, for they mean it",
        "acceleration is enforced, jerk too, and joints arrive together: a plan is a timed one",
        "a newer move ends the older one (ABORTED); there it waited",
        "targets outside the calibrated range are refused with the limit; there they were clamped",
    ]
    if "acceleration_degs_per_sec_per_sec" not in given:
        lines.append(
            "acceleration is 100 deg/s2 when it is not given, as first published; later versions"
            ' take 500: set "acceleration_degs_per_sec_per_sec" to keep that'
        )
    if given.get("motion") in (None, ""):
        lines.append(
            "MoveToPosition is planned here, point only, for five joints cannot take every"
            " orientation; extra.goal_metric_type asks for more"
        )
    return tuple(lines)


def _gripper_differences(given: Mapping[str, Any]) -> tuple[str, ...]:
    lines = [
        "grab says whether the jaw was stopped by something, and holds it gently",
        "closing by set_position grips what it meets instead of crushing it",
    ]
    if given.get("port") and given.get("arm"):
        lines.append("the arm's port is used, for one port has one owner")
    return tuple(lines)


MODELS: Mapping[str, Model] = {
    "arm": Model(
        read=HardwareArmConfig.from_attributes,
        attributes=table.ARM,
        differences=_arm_differences,
    ),
    "gripper": Model(
        read=HardwareGripperConfig.from_attributes,
        attributes=table.GRIPPER,
        differences=_gripper_differences,
    ),
    "simulated": Model(
        read=SimulatedArmConfig.from_attributes,
        attributes=table.SIMULATED_ARM,
        differences=lambda _: (
            "it is planned for and moved as the real arm is, within its accelerations; there it"
            " turned at constant speed",
            "speeds are 3 to 180 deg/s, as for the real one",
        ),
    ),
    "simulated-gripper": Model(
        read=SimulatedGripperConfig.from_attributes, attributes=table.SIMULATED_GRIPPER
    ),
    "calibration": Model(
        read=CalibrationConfig.from_attributes,
        attributes=table.CALIBRATION,
        differences=lambda _: (
            "saving merges with what the file says, keeps versions, and writes where the next start"
            " reads",
            "a joint may cross the end of its servo's counter while it is recorded",
        ),
    ),
    "motion": Model(
        read=MotionConfig.from_attributes, attributes=table.MOTION, differences=_only_here
    ),
    "world-state": Model(read=arm_served, attributes=table.FOR_AN_ARM, differences=_only_here),
    "discovery": Model(read=ports_asked_for, attributes=table.DISCOVERY),
    "teleop": Model(
        read=teleop.TeleopConfig.from_attributes,
        attributes=teleop.ATTRIBUTES,
        differences=lambda _: (
            "the follower comes to the leader slowly before it follows; there it jumped",
            "a lost leader or follower means hold; there it went on",
        ),
    ),
}
"""By what follows ``devrel:so101:`` in a model's name."""

_ALL = [each for model in MODELS.values() for each in model.attributes]
OURS = {each.name for each in _ALL if each.ours} - {each.name for each in _ALL if not each.ours}
"""The attributes that the published module does not know at all."""
